"""What a UAV uses, from the paper's equations (W5, W6)."""

import math

import numpy as np
from numpy.typing import NDArray

from eia_sec.common.config import EnergyConfig

Array = NDArray[np.float64]


def dbm_to_mw(dbm: Array | float) -> Array:
    """Convert dBm to mW."""
    return np.asarray(10.0 ** (np.asarray(dbm) / 10.0))


def flight_power(energy: EnergyConfig, speed: float, load: float = 1.0) -> float:
    """P_fly, W, as printed (W5); the load multiplies m g."""
    disk = energy.propellers * math.pi * energy.propeller_radius**2
    weight = load * energy.mass * energy.gravity
    area = energy.body_area + disk
    if speed < energy.hover_speed:
        return (
            math.pow(load, 1.5)
            * energy.mass
            * math.pow(energy.gravity, 1.5)
            / (math.sqrt(2.0 * energy.air_density * area) * energy.efficiency)
        )
    c1 = 0.5 * energy.air_density * area * energy.drag_coefficient
    c2 = (load * energy.mass) ** 2 / (energy.efficiency * energy.air_density * disk)
    return c1 * speed**2 + c2 / speed + weight * speed


def other_power(energy: EnergyConfig, kind: int) -> float:
    """P_comm + P_cmp and, by type (0 c, 1 m, 2 d), P_cam or P_ec, W (W6)."""
    communication = float(dbm_to_mw(energy.transmit_dbm) + dbm_to_mw(energy.receive_dbm)) / 1000.0
    dynamic = energy.load_capacitance * energy.voltage**2 * energy.clock_hz * energy.activity_factor
    extra = (0.0, energy.camera_power, float(dbm_to_mw(energy.collection_dbm)) / 1000.0)[kind]
    return communication + energy.static_power + dynamic + extra
