"""What the compiled simulator knows about a farm: numbers derived once from the configuration."""

import math
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from common.config import FarmConfig
from common.errors import ConfigError

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

NEGLIGIBLE: Final = 1e-12
"""A packet with a smaller chance to arrive is not sent (ours); it bounds the sensors that a UAV has to look at.

Less utility than this counts as none."""
LEAST_LINK: Final = 1.0
"""Least distance that enters the free-space loss between two UAVs, m (ours): there is no loss at distance 0."""


class FleetConstants(NamedTuple):
    """The UAVs, in row order, and the field.

    Attributes:
        relays: n_c.
        collectors: index of the first data collection UAV, n_c + n_m.
        uavs: n_UAV.
        heights: of each type, m.
        payloads: of each type, power beside the flight power: P_comm + P_cmp and P_cam or P_ec, W.
        width: U_x-max, m.
        depth: U_y-max, m.
        diagonal: of the field, m.
        speed_x: V_x-max, m/s.
        speed_y: V_y-max, m/s.
        seconds: t_step, s.
        safety: d_safety, m (W9).
        collision: collision distance, m.
        any_plane: whether the nearest UAV is looked for in all planes (W10).
    """

    relays: int
    collectors: int
    uavs: int
    heights: tuple[float, float, float]
    payloads: tuple[float, float, float]
    width: float
    depth: float
    diagonal: float
    speed_x: float
    speed_y: float
    seconds: float
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
        capacity: UAVs that one relay serves.
        cost_distance: weight of the distance in the cost, 1/m.
        cost_link: weight of the free-space loss in the cost, 1/dB.
        loss_offset: free-space loss at 1 m, dB.
        weight_centroid: epsilon_1.
        weight_farthest: epsilon_2.
        weight_relays: epsilon_3.
        link_range: range of the UAV-UAV link, m; infinite unless `require_link` (W4).
    """

    capacity: int
    cost_distance: float
    cost_link: float
    loss_offset: float
    weight_centroid: float
    weight_farthest: float
    weight_relays: float
    link_range: float


class RadioConstants(NamedTuple):
    """The sensor link and AoI.

    Attributes:
        power: power received over 1 m of free space, mW.
        vegetation: ln(10)/10 a_1 f_c^a_2, so that vegetation multiplies the power by exp(-vegetation d^a_3).
        half_exponent: a_3 / 2.
        noise: k_B T B, mW.
        bits: 8 L.
        interference: W14.
        exact: exact Q function (W15).
        expected: expected delivery (W17).
        reach: horizontal distance beyond which no packet has more than a NEGLIGIBLE chance, m.
        level_max: AoI_max.
    """

    power: float
    vegetation: float
    half_exponent: float
    noise: float
    bits: float
    interference: bool
    exact: bool
    expected: bool
    reach: float
    level_max: float


class CameraConstants(NamedTuple):
    """Plots, their cells and VDF.

    Attributes:
        plots_x: n_px.
        plots_y: n_py.
        plot_width: m.
        plot_depth: m.
        grid_x: n_gx.
        grid_y: n_gy.
        ground_square: d_th^2 - H_m^2, the square of the ground radius of a good image, m^2.
        threshold: Q_th.
        reach: horizontal distance from the UAV beyond which no cell matters, m.
        cycle: t_v, steps.
        level_max: VDF_max.
    """

    plots_x: int
    plots_y: int
    plot_width: float
    plot_depth: float
    grid_x: int
    grid_y: int
    ground_square: float
    threshold: float
    reach: float
    cycle: int
    level_max: float


class RewardConstants(NamedTuple):
    """Weights of the reward parts, signs included.

    Attributes:
        positioning: of D_c(k) - D_c(k-1), 1/m (W1).
        energy: of the energy, 1/J.
        risk: of the safety risk, 1/m.
        boundary: of ACT.
        utility: of VMUF and DCUF.
        idle: of P_M and P_C.
        motivation: of M_V and M_D.
        closing: SR counts closing in only (W8), not the printed difference.
    """

    positioning: float
    energy: float
    risk: float
    boundary: float
    utility: tuple[float, float]
    idle: tuple[float, float]
    motivation: tuple[float, float]
    closing: bool


class ObservationConstants(NamedTuple):
    """What the UAVs see.

    Attributes:
        sensors: n.
        printed: AoI only (W24).
        waiting: sensors with an AoI above 0 come first.
        radius: where the search for the nearest sensors starts, m.
        cells_x: sensor cells along x.
        cells_y: sensor cells along y.
    """

    sensors: int
    printed: bool
    waiting: bool
    radius: float
    cells_x: int
    cells_y: int


class Constants(NamedTuple):
    """All of them."""

    fleet: FleetConstants
    flight: FlightConstants
    relay: RelayConstants
    radio: RadioConstants
    camera: CameraConstants
    reward: RewardConstants
    observation: ObservationConstants


def constants(config: FarmConfig, cells: tuple[int, int]) -> Constants:
    """Derive the kernel's numbers.

    Args:
        config: the farm.
        cells: sensor cells along x and y.

    Raises:
        ConfigError: the field is so small that its diagonal has no free-space loss.
    """
    radio = _radio(config)
    world = config.world
    density = world.sensors / (world.field_x * world.field_y)
    holding = math.sqrt(2.0 * config.observation.sensors / (math.pi * density))
    what = config.observation
    seen = ObservationConstants(
        what.sensors, what.form == "printed", what.choice == "waiting", max(radio.reach, holding), *cells
    )
    parts = (_fleet(config), _flight(config), _relay(config), radio, _camera(config), _reward(config), seen)
    return Constants(*(_cast(part) for part in parts))


def _cast(part: Any) -> Any:
    """Make every number of the declared type, so that a whole number in a configuration compiles nothing anew."""
    numbers = {name: kind for name, kind in part.__annotations__.items() if kind in (int, float, bool)}
    return part._replace(**{name: kind(getattr(part, name)) for name, kind in numbers.items()})


def watts(dbm: float) -> float:
    """Return a power given in dBm in W."""
    return math.pow(10.0, dbm / 10.0) / 1000.0


def _fleet(config: FarmConfig) -> FleetConstants:
    world, energy = config.world, config.energy
    dynamic = energy.load_capacitance * energy.voltage**2 * energy.clock_hz * energy.activity_factor
    common = watts(energy.transmit_dbm) + watts(energy.receive_dbm) + energy.static_power + dynamic
    return FleetConstants(
        relays=world.communication_uavs,
        collectors=world.communication_uavs + world.monitoring_uavs,
        uavs=world.uavs,
        heights=(float(world.height_communication), float(world.height_monitoring), float(world.height_collection)),
        payloads=(common, common + energy.camera_power, common + watts(energy.collection_dbm)),
        width=world.field_x,
        depth=world.field_y,
        diagonal=math.hypot(world.field_x, world.field_y),
        speed_x=world.speed_x_max,
        speed_y=world.speed_y_max,
        seconds=world.step_seconds,
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


def _frequency(config: FarmConfig) -> float:
    """Return f_c in the unit in which it enters the path losses (W12)."""
    return config.radio.carrier_mhz / (1000.0 if config.radio.frequency_unit == "ghz" else 1.0)


def _loss_at_one_metre(config: FarmConfig) -> float:
    return 20.0 * math.log10(1e-3) + 20.0 * math.log10(_frequency(config)) + 32.44


def _relay(config: FarmConfig) -> RelayConstants:
    relay, world = config.relay, config.world
    offset = _loss_at_one_metre(config)
    diagonal = math.hypot(world.field_x, world.field_y)
    loss = offset + 20.0 * math.log10(max(diagonal, LEAST_LINK))
    if loss <= 0.0:
        raise ConfigError(f"a field of {diagonal:g} m is too small: its diagonal has no free-space loss.")
    return RelayConstants(
        capacity=relay.capacity_for(world),
        cost_distance=relay.cost_distance / diagonal,
        cost_link=relay.cost_link / loss,
        loss_offset=offset,
        weight_centroid=relay.weight_centroid,
        weight_farthest=relay.weight_farthest,
        weight_relays=relay.weight_relays,
        link_range=relay.link_range if relay.require_link else math.inf,
    )


def _radio(config: FarmConfig) -> RadioConstants:
    radio, world = config.radio, config.world
    made = RadioConstants(
        power=10.0 ** ((radio.sensor_power_dbm + radio.sensor_gain_dbi - _loss_at_one_metre(config)) / 10.0),
        vegetation=math.log(10.0)
        / 10.0
        * radio.vegetation_scale
        * _frequency(config) ** radio.vegetation_frequency_exponent,
        half_exponent=0.5 * radio.vegetation_distance_exponent,
        noise=1000.0 * radio.boltzmann * radio.temperature_k * radio.bandwidth_hz,
        bits=8.0 * radio.packet_bytes,
        interference=radio.interference,
        exact=radio.q_function == "exact",
        expected=radio.delivery == "expected",
        reach=math.hypot(world.field_x, world.field_y),
        level_max=float(world.aoi_max),
    )
    return made._replace(reach=_reach(made, world.height_collection))


def _reach(radio: RadioConstants, height: float) -> float:
    """Return the horizontal distance beyond which packets have no chance: bisection on the monotonous power."""
    if radio.half_exponent < 0.0:
        return radio.reach  # vegetation that thins out with distance makes the power fall and rise
    low, high = 0.0, radio.reach
    for _ in range(200):
        middle = 0.5 * (low + high)
        square = middle * middle + height * height
        signal = radio.power / square * math.exp(-radio.vegetation * square**radio.half_exponent)
        sinr = signal / radio.noise
        error = 0.5 * (math.erfc(math.sqrt(sinr)) if radio.exact else math.exp(-sinr))
        if math.exp(radio.bits * math.log1p(-error)) < NEGLIGIBLE:
            high = middle
        else:
            low = middle
    return high * (1.0 + 1e-9)


def _camera(config: FarmConfig) -> CameraConstants:
    camera, world = config.camera, config.world
    square = camera.image_distance**2 - world.height_monitoring**2
    everywhere = camera.plot_threshold == 0.0
    return CameraConstants(
        plots_x=world.plots_x,
        plots_y=world.plots_y,
        plot_width=world.field_x / world.plots_x,
        plot_depth=world.field_y / world.plots_y,
        grid_x=camera.grid_x,
        grid_y=camera.grid_y,
        ground_square=square,
        threshold=camera.plot_threshold,
        reach=math.hypot(world.field_x, world.field_y) if everywhere else math.sqrt(max(square, 0.0)),
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
    )
