"""The farm: every constant of the paper's system model, with its symbol and unit.

A docstring that ends in "(ours)" marks a constant that the paper does not give; all others are from its Tables 1 and 2.
"""

import math
from dataclasses import dataclass, field
from typing import Literal

from common.config.checks import finite, not_negative, positive, within
from common.config.control import ControlConfig
from common.config.failures import FailureConfig
from common.config.observation import ObservationConfig
from common.config.sites import MAX_SENSORS, Sites, check_sites
from common.errors import ConfigError

Density = Literal["irregular", "uniform", "clustered", "banded", "patchy", "mixed"]
"""How the sensors are distributed over the field."""


@dataclass(frozen=True)
class WorldConfig:
    """Counts, geometry and clocks of the farm."""

    communication_uavs: int = 4
    """Number of communication UAVs, n_c (1 to 64)."""
    monitoring_uavs: int = 4
    """Number of monitoring UAVs, n_m (1 to 64)."""
    collection_uavs: int = 4
    """Number of data collection UAVs, n_d (1 to 64)."""
    field_x: float = 400.0
    """Width of the task space, U_x-max, m (U_x-min is 0)."""
    field_y: float = 400.0
    """Depth of the task space, U_y-max, m (U_y-min is 0)."""
    height_communication: float = 22.0
    """Flight height of the communication UAVs, H_c, m."""
    height_monitoring: float = 20.0
    """Flight height of the monitoring UAVs, H_m, m."""
    height_collection: float = 18.0
    """Flight height of the data collection UAVs, H_d, m."""
    speed_x_max: float = 10.0
    """Largest speed along x, V_x-max, m/s."""
    speed_y_max: float = 10.0
    """Largest speed along y, V_y-max, m/s."""
    sensors: int = 400
    """Number of wireless sensors, n_WS (1 to 10,000)."""
    sensor_spacing: float = 10.0
    """Smallest distance between two sampled sensors, m (ours)."""
    density: Density = "irregular"
    """Distribution of the sensors: hills, uniform, islands, crop rows, parcels, or one of these, by seed (ours)."""
    sites: Sites = ()
    """Measured positions, which replace sampled ones: [x, y] in m or [x, y, type]; `--farm-file` sets them (ours)."""
    sensor_cycles: tuple[int, ...] = (40, 50, 60)
    """AoI update cycle T_UA of each of the I_type sensor types, s."""
    plots_x: int = 20
    """Number of plots along x, n_px (1 to 256)."""
    plots_y: int = 20
    """Number of plots along y, n_py (1 to 256)."""
    vdf_cycle: int = 30
    """VDF update cycle t_v, s."""
    aoi_max: int = 5
    """Largest age of information, AoI_max, units."""
    vdf_max: int = 5
    """Largest visual data freshness counter, VDF_max, units."""
    steps: int = 500
    """Steps of one episode, lambda'_max."""
    step_seconds: float = 1.0
    """Length of one step, t_step, s."""
    start_levels: Literal["zero", "random"] = "zero"
    """AoI and VDF at the start of an episode: all 0, or uniform over 0..max (ours)."""
    cycle_phase: Literal["zero", "random"] = "zero"
    """Whether all counters rise at multiples of their cycle (W18), or each at its own random phase."""
    collision_distance: float = 2.0
    """Distance below which two UAVs at the same height are reported as a collision, m (ours)."""

    def __post_init__(self) -> None:
        """Refuse impossible counts, sizes and cycles."""
        within(
            1,
            64,
            communication_uavs=self.communication_uavs,
            monitoring_uavs=self.monitoring_uavs,
            collection_uavs=self.collection_uavs,
        )
        within(1, MAX_SENSORS, sensors=self.sensors)
        within(1, 256, plots_x=self.plots_x, plots_y=self.plots_y)
        positive(
            field_x=self.field_x,
            field_y=self.field_y,
            height_communication=self.height_communication,
            height_monitoring=self.height_monitoring,
            height_collection=self.height_collection,
            speed_x_max=self.speed_x_max,
            speed_y_max=self.speed_y_max,
            step_seconds=self.step_seconds,
            collision_distance=self.collision_distance,
        )
        not_negative(sensor_spacing=self.sensor_spacing)
        within(1, 1_000_000, steps=self.steps, aoi_max=self.aoi_max, vdf_max=self.vdf_max)
        if not self.sensor_cycles:
            raise ConfigError("sensor_cycles must name at least one sensor type.")
        for cycle in (*self.sensor_cycles, self.vdf_cycle):
            within(1, 1_000_000, cycle=cycle)
            steps = cycle / self.step_seconds
            if abs(steps - round(steps)) > 1e-9 or round(steps) < 1:
                raise ConfigError(f"a cycle of {cycle} s is not a whole number of steps of {self.step_seconds} s.")
        check_sites(self.sites, self.sensors, self.field_x, self.field_y, len(self.sensor_cycles))

    @property
    def uavs(self) -> int:
        """Number of all UAVs, n_UAV."""
        return self.communication_uavs + self.monitoring_uavs + self.collection_uavs

    @property
    def counts(self) -> tuple[int, int, int]:
        """Numbers of UAVs of each type: n_c, n_m and n_d."""
        return self.communication_uavs, self.monitoring_uavs, self.collection_uavs

    @property
    def reach(self) -> tuple[float, float]:
        """Distance at full speed in one step, as shares of the field's width and depth."""
        return self.speed_x_max * self.step_seconds / self.field_x, self.speed_y_max * self.step_seconds / self.field_y

    @property
    def safety_distance(self) -> float:
        """Safety threshold d_safety = 2 sqrt(Vx^2 + Vy^2) t_step, m (W9)."""
        return 2.0 * math.hypot(self.speed_x_max, self.speed_y_max) * self.step_seconds


@dataclass(frozen=True)
class RadioConfig:
    """The sensor-to-UAV link: path loss, noise and packets."""

    sensor_power_dbm: float = 10.0
    """Transmission power of a sensor, P_WT, dBm (ours)."""
    sensor_gain_dbi: float = 0.0
    """Antenna gain of a sensor, G_WS, dBi (ours)."""
    carrier_mhz: float = 2800.0
    """Carrier frequency, f_c, MHz."""
    bandwidth_hz: float = 20e6
    """Bandwidth, Bw, Hz."""
    temperature_k: float = 298.0
    """Absolute temperature, T_K, K."""
    boltzmann: float = 1.38e-23
    """Boltzmann's constant as the paper rounds it, k_B, J/K."""
    packet_bytes: int = 20
    """Packet length L, bytes (W16: 8 L bits enter the PLR)."""
    vegetation_scale: float = 0.2
    """Scaling factor a_1 of the vegetation loss."""
    vegetation_frequency_exponent: float = 0.5
    """Frequency exponent a_2 of the vegetation loss."""
    vegetation_distance_exponent: float = 0.3
    """Distance exponent a_3 of the vegetation loss."""
    frequency_unit: Literal["mhz", "ghz"] = "mhz"
    """Unit in which f_c enters both path losses (W12)."""
    interference: bool = False
    """Whether the strongest woken sensor of every other data collection UAV interferes (W14)."""
    q_function: Literal["approximate", "exact"] = "approximate"
    """Q(x) as 0.5 exp(-x^2 / 2), or exact (W15)."""
    delivery: Literal["bernoulli", "expected"] = "bernoulli"
    """Whether a packet succeeds at random with probability 1 - PLR, or delivers its expected share 1 - PLR (W17)."""

    def __post_init__(self) -> None:
        """Refuse impossible radio constants."""
        finite(sensor_power_dbm=self.sensor_power_dbm, sensor_gain_dbi=self.sensor_gain_dbi)
        positive(
            carrier_mhz=self.carrier_mhz,
            bandwidth_hz=self.bandwidth_hz,
            temperature_k=self.temperature_k,
            boltzmann=self.boltzmann,
            packet_bytes=self.packet_bytes,
        )
        not_negative(vegetation_scale=self.vegetation_scale)
        finite(
            vegetation_frequency_exponent=self.vegetation_frequency_exponent,
            vegetation_distance_exponent=self.vegetation_distance_exponent,
        )


@dataclass(frozen=True)
class CameraConfig:
    """Image quality of a plot."""

    image_distance: float = 25.0
    """Largest distance from UAV to grid cell for an acceptable image, d_th, m (ours)."""
    grid_x: int = 5
    """Grid cells of a plot along x, n_gx (ours)."""
    grid_y: int = 5
    """Grid cells of a plot along y, n_gy (ours)."""
    plot_threshold: float = 0.75
    """Share of acceptable cells that the image of a plot needs to succeed, Q_th (ours)."""

    def __post_init__(self) -> None:
        """Refuse grids without cells and thresholds outside 0..1."""
        positive(image_distance=self.image_distance)
        within(1, 64, grid_x=self.grid_x, grid_y=self.grid_y)
        within(0.0, 1.0, plot_threshold=self.plot_threshold)


@dataclass(frozen=True)
class EnergyConfig:
    """Flight, communication, computation and payload power."""

    model: Literal["printed", "physical"] = "printed"
    """Flight power as printed, or rotor-disk induced power plus body drag (W5)."""
    mass: float = 0.2
    """UAV mass, m_UAV, kg."""
    gravity: float = 9.8
    """Gravitational acceleration, g, m/s^2."""
    air_density: float = 1.225
    """Air density, rho_air, kg/m^3."""
    hover_speed: float = 0.1
    """Speed below which a UAV hovers, v_th, m/s."""
    drag_coefficient: float = 0.5
    """Air viscosity coefficient, C_d."""
    propellers: int = 4
    """Number of propellers, n_prp."""
    propeller_radius: float = 0.1
    """Radius of a propeller, R_prp, m."""
    efficiency: float = 0.8
    """Mechanical efficiency, eta."""
    body_area: float = 0.01
    """Fuselage area, A_surf, m^2."""
    static_power: float = 4.0
    """Static computing power, P_static, W."""
    load_capacitance: float = 6.4e-9
    """Load capacitance, C*, F."""
    voltage: float = 5.0
    """Voltage, V, V."""
    clock_hz: float = 200e6
    """Clock frequency, f*, Hz."""
    activity_factor: float = 0.5
    """Activity factor, alpha*."""
    transmit_dbm: float = 20.0
    """UAV transmission power, P_ut, dBm (W6: added in watts)."""
    receive_dbm: float = 20.0
    """UAV reception power, P_ur, dBm (W6: added in watts)."""
    camera_power: float = 2.5
    """Camera power of a monitoring UAV, P_cam, W."""
    collection_dbm: float = 40.0
    """Extra communication power of a data collection UAV, P_ec, dBm."""

    def __post_init__(self) -> None:
        """Refuse UAVs without mass, air or rotors."""
        positive(
            mass=self.mass,
            gravity=self.gravity,
            air_density=self.air_density,
            hover_speed=self.hover_speed,
            propellers=self.propellers,
            propeller_radius=self.propeller_radius,
            efficiency=self.efficiency,
        )
        not_negative(
            drag_coefficient=self.drag_coefficient,
            body_area=self.body_area,
            static_power=self.static_power,
            load_capacitance=self.load_capacitance,
            voltage=self.voltage,
            clock_hz=self.clock_hz,
            activity_factor=self.activity_factor,
            camera_power=self.camera_power,
        )
        finite(transmit_dbm=self.transmit_dbm, receive_dbm=self.receive_dbm, collection_dbm=self.collection_dbm)


@dataclass(frozen=True)
class RelayConfig:
    """Service quality D_c of the relays (communication UAVs), and the assignment of UAVs to them."""

    weight_centroid: float = 0.5
    """Weight epsilon_1 of D_cg, the distance to the centroid of the served UAVs."""
    weight_farthest: float = 0.2
    """Weight epsilon_2 of D_cf, the distance to the farthest served UAV."""
    weight_relays: float = 0.3
    """Weight epsilon_3 of D_cc, the distance to the centroid of all relays."""
    capacity: int = 0
    """Most UAVs that one relay serves; 0 means ceil((n_m + n_d) / n_c) (ours)."""
    cost_distance: float = 1.0
    """Weight of the distance, as a share of the field's diagonal, in the assignment cost (W3)."""
    cost_link: float = 1.0
    """Weight of the free-space loss, as a share of the loss at the field's diagonal, in the assignment cost (W3)."""
    require_link: bool = False
    """Whether images and packets count only while the UAV's relay is within link_range (W4)."""
    link_range: float = 150.0
    """Range of the UAV-UAV link for require_link, m (ours)."""

    def __post_init__(self) -> None:
        """Refuse negative weights and ranges."""
        not_negative(
            weight_centroid=self.weight_centroid,
            weight_farthest=self.weight_farthest,
            weight_relays=self.weight_relays,
            capacity=self.capacity,
            cost_distance=self.cost_distance,
            cost_link=self.cost_link,
        )
        positive(link_range=self.link_range)

    def capacity_for(self, world: WorldConfig) -> int:
        """Return the UAVs per relay; raise ConfigError when all relays together cannot serve everybody."""
        served = world.monitoring_uavs + world.collection_uavs
        capacity = min(served, self.capacity or math.ceil(served / world.communication_uavs))
        if capacity * world.communication_uavs < served:
            raise ConfigError(
                f"relay.capacity {capacity} times {world.communication_uavs} relays cannot serve {served} UAVs."
            )
        return capacity


@dataclass(frozen=True)
class RewardConfig:
    """Weights alpha_1 to alpha_10 of the reward, and how we read its printed terms."""

    positioning: float = 1.0
    """alpha_1, weight of the relay's change in D_c, 1/m."""
    energy: float = 0.005
    """alpha_2, weight of the energy of the step, 1/J."""
    collision_risk: float = 5.0
    """alpha_3, weight of the safety risk SR, 1/m."""
    boundary: float = 10.0
    """alpha_4, weight of the boundary violation ACT."""
    monitoring: float = 2.0
    """alpha_5, weight of the visual monitoring utility VMUF."""
    monitoring_idle: float = 0.5
    """alpha_6, penalty P_M of a step without imaging utility."""
    monitoring_motivation: float = 0.2
    """alpha_7, weight of the VDF motivation M_V."""
    collection: float = 2.0
    """alpha_8, weight of the data collection utility DCUF."""
    collection_idle: float = 0.5
    """alpha_9, penalty P_C of a step without collection utility."""
    collection_motivation: float = 0.2
    """alpha_10, weight of the AoI motivation M_D."""
    relayed: float = 0.0
    """Weight of what a relay's UAVs earn and would not without their links, where `relay.require_link` (ours)."""
    positioning_sign: Literal["corrected", "printed"] = "corrected"
    """corrected: -alpha_1 dD_c rewards a relay for closing in; printed: the sign that rewards flying away (W1)."""
    risk: Literal["closing", "printed"] = "closing"
    """closing: SR = max(0, d(t-1) - d(t)) below d_safety; printed: d(t) - d(t-1) (W8)."""
    nearest: Literal["plane", "any"] = "plane"
    """Whether the nearest UAV is one at the same height, or at any height (W10)."""

    def __post_init__(self) -> None:
        """Refuse weights that are not numbers."""
        finite(
            positioning=self.positioning,
            energy=self.energy,
            collision_risk=self.collision_risk,
            boundary=self.boundary,
            monitoring=self.monitoring,
            monitoring_idle=self.monitoring_idle,
            monitoring_motivation=self.monitoring_motivation,
            collection=self.collection,
            collection_idle=self.collection_idle,
            collection_motivation=self.collection_motivation,
            relayed=self.relayed,
        )


@dataclass(frozen=True)
class FarmConfig:
    """The whole simulated farm."""

    world: WorldConfig = field(default_factory=WorldConfig)
    radio: RadioConfig = field(default_factory=RadioConfig)
    camera: CameraConfig = field(default_factory=CameraConfig)
    energy: EnergyConfig = field(default_factory=EnergyConfig)
    relay: RelayConfig = field(default_factory=RelayConfig)
    reward: RewardConfig = field(default_factory=RewardConfig)
    observation: ObservationConfig = field(default_factory=ObservationConfig)
    control: ControlConfig = field(default_factory=ControlConfig)
    failures: FailureConfig = field(default_factory=FailureConfig)

    def __post_init__(self) -> None:
        """Refuse sections that contradict each other."""
        self.relay.capacity_for(self.world)
        self.failures.check(self.world.counts, self.world.steps)
        if self.observation.sensors > self.world.sensors:
            raise ConfigError(
                f"observation.sensors {self.observation.sensors} exceeds the {self.world.sensors} sensors there are."
            )
