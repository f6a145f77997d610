"""The compiled simulator's constants of the sensors' radio link."""

import math
from typing import Annotated, Final, NamedTuple

import numpy as np

from eia_sec.common.config import FarmConfig
from eia_sec.rollout.sim.core.records import Array

NEGLIGIBLE: Final = 1e-12
"""A packet with a smaller probability of arrival is not sent (ours); this bounds the sensors that a UAV checks."""
CHANCES: Final = 256
"""Intervals of the reach with precomputed bounds on a packet's probability of arrival."""


class RadioConstants(NamedTuple):
    """The sensor link and AoI."""

    power: Annotated[float, "power received at 1 m in free space, mW"]
    vegetation: Annotated[
        float,
        "ln(10)/10 a_1 f_c^a_2, so that vegetation multiplies the power by exp(-vegetation d^a_3)",
    ]
    half_exponent: Annotated[float, "a_3 / 2"]
    noise: Annotated[float, "k_B T B, mW"]
    bits: Annotated[float, "8 L"]
    reach: Annotated[
        float,
        "horizontal distance beyond which a packet's probability of arrival is at most NEGLIGIBLE, m",
    ]
    level_max: Annotated[float, "AoI_max"]
    chances: Annotated[
        Array,
        "bounds on a packet's probability of arrival, over equal intervals of the squared distance up to the reach. "
        "In interval b it lies between chances[b, 0] and chances[b, 1]",
    ]


def loss_at_one_metre(config: FarmConfig) -> float:
    """Return the free-space loss at 1 m, dB (W12)."""
    return 20.0 * math.log10(1e-3) + 20.0 * math.log10(config.radio.carrier_mhz) + 32.44


def noise(config: FarmConfig) -> float:
    """Return k_B T B, mW (W13)."""
    return 1000.0 * config.radio.boltzmann * config.radio.temperature_k * config.radio.bandwidth_hz


def radio_constants(config: FarmConfig) -> RadioConstants:
    """Derive the radio link's numbers."""
    radio, world = config.radio, config.world
    made = RadioConstants(
        power=10.0 ** ((radio.sensor_power_dbm + radio.sensor_gain_dbi - loss_at_one_metre(config)) / 10.0),
        vegetation=math.log(10.0)
        / 10.0
        * radio.vegetation_scale
        * radio.carrier_mhz**radio.vegetation_frequency_exponent,
        half_exponent=0.5 * radio.vegetation_distance_exponent,
        noise=noise(config),
        bits=8.0 * radio.packet_bytes,
        reach=math.hypot(world.field_x, world.field_y),
        level_max=float(world.aoi_max),
        chances=np.tile((0.0, 1.0), (CHANCES, 1)),
    )
    made = made._replace(reach=reach_of(made, world.height_collection, NEGLIGIBLE))
    return made._replace(chances=_chances(made, world.height_collection))


def chance_at(radio: RadioConstants, square: float) -> float:
    """Return 1 - PLR at a distance whose square is given, m^2."""
    signal = radio.power / square * math.exp(-radio.vegetation * square**radio.half_exponent)
    sinr = signal / radio.noise
    return math.exp(radio.bits * math.log1p(-0.5 * math.exp(-sinr)))


def _chances(radio: RadioConstants, height: float) -> Array:
    """Return bounds [CHANCES, 2]. They are slightly wider than the function, so rounding cannot break them."""
    bounds = np.tile((0.0, 1.0), (CHANCES, 1))
    squares = np.linspace(0.0, radio.reach * radio.reach, CHANCES + 1) + height * height
    chance = np.array([chance_at(radio, square) for square in squares.tolist()])
    bounds[:, 0] = chance[1:] * (1.0 - 1e-6) - 1e-11
    bounds[:, 1] = chance[:-1] * (1.0 + 1e-6) + 1e-11
    return bounds


def reach_of(radio: RadioConstants, height: float, least: float) -> float:
    """Return the horizontal distance beyond which a packet's probability of arrival is less, by bisection.

    It is `radio.reach` if no distance up to there is too far.
    """
    low, high = 0.0, radio.reach
    for _ in range(200):
        middle = 0.5 * (low + high)
        square = middle * middle + height * height
        if chance_at(radio, square) < least:
            high = middle
        else:
            low = middle
    return high * (1.0 + 1e-9)
