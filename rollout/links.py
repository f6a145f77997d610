"""The quality of the links between relays and the UAVs that they serve."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from common.config import FarmConfig
from rollout.kernel.constants import LEAST_LINK


def link_quality(config: FarmConfig, position: NDArray[np.float64], assignment: NDArray[Any]) -> NDArray[np.float64]:
    """Return the signal-to-noise ratio of every UAV-UAV link: P_ut - FSPL - 10 lg(k_B T B), dB.

    The free-space loss is 20 lg d + 20 lg f_c + 32.44 with d in km and f_c in the unit of W12. Nothing but noise
    disturbs such a link: each relay has a channel of its own.

    Args:
        config: the farm.
        position: [..., n, 2] m, in row order.
        assignment: [..., n_m + n_d] relay of each served UAV.

    Returns:
        [..., n_m + n_d] dB.
    """
    world, radio = config.world, config.radio
    served = position[..., world.communication_uavs :, :]
    relay = np.take_along_axis(position, assignment[..., None], axis=-2)
    height = np.repeat(
        [world.height_monitoring, world.height_collection], [world.monitoring_uavs, world.collection_uavs]
    )
    offset = np.concatenate(
        [served - relay, np.broadcast_to((height - world.height_communication)[:, None], (*served.shape[:-1], 1))], -1
    )
    distance = np.maximum(np.linalg.norm(offset, axis=-1), LEAST_LINK)
    carrier = radio.carrier_mhz / (1000.0 if radio.frequency_unit == "ghz" else 1.0)
    loss = 20.0 * np.log10(distance / 1000.0) + 20.0 * math.log10(carrier) + 32.44
    noise_dbm = 10.0 * math.log10(radio.boltzmann * radio.temperature_k * radio.bandwidth_hz * 1000.0)
    quality: NDArray[np.float64] = config.energy.transmit_dbm - loss - noise_dbm
    return quality
