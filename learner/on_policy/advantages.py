"""Generalised advantage estimation (Schulman et al. 2016) over rows of experience.

    delta_t = r_t + gamma V(o_{t+1}) - V(o_t)
    A_t     = delta_t + gamma lambda A_{t+1}
    R_t     = A_t + V(o_t)

A segment's last row bootstraps: its V stands for the rest of the return. Nothing is bootstrapped from a terminal state.
"""

import numpy as np
from numpy.typing import NDArray

from eia_sec.common.team import Float32
from eia_sec.common.transitions import TERMINATED, TRANSITION, TRUNCATED
from eia_sec.learner.networks.compilation import compiled


def advantages(
    reward: Float32, value: Float32, flag: NDArray[np.uint8], discount: Float32, decay: float, *, time_limit_ends: bool
) -> Float32:
    """Return A_t of every row with a step; zeros elsewhere.

    Args:
        reward: [R, agents] scaled rewards.
        value: [R, agents] V of each row's observation.
        flag: [R] of `eia_sec.common.transitions`.
        discount: [agents] gamma.
        decay: lambda.
        time_limit_ends: whether an episode that the time limit ends counts as terminal.
    """
    found = np.zeros_like(reward)
    terminal = TERMINATED | TRUNCATED if time_limit_ends else TERMINATED
    _sweep(reward, value, np.ascontiguousarray(flag), discount, np.float32(decay), terminal, found)
    return found


@compiled
def _sweep(
    reward: Float32,
    value: Float32,
    flag: NDArray[np.uint8],
    discount: Float32,
    decay: np.float32,
    terminal: int,
    found: Float32,
) -> None:
    for row in range(len(flag) - 2, -1, -1):
        if not flag[row] & TRANSITION:
            continue
        goes_on = not flag[row] & terminal
        # The next row of a segment's last step has no step, so its advantage is 0.
        for agent in range(reward.shape[1]):
            gamma = discount[agent]
            delta = reward[row, agent] - value[row, agent]
            if goes_on:
                delta += gamma * (value[row + 1, agent] + decay * found[row + 1, agent])
            found[row, agent] = delta
