"""Hungarian assignment of targets, valued by the short chain of visits that starts at each.

Source: sequential assignment with the Hungarian method (Kuhn 1955), with look-ahead by rolling out a chain.
"""

import functools
from collections.abc import Callable
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from eia_sec.rollout.heuristics.composite import COLLECTORS, MONITORS, FarmState, GroupPolicy
from eia_sec.rollout.heuristics.tasks.greedy import flight_steps
from eia_sec.rollout.heuristics.tasks.targets import Targets
from eia_sec.rollout.sim.boxes import Array, aim

Indices = NDArray[np.int64]

MOST_KNOWN: Final = 2048
"""With up to this many targets, the flight times between all pairs are held in memory."""
CANDIDATES: Final = 12
"""Targets that each UAV considers: those with the largest discounted value."""
CHAIN: Final = 8
"""Visits of a chain."""
DISCOUNT: Final = 0.9
"""Discount factor per step."""
FOREIGN: Final = 0.1
"""Factor on a target's value if another UAV of the type is nearer."""


def monitors(state: FarmState) -> GroupPolicy:
    """Return monitors that are assigned to plots."""
    return HungarianGroupPolicy(state, MONITORS)


def collectors(state: FarmState) -> GroupPolicy:
    """Return collectors that are assigned to stops."""
    return HungarianGroupPolicy(state, COLLECTORS)


class HungarianGroupPolicy:
    """All UAVs are reassigned whenever one of them finishes its target.

    Args:
        state: state at the start of the episode.
        kind: the UAVs' type.
    """

    def __init__(self, state: FarmState, kind: int) -> None:
        self._kind = kind
        self._targets = Targets(state, kind)
        number = len(self._targets.centre)
        self._calm_steps = functools.partial(flight_steps, replace(state, wind=None), kind)
        self._known = self._discounts(np.arange(number)) if number <= MOST_KNOWN else None
        self.chosen: Indices = np.full(len(state.of(kind)), -1)
        self._second = self.chosen

    def goals(self, state: FarmState) -> Array:
        """Return a place in each UAV's target, or the UAV's own position if no target has value: [n_v, 2] m."""
        position, box = state.of(self._kind), self._targets.box
        value = self._targets.value(state)
        if ((self.chosen < 0) | (value[self.chosen] <= 0.0)).any():
            steps = flight_steps(state, self._kind, position[:, None], box[:, None])
            self.chosen, self._second = self._assign(value, steps)
        goals = position.copy()
        for uav in np.flatnonzero(self.chosen >= 0):
            after = box[:, self._second[uav]]
            goals[uav] = aim(position[uav], box[:, self.chosen[uav]], after, state.config.world, state.wind)
        return goals

    def _between(self, at: Indices) -> Array:
        return self._discounts(at) if self._known is None else self._known[at]

    def _discounts(self, at: Indices) -> Array:
        """Return the discounts [C, K] for flights from the given targets [C] to all targets."""
        steps = self._calm_steps(self._targets.centre[at][:, None], self._targets.box[:, None])
        discounts: Array = DISCOUNT**steps
        return discounts

    def _assign(self, value: Array, steps: Array) -> tuple[Indices, Indices]:
        """Return each UAV's target, -1 for none, and its next target, from values [K] and steps [n, K]."""
        uavs, number = steps.shape
        nearest = steps.argmin(axis=0) == np.arange(uavs)[:, None]
        share = np.where(nearest, value, FOREIGN * value)
        considered = min(CANDIDATES, number)
        first = np.argpartition(-share * DISCOUNT**steps, considered - 1, axis=1)[:, :considered].reshape(-1)
        uav = np.repeat(np.arange(uavs), considered)
        total, onward = chain_value(first, DISCOUNT ** steps[uav, first], share[uav], self._between, CHAIN)
        worth, second = np.zeros((uavs, number)), np.full((uavs, number), -1)
        worth[uav, first], second[uav, first] = total, onward
        chosen, after = np.full(uavs, -1), np.full(uavs, -1)
        rows, columns = linear_sum_assignment(worth, maximize=True)
        chosen[rows], after[rows] = np.where(worth[rows, columns] > 0.0, columns, -1), second[rows, columns]
        return chosen, after


def chain_value(
    first: Indices, factor: Array, value: Array, between: Callable[[Indices], Array], length: int
) -> tuple[Array, Indices]:
    """Return the values of chains of visits and the second target of each.

    A chain continues to the unvisited target with the largest discounted value.

    Args:
        first: [C] first target of each chain.
        factor: [C] discount for the flight to the first target.
        value: [C, K] value of each target for the UAV that would fly the chain.
        between: maps targets [C] to the discounts [C, K] for flights to all targets.
        length: number of visits.

    Returns:
        [C] sums of discounted values, [C] second targets.
    """
    chains = np.arange(len(first))
    left, at, second = value.copy(), first, first
    total = factor * left[chains, at]
    for visit in range(1, length):
        left[chains, at] = 0.0
        discounts = between(at)
        following = (left * discounts).argmax(axis=1)
        factor = factor * discounts[chains, following]
        total = total + factor * left[chains, following]
        second = following if visit == 1 else second
        at = following
    return total, second
