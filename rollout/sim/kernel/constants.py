"""The compiled simulator's constants: numbers derived once from the configuration."""

import math
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from eia_sec.common.config import FarmConfig
from eia_sec.common.errors import ConfigError
from eia_sec.rollout.sim.kernel.chain import ChainConstants, chain_constants
from eia_sec.rollout.sim.kernel.event_constants import (
    BatteryConstants,
    FailureConstants,
    StressConstants,
    battery_constants,
    failure_constants,
    stress_constants,
)
from eia_sec.rollout.sim.kernel.flight.airspace import AirspaceConstants, airspace
from eia_sec.rollout.sim.kernel.flight.ways import WayConstants, way_constants
from eia_sec.rollout.sim.kernel.link import RadioConstants, loss_at_one_metre, noise, radio_constants
from eia_sec.rollout.sim.kernel.plans.constants import PlanConstants, plan_constants
from eia_sec.rollout.sim.kernel.views.constants import ViewConstants, view_constants

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
Int32 = NDArray[np.int32]
"""For large per-environment arrays; they take half the memory of 64-bit ones."""

LEAST_LINK: Final = 1.0
"""Least distance in the free-space loss between two UAVs, m (ours). At distance 0 the loss is undefined."""


class FleetConstants(NamedTuple):
    """The UAVs, in row order, and the field.

    Attributes:
        relays: n_c.
        collectors: index of the first data collection UAV, n_c + n_m.
        uavs: n_UAV.
        height: [n] of each UAV, m.
        payloads: power of each type besides flight power: P_comm + P_cmp and P_cam or P_ec, W.
        width: U_x-max, m.
        depth: U_y-max, m.
        diagonal: of the field, m.
        per_width: 1 / width, 1/m.
        per_depth: 1 / depth, 1/m.
        per_diagonal: 1 / diagonal, 1/m.
        speed_x: V_x-max, m/s.
        speed_y: V_y-max, m/s.
        seconds: t_step, s.
        steps: steps of an episode.
        safety: d_safety, m (W9).
        collision: collision distance, m.
        any_plane: whether the search for the nearest UAV covers all planes (W10).
    """

    relays: int
    collectors: int
    uavs: int
    height: Array
    payloads: tuple[float, float, float]
    width: float
    depth: float
    diagonal: float
    per_width: float
    per_depth: float
    per_diagonal: float
    speed_x: float
    speed_y: float
    seconds: float
    steps: int
    safety: float
    collision: float
    any_plane: bool


class FlightConstants(NamedTuple):
    """Flight power (W5).

    Attributes:
        physical: the physical model, not the printed one.
        hover_speed: v_th, m/s.
        hover: printed hover power, W.
        c1: drag coefficient of the printed model, W s^2/m^2.
        c2: coefficient of the printed model, W m/s.
        weight: m g, N.
        efficiency: eta.
        induced: (m g) / (2 rho A_disk), the square of the induced speed when hovering, m^2/s^2.
        drag: 0.5 rho A_surf C_d, W s^3/m^3.
    """

    physical: bool
    hover_speed: float
    hover: float
    c1: float
    c2: float
    weight: float
    efficiency: float
    induced: float
    drag: float


class RelayConstants(NamedTuple):
    """Assignment and service quality.

    Attributes:
        capacity: most UAVs that one relay serves.
        cost_distance: weight of the distance in the cost, 1/m.
        cost_link: weight of the free-space loss in the cost, 1/dB.
        loss_scale: free-space loss per unit of ln(distance^2), dB.
        loss_offset: free-space loss at 1 m, dB.
        budget: transmission power over noise, which is the signal-to-noise ratio of a lossless link, dB.
        weight_centroid: epsilon_1.
        weight_farthest: epsilon_2.
        weight_relays: epsilon_3.
        link_range: range of the UAV-UAV link, m; infinite unless `require_link` (W4).
    """

    capacity: int
    cost_distance: float
    cost_link: float
    loss_scale: float
    loss_offset: float
    budget: float
    weight_centroid: float
    weight_farthest: float
    weight_relays: float
    link_range: float


class CameraConstants(NamedTuple):
    """Plots, their cells and VDF.

    Attributes:
        plots_x: n_px.
        plots_y: n_py.
        plot_width: m.
        plot_depth: m.
        grid_x: [n_gx n_gy] middles of the grid cells along x, as fractions of the plot.
        grid_y: [n_gx n_gy] the same along y.
        ground_square: d_th^2 - H_m^2, the square of the ground radius of a good image, m^2.
        threshold: Q_th.
        reach: horizontal distance from the UAV beyond which no cell matters, m.
        centre_square: square of the distance from the UAV to a plot's centre beyond which no image succeeds, m^2.
        cycle: t_v, steps.
        level_max: VDF_max.
    """

    plots_x: int
    plots_y: int
    plot_width: float
    plot_depth: float
    grid_x: Array
    grid_y: Array
    ground_square: float
    threshold: float
    reach: float
    centre_square: float
    cycle: int
    level_max: float


class RewardConstants(NamedTuple):
    """Weights of the reward parts, signs included.

    Attributes:
        positioning: weight of D_c(k) - D_c(k-1), 1/m (W1).
        energy: weight of the energy, 1/J.
        risk: weight of the safety risk, 1/m.
        boundary: weight of ACT.
        utility: weight of VMUF and DCUF.
        idle: weight of P_M and P_C.
        motivation: weight of M_V and M_D.
        closing: whether SR counts only closing in (W8), not the printed difference.
        relayed: weight of what relays' UAVs earn through their links; 0 unless that takes links.
    """

    positioning: float
    energy: float
    risk: float
    boundary: float
    utility: tuple[float, float]
    idle: tuple[float, float]
    motivation: tuple[float, float]
    closing: bool
    relayed: float


class ObservationConstants(NamedTuple):
    """What the UAVs see.

    Attributes:
        sensors: n, the number of sensors observed.
        printed: whether sensors are observed by AoI only (W24).
        waiting: whether sensors with AoI above 0 come first.
        window: plots along each side of the square that a monitoring UAV sees.
        lattice: whether a monitoring UAV observes its position within its plot.
        mirrored: whether axes are flipped so that a UAV's position (a monitor's: within its plot) is never below 0.
        identity: whether an agent observes its index within its type.
        clock: whether an agent observes the time.
        per_steps: 1 / steps of an episode.
        start_square: square of the initial radius of the search for the nearest sensors, m^2.
        cells_x: sensor cells along x.
        cells_y: sensor cells along y.
    """

    sensors: int
    printed: bool
    waiting: bool
    window: int
    lattice: bool
    mirrored: bool
    identity: bool
    clock: bool
    per_steps: float
    start_square: float
    cells_x: int
    cells_y: int


class Constants(NamedTuple):
    """All constants."""

    fleet: FleetConstants
    flight: FlightConstants
    relay: RelayConstants
    radio: RadioConstants
    camera: CameraConstants
    reward: RewardConstants
    observation: ObservationConstants
    added: ViewConstants
    failures: FailureConstants
    stress: StressConstants
    battery: BatteryConstants
    airspace: AirspaceConstants
    chain: ChainConstants
    plans: PlanConstants
    ways: WayConstants


def constants(config: FarmConfig, cells: tuple[int, int]) -> Constants:
    """Derive the kernel's numbers.

    Args:
        config: the farm.
        cells: sensor cells along x and y.

    Raises:
        ConfigError: the field's diagonal is too short to have a free-space loss.
    """
    what, world = config.observation, config.world
    start = 1.5 * what.sensors * world.field_x * world.field_y / (math.pi * world.sensors)
    seen = ObservationConstants(
        what.sensors,
        what.form == "printed",
        what.choice == "waiting",
        what.window,
        what.lattice,
        what.mirrored,
        what.identity,
        what.clock,
        1.0 / world.steps,
        start,
        *cells,
    )
    radio, camera = radio_constants(config), _camera(config)
    parts = (
        _fleet(config),
        _flight(config),
        _relay(config),
        radio,
        camera,
        _reward(config),
        seen,
        view_constants(config, radio, cells),
        failure_constants(config),
        stress_constants(config),
        battery_constants(config),
        airspace(config),
        chain_constants(config),
        plan_constants(config, radio, camera.reach),
        way_constants(config),
    )
    return Constants(*(_cast(part) for part in parts))


def _cast(part: Any) -> Any:
    """Cast every number to its declared type, so that an integer in a configuration triggers no recompilation."""
    numbers = {name: kind for name, kind in part.__annotations__.items() if kind in (int, float, bool)}
    return part._replace(**{name: kind(getattr(part, name)) for name, kind in numbers.items()})


def watts(dbm: float) -> float:
    """Convert dBm to W."""
    return math.pow(10.0, dbm / 10.0) / 1000.0


def _fleet(config: FarmConfig) -> FleetConstants:
    world, energy = config.world, config.energy
    dynamic = energy.load_capacitance * energy.voltage**2 * energy.clock_hz * energy.activity_factor
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
        any_plane=config.reward.nearest == "any",
    )


def _flight(config: FarmConfig) -> FlightConstants:
    energy = config.energy
    disk = energy.propellers * math.pi * energy.propeller_radius**2
    area = energy.body_area + disk
    return FlightConstants(
        physical=energy.model == "physical",
        hover_speed=energy.hover_speed,
        hover=energy.mass * energy.gravity**1.5 / (math.sqrt(2.0 * energy.air_density * area) * energy.efficiency),
        c1=0.5 * energy.air_density * area * energy.drag_coefficient,
        c2=energy.mass**2 / (energy.efficiency * energy.air_density * disk),
        weight=energy.mass * energy.gravity,
        efficiency=energy.efficiency,
        induced=energy.mass * energy.gravity / (2.0 * energy.air_density * disk),
        drag=0.5 * energy.air_density * energy.body_area * energy.drag_coefficient,
    )


def _relay(config: FarmConfig) -> RelayConstants:
    relay, world = config.relay, config.world
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
        positioning=reward.positioning * (1.0 if reward.positioning_sign == "printed" else -1.0),
        energy=-reward.energy,
        risk=-reward.collision_risk,
        boundary=-reward.boundary,
        utility=(float(reward.monitoring), float(reward.collection)),
        idle=(-float(reward.monitoring_idle), -float(reward.collection_idle)),
        motivation=(float(reward.monitoring_motivation), float(reward.collection_motivation)),
        closing=reward.risk == "closing",
        relayed=float(reward.relayed) if config.relay.require_link else 0.0,
    )
