"""Every UAV flies to the target with the best value / (time + c) and stays until that value is 0.

Source: nearest-task allocation weighted by reward, as in greedy multi-robot task allocation (Gerkey and Mataric 2004).
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from eia_sec.rollout.heuristics.composite import COLLECTORS, MONITORS, FarmState, GroupPolicy
from eia_sec.rollout.heuristics.inertia import Inertia
from eia_sec.rollout.heuristics.tasks.targets import Targets
from eia_sec.rollout.sim.boxes import Array, aim, steps_to

OFFSET: Final = 1.0
"""c, steps."""
SEPARATION: Final = 60.0
"""Least distance between the targets of two UAVs of a type, m. It keeps targets unshared and paths apart."""


def monitors(state: FarmState) -> GroupPolicy:
    """Return monitors that choose among plots."""
    return GreedyGroupPolicy(state, MONITORS)


def collectors(state: FarmState) -> GroupPolicy:
    """Return collectors that choose among stops."""
    return GreedyGroupPolicy(state, COLLECTORS)


class GreedyGroupPolicy:
    """UAVs that look one target ahead.

    Args:
        state: state at the start of the episode.
        kind: the UAVs' type.
    """

    def __init__(self, state: FarmState, kind: int) -> None:
        self._kind = kind
        self._targets = Targets(state, kind)
        self._chosen: NDArray[np.int64] = np.full(len(state.of(kind)), -1)

    def goals(self, state: FarmState) -> Array:
        """Return a place in each UAV's target, or the UAV's own position if no target has value: [n_v, 2] m."""
        position, world, box = state.of(self._kind), state.config.world, self._targets.box
        value = self._targets.value(state)
        steps = flight_steps(state, self._kind, position[:, None], box[:, None])
        self._chosen = best_targets(value, steps, self._targets.centre, self._chosen, OFFSET, SEPARATION)
        goals = position.copy()
        for uav, target in enumerate(self._chosen):
            if target >= 0:
                onward = value / (flight_steps(state, self._kind, self._targets.centre[target], box) + OFFSET)
                onward[target] = 0.0
                goals[uav] = aim(position[uav], box[:, target], box[:, onward.argmax()], world, state.wind)
        return goals


def flight_steps(state: FarmState, kind: int, position: Array, box: Array) -> Array:
    """Return the steps of UAVs of a type to boxes; with inertia from rest to rest. As `steps_to`."""
    if not state.config.dynamics.inertial:
        return steps_to(position, box, state.config.world, state.wind)
    gap = np.maximum(0.0, np.maximum(box[0] - position, position - box[1]))
    seconds = Inertia(state.config, np.array([kind])).seconds_for(gap)
    return np.asarray(np.maximum(1.0, np.ceil(seconds / state.config.world.step_seconds)))


def best_targets(
    value: Array, steps: Array, centre: Array, kept: NDArray[np.int64], offset: float, separation: float
) -> NDArray[np.int64]:
    """Give each UAV in turn the best target far enough from those already taken.

    Args:
        value: [K] value of a visit; no UAV flies to a target of value 0.
        steps: [n, K] flight time to each target, steps.
        centre: [K, 2] centres of the targets, m.
        kept: [n] target in the previous step, -1 for none; a UAV keeps it while its value is above 0.
        offset: c, steps.
        separation: least distance between two newly chosen targets, m.

    Returns:
        [n] target of each UAV, -1 if no target has value.
    """
    free = value > 0.0
    chosen = np.where((kept >= 0) & free[kept], kept, -1)
    for uav in np.argsort(chosen < 0, kind="stable"):
        if chosen[uav] < 0 and free.any():
            chosen[uav] = np.where(free, value / (steps[uav] + offset), 0.0).argmax()
        if chosen[uav] >= 0:
            free &= np.linalg.norm(centre - centre[chosen[uav]], axis=1) >= separation
    return chosen
