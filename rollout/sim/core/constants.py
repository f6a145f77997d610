"""The simulator's constants: numbers derived once from the configuration."""

import math
from typing import Annotated, Any, Final, NamedTuple, get_type_hints

import numpy as np

from eia_sec.common.config import FarmConfig
from eia_sec.common.config.farm import BatteryConfig, ObservationConfig, StressConfig
from eia_sec.common.errors import ConfigError
from eia_sec.common.farm import farm_team
from eia_sec.rollout.sim.conditions.ways import WayConstants, way_constants
from eia_sec.rollout.sim.core.cells import cell_counts
from eia_sec.rollout.sim.core.dynamics import DynamicsConstants, dynamics_constants
from eia_sec.rollout.sim.core.link import RadioConstants, loss_at_one_metre, noise, radio_constants
from eia_sec.rollout.sim.core.records import NUMBERS, Array, Indices, numbers
from eia_sec.rollout.sim.observation.constants import ViewConstants, view_constants
from eia_sec.rollout.sim.observation.plans.constants import PlanConstants, plan_constants
from eia_sec.rollout.sim.stations import base_place, station_places

LEAST_LINK: Final = 1.0
"""Least distance in the free-space loss between two UAVs, m (ours). At distance 0 the loss is undefined."""


class FleetConstants(NamedTuple):
    """The UAVs, in row order, and the field."""

    relays: Annotated[int, "n_c"]
    collectors: Annotated[int, "index of the first data collection UAV, n_c + n_m"]
    uavs: Annotated[int, "n_UAV"]
    height: Annotated[Array, "[n] of each UAV, m"]
    payloads: Annotated[
        tuple[float, float, float],
        "power of each type besides flight power: P_comm + P_cmp and P_cam or P_ec, W",
    ]
    width: Annotated[float, "U_x-max, m"]
    depth: Annotated[float, "U_y-max, m"]
    diagonal: Annotated[float, "of the field, m"]
    per_width: Annotated[float, "1 / width, 1/m"]
    per_depth: Annotated[float, "1 / depth, 1/m"]
    per_diagonal: Annotated[float, "1 / diagonal, 1/m"]
    speed_x: Annotated[float, "V_x-max, m/s"]
    speed_y: Annotated[float, "V_y-max, m/s"]
    seconds: Annotated[float, "t_step, s"]
    steps: Annotated[int, "steps of an episode"]
    safety: Annotated[float, "d_safety, m (W9)"]
    collision: Annotated[float, "collision distance, m"]
    mortal: Annotated[bool, "whether any UAV can be gone"]
    sizes: Annotated[tuple[int, int, int], "numbers that a UAV of each type observes"]
    wind: Annotated[bool, "whether wind blows"]
    zones: Annotated[bool, "whether there are no-fly zones"]
    zone_first: Annotated[Indices, "[Z + 1] first side of each zone"]
    stations: Annotated[Array, "[K, 2] charging stations, m"]


class FlightConstants(NamedTuple):
    """Flight power (W5)."""

    hover_speed: Annotated[float, "v_th, m/s"]
    hover: Annotated[float, "hover power, W"]
    c1: Annotated[float, "coefficient of the drag, W s^2/m^2"]
    c2: Annotated[float, "coefficient of the thrust, W m/s"]
    mass: Annotated[float, "m, kg"]
    gravity: Annotated[float, "g, m/s^2"]
    weight: Annotated[float, "m g, N"]


class RelayConstants(NamedTuple):
    """Assignment and service quality."""

    capacity: Annotated[int, "most UAVs that one relay serves"]
    cost_distance: Annotated[float, "weight of the distance in the cost, 1/m"]
    cost_link: Annotated[float, "weight of the free-space loss in the cost, 1/dB"]
    loss_scale: Annotated[float, "free-space loss per unit of ln(distance^2), dB"]
    loss_offset: Annotated[float, "free-space loss at 1 m, dB"]
    budget: Annotated[float, "transmission power over noise, which is the signal-to-noise ratio of a lossless link, dB"]
    weight_centroid: Annotated[float, "epsilon_1"]
    weight_farthest: Annotated[float, "epsilon_2"]
    weight_relays: Annotated[float, "epsilon_3"]
    link_range: Annotated[float, "range of the UAV-UAV link, m; infinite unless `require_link` (W4)"]
    chained: Annotated[bool, "whether links count only over a chain of hops to the base station"]
    hop_range: Annotated[float, "of these hops, m"]
    base_x: Annotated[float, "of the base station, m"]
    base_y: Annotated[float, "of the base station, m"]
    height: Annotated[float, "of the relays over it, m"]


class CameraConstants(NamedTuple):
    """Plots, their cells and VDF."""

    plots_x: Annotated[int, "n_px"]
    plots_y: Annotated[int, "n_py"]
    plot_width: Annotated[float, "m"]
    plot_depth: Annotated[float, "m"]
    grid_x: Annotated[Array, "[n_gx n_gy] middles of the grid cells along x, as fractions of the plot"]
    grid_y: Annotated[Array, "[n_gx n_gy] the same along y"]
    ground_square: Annotated[float, "d_th^2 - H_m^2, the square of the ground radius of a good image, m^2"]
    threshold: Annotated[float, "Q_th"]
    reach: Annotated[float, "horizontal distance from the UAV beyond which no cell matters, m"]
    centre_square: Annotated[
        float,
        "square of the distance from the UAV to a plot's centre beyond which no image succeeds, m^2",
    ]
    cycle: Annotated[int, "t_v, steps"]
    level_max: Annotated[float, "VDF_max"]


class RewardConstants(NamedTuple):
    """Weights of the reward parts, signs included."""

    positioning: Annotated[float, "weight of D_c(k) - D_c(k-1), 1/m (W1)"]
    energy: Annotated[float, "weight of the energy, 1/J"]
    risk: Annotated[float, "weight of the safety risk, 1/m"]
    boundary: Annotated[float, "weight of ACT"]
    utility: Annotated[tuple[float, float], "weight of VMUF and DCUF"]
    idle: Annotated[tuple[float, float], "weight of P_M and P_C"]
    motivation: Annotated[tuple[float, float], "weight of M_V and M_D"]
    relayed: Annotated[float, "weight of what relays' UAVs earn through their links; 0 unless that takes links"]


class ObservationConstants(NamedTuple):
    """What observing takes besides the switches."""

    printed: Annotated[bool, "whether sensors are observed by AoI only (W24)"]
    waiting: Annotated[bool, "whether sensors with AoI above 0 come first"]
    per_steps: Annotated[float, "1 / steps of an episode"]
    start_square: Annotated[float, "square of the initial radius of the search for the nearest sensors, m^2"]
    cells_x: Annotated[int, "sensor cells along x"]
    cells_y: Annotated[int, "sensor cells along y"]


class Constants(NamedTuple):
    """All constants; those named as a section of the configuration hold its own numbers, see `records.numbers`."""

    fleet: FleetConstants
    flight: FlightConstants
    relay: RelayConstants
    radio: RadioConstants
    camera: CameraConstants
    reward: RewardConstants
    observation: ObservationConstants
    added: ViewConstants
    plans: PlanConstants
    ways: WayConstants
    dynamics: DynamicsConstants
    seen: ObservationConfig
    stress: StressConfig
    battery: BatteryConfig


def constants(config: FarmConfig) -> Constants:
    """Derive the kernel's numbers.

    Raises:
        ConfigError: the field's diagonal is too short to have a free-space loss.
    """
    radio, camera = radio_constants(config), _camera(config)
    derived = (
        _fleet(config),
        _flight(config),
        _relay(config),
        radio,
        camera,
        _reward(config),
        _observation(config),
        view_constants(config, radio),
        plan_constants(config, radio, camera.reach),
        way_constants(config),
        dynamics_constants(config),
    )
    sections = (config.observation, config.stress, config.battery)
    return Constants(*(_cast(part) for part in derived), *(numbers(section) for section in sections))


def _observation(config: FarmConfig) -> ObservationConstants:
    what, world = config.observation, config.world
    start = 1.5 * what.sensors * world.field_x * world.field_y / (math.pi * world.sensors)
    return ObservationConstants(
        what.form == "printed", what.choice == "waiting", 1.0 / world.steps, start, *cell_counts(world)
    )


def _cast(part: Any) -> Any:
    """Cast every number to its declared type, so that an integer in a configuration triggers no recompilation."""
    kinds = {name: kind for name, kind in get_type_hints(type(part)).items() if kind in NUMBERS}
    return part._replace(**{name: kind(getattr(part, name)) for name, kind in kinds.items()})


def watts(dbm: float) -> float:
    """Convert dBm to W."""
    return math.pow(10.0, dbm / 10.0) / 1000.0


def _fleet(config: FarmConfig) -> FleetConstants:
    world, energy = config.world, config.energy
    dynamic = energy.load_capacitance * energy.voltage**2 * energy.clock_hz * energy.activity_factor
    relays, monitors, collectors = farm_team(config).groups
    common = watts(energy.transmit_dbm) + watts(energy.receive_dbm) + energy.static_power + dynamic
    return FleetConstants(
        relays=world.communication_uavs,
        collectors=world.communication_uavs + world.monitoring_uavs,
        uavs=world.uavs,
        height=np.repeat(
            np.array((world.height_communication, world.height_monitoring, world.height_collection), np.float64),
            (world.communication_uavs, world.monitoring_uavs, world.collection_uavs),
        ),
        payloads=(common, common + energy.camera_power, common + watts(energy.collection_dbm)),
        width=world.field_x,
        depth=world.field_y,
        diagonal=math.hypot(world.field_x, world.field_y),
        per_width=1.0 / world.field_x,
        per_depth=1.0 / world.field_y,
        per_diagonal=1.0 / math.hypot(world.field_x, world.field_y),
        speed_x=world.speed_x_max,
        speed_y=world.speed_y_max,
        seconds=world.step_seconds,
        steps=world.steps,
        safety=world.safety_distance,
        collision=world.collision_distance,
        mortal=config.loses_uavs,
        sizes=(relays.observation_size, monitors.observation_size, collectors.observation_size),
        wind=config.wind.some,
        zones=config.zones.some,
        zone_first=np.cumsum([0, *config.zones.corners], dtype=np.int64),
        stations=station_places(config),
    )


def _flight(config: FarmConfig) -> FlightConstants:
    energy = config.energy
    disk = energy.propellers * math.pi * energy.propeller_radius**2
    area = energy.body_area + disk
    return FlightConstants(
        hover_speed=energy.hover_speed,
        hover=energy.mass * energy.gravity**1.5 / (math.sqrt(2.0 * energy.air_density * area) * energy.efficiency),
        c1=0.5 * energy.air_density * area * energy.drag_coefficient,
        c2=energy.mass**2 / (energy.efficiency * energy.air_density * disk),
        mass=energy.mass,
        gravity=energy.gravity,
        weight=energy.mass * energy.gravity,
    )


def _relay(config: FarmConfig) -> RelayConstants:
    relay, world = config.relay, config.world
    x, y = base_place(config).tolist()
    offset = loss_at_one_metre(config)
    diagonal = math.hypot(world.field_x, world.field_y)
    loss = offset + 20.0 * math.log10(max(diagonal, LEAST_LINK))
    if loss <= 0.0:
        raise ConfigError(f"a field of {diagonal:g} m is too small: its diagonal has no free-space loss.")
    return RelayConstants(
        capacity=relay.capacity_for(world),
        cost_distance=relay.cost_distance / diagonal,
        cost_link=relay.cost_link / loss,
        loss_scale=10.0 / math.log(10.0),
        loss_offset=offset,
        budget=config.energy.transmit_dbm - 10.0 * math.log10(noise(config)),
        weight_centroid=relay.weight_centroid,
        weight_farthest=relay.weight_farthest,
        weight_relays=relay.weight_relays,
        link_range=relay.link_range if relay.require_link else math.inf,
        chained=relay.chained,
        hop_range=relay.hop_range,
        base_x=x,
        base_y=y,
        height=world.height_communication,
    )


def _camera(config: FarmConfig) -> CameraConstants:
    camera, world = config.camera, config.world
    square = camera.image_distance**2 - world.height_monitoring**2
    everywhere = camera.plot_threshold == 0.0
    return CameraConstants(
        plots_x=world.plots_x,
        plots_y=world.plots_y,
        plot_width=world.field_x / world.plots_x,
        plot_depth=world.field_y / world.plots_y,
        grid_x=np.repeat((np.arange(camera.grid_x) + 0.5) / camera.grid_x, camera.grid_y),
        grid_y=np.tile((np.arange(camera.grid_y) + 0.5) / camera.grid_y, camera.grid_x),
        ground_square=square,
        threshold=camera.plot_threshold,
        reach=math.hypot(world.field_x, world.field_y) if everywhere else math.sqrt(max(square, 0.0)),
        centre_square=max(square, 0.0) * (1.0 + 1e-9) if camera.plot_threshold > 0.5 else math.inf,
        cycle=round(world.vdf_cycle / world.step_seconds),
        level_max=float(world.vdf_max),
    )


def _reward(config: FarmConfig) -> RewardConstants:
    reward = config.reward
    return RewardConstants(
        positioning=-reward.positioning,
        energy=-reward.energy,
        risk=-reward.collision_risk,
        boundary=-reward.boundary,
        utility=(float(reward.monitoring), float(reward.collection)),
        idle=(-float(reward.monitoring_idle), -float(reward.collection_idle)),
        motivation=(float(reward.monitoring_motivation), float(reward.collection_motivation)),
        relayed=float(reward.relayed) if config.relay.require_link else 0.0,
    )
