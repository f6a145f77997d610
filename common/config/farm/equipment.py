"""What UAVs and sensors carry: radios, cameras and rotors.

All of it is constants of the paper's physics; none is an option.

A docstring that ends in "(ours)" marks a constant that the paper does not give; all others are from its Tables 1 and 2.
"""

from dataclasses import dataclass
from typing import ClassVar


@dataclass(frozen=True)
class RadioConfig:
    """The sensor-to-UAV link: path loss, noise and packets."""

    sensor_power_dbm: ClassVar[float] = 10.0
    """Transmission power of a sensor, P_WT, dBm (ours)."""
    sensor_gain_dbi: ClassVar[float] = 0.0
    """Antenna gain of a sensor, G_WS, dBi (ours)."""
    carrier_mhz: ClassVar[float] = 2800.0
    """Carrier frequency, f_c, MHz, the unit in which it enters both path losses (W12)."""
    bandwidth_hz: ClassVar[float] = 20e6
    """Bandwidth, Bw, Hz."""
    temperature_k: ClassVar[float] = 298.0
    """Absolute temperature, T_K, K."""
    boltzmann: ClassVar[float] = 1.38e-23
    """Boltzmann's constant as the paper rounds it, k_B, J/K."""
    packet_bytes: ClassVar[int] = 20
    """Packet length L, bytes (W16: 8 L bits enter the PLR)."""
    vegetation_scale: ClassVar[float] = 0.2
    """Scaling factor a_1 of the vegetation loss."""
    vegetation_frequency_exponent: ClassVar[float] = 0.5
    """Frequency exponent a_2 of the vegetation loss."""
    vegetation_distance_exponent: ClassVar[float] = 0.3
    """Distance exponent a_3 of the vegetation loss."""


@dataclass(frozen=True)
class CameraConfig:
    """Image quality of a plot."""

    image_distance: ClassVar[float] = 25.0
    """Largest distance from UAV to grid cell for an acceptable image, d_th, m (ours)."""
    grid_x: ClassVar[int] = 5
    """Grid cells of a plot along x, n_gx (ours)."""
    grid_y: ClassVar[int] = 5
    """Grid cells of a plot along y, n_gy (ours)."""
    plot_threshold: ClassVar[float] = 0.75
    """Share of acceptable cells that the image of a plot needs to succeed, Q_th (ours)."""


@dataclass(frozen=True)
class EnergyConfig:
    """Flight power as printed (W5), communication, computation and payload power."""

    mass: ClassVar[float] = 0.2
    """UAV mass, m_UAV, kg."""
    gravity: ClassVar[float] = 9.8
    """Gravitational acceleration, g, m/s^2."""
    air_density: ClassVar[float] = 1.225
    """Air density, rho_air, kg/m^3."""
    hover_speed: ClassVar[float] = 0.1
    """Speed below which a UAV hovers, v_th, m/s."""
    drag_coefficient: ClassVar[float] = 0.5
    """Air viscosity coefficient, C_d."""
    propellers: ClassVar[int] = 4
    """Number of propellers, n_prp."""
    propeller_radius: ClassVar[float] = 0.1
    """Radius of a propeller, R_prp, m."""
    efficiency: ClassVar[float] = 0.8
    """Mechanical efficiency, eta."""
    body_area: ClassVar[float] = 0.01
    """Fuselage area, A_surf, m^2."""
    static_power: ClassVar[float] = 4.0
    """Static computing power, P_static, W."""
    load_capacitance: ClassVar[float] = 6.4e-9
    """Load capacitance, C*, F."""
    voltage: ClassVar[float] = 5.0
    """Voltage, V, V."""
    clock_hz: ClassVar[float] = 200e6
    """Clock frequency, f*, Hz."""
    activity_factor: ClassVar[float] = 0.5
    """Activity factor, alpha*."""
    transmit_dbm: ClassVar[float] = 20.0
    """UAV transmission power, P_ut, dBm (W6: added in watts)."""
    receive_dbm: ClassVar[float] = 20.0
    """UAV reception power, P_ur, dBm (W6: added in watts)."""
    camera_power: ClassVar[float] = 2.5
    """Camera power of a monitoring UAV, P_cam, W."""
    collection_dbm: ClassVar[float] = 40.0
    """Extra communication power of a data collection UAV, P_ec, dBm."""
