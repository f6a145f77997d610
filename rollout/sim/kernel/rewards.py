"""The rewards r_c, r_m and r_d, part by part."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from rollout.sim.kernel.compiler.decorators import sealed
from rollout.sim.kernel.constants import Array, FleetConstants, Indices, RewardConstants
from rollout.sim.kernel.link import NEGLIGIBLE
from rollout.sim.kernel.motion import safety_risk

REWARD_PARTS: Final = ("positioning", "energy", "risk", "boundary", "utility", "idle", "motivation")
"""The parts of a reward, in the order in which they are stored; each is weighted, and the reward is their sum."""


@sealed
def reward_step(
    fleet: FleetConstants,
    weight: RewardConstants,
    previous: Array,
    neighbour: Indices,
    distance: Array,
    energy: Array,
    outside: Array,
    motivated: Array,
    utility: Array,
    service: Array,
    earlier_service: Array,
    parts: Array,
    reward: NDArray[np.float32],
) -> None:
    """Weigh what a step did.

    Every part but the energy, which is an amount already (W7), is multiplied by t_step as printed. P_M and P_C take
    less than NEGLIGIBLE for nothing, which matters to expected delivery alone: its shares never quite reach 0.

    Args:
        fleet: the UAVs.
        weight: alpha_1 to alpha_10 with their signs.
        previous: [n, 2] positions before the step, m.
        neighbour: [n] nearest UAV now.
        distance: [n] d_U, m.
        energy: [n] of this step, J.
        outside: [n] ACT.
        motivated: [n] M_V and M_D.
        utility: [n] VMUF and DCUF of this step (W20).
        service: [n_c] D_c(k), m.
        earlier_service: [n_c] D_c(k-1), m.
        parts: [n, K] out: weighted parts.
        reward: [n] out: their sums.
    """
    seconds = fleet.seconds
    for u in range(len(energy)):
        risk = safety_risk(fleet, weight.closing, previous, neighbour, distance, u)
        for part in range(parts.shape[1]):
            parts[u, part] = 0.0
        parts[u, 1] = weight.energy * energy[u]
        parts[u, 2] = weight.risk * risk * seconds
        parts[u, 3] = weight.boundary * outside[u] * seconds
        if u < fleet.relays:
            parts[u, 0] = weight.positioning * (service[u] - earlier_service[u]) * seconds
        else:
            task = 0 if u < fleet.collectors else 1
            parts[u, 4] = weight.utility[task] * utility[u] * seconds
            parts[u, 5] = weight.idle[task] * seconds if utility[u] < NEGLIGIBLE else 0.0
            parts[u, 6] = weight.motivation[task] * motivated[u] * seconds
        total = 0.0
        for part in range(parts.shape[1]):
            total += parts[u, part]
        reward[u] = total
