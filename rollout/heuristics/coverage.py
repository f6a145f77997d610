"""Relays that keep the links to the UAVs that they serve up."""

from typing import Final

import numpy as np

from rollout.heuristics.composite import FarmState
from rollout.heuristics.relays import MOVES, served_centres, served_heights
from rollout.sim.boxes import Array

STEPS_AHEAD: Final = np.array([1.0, 2.0, 3.0])
"""Steps ahead for which links are judged."""
STRIDES: Final = (4.0, 10.0, 20.0, 40.0)
"""Lengths of the ways to places that are tried, m."""
BUFFER: Final = 8.0
"""Slack below which a link counts as in danger, m."""
MOVING: Final = 1e-3
"""Price of a metre, in links that are down for a step."""


class CoverageRelays:
    """Each relay goes where most of its links are up in the coming steps, by a search over places around it.

    The UAVs that it serves are taken to keep their velocity, and the assignment to stay. A link costs 1 for each step
    of STEPS_AHEAD in which it is down, and what its slack falls short of BUFFER, as a share of it.

    Args:
        state: state at the start of the episode.
    """

    def __init__(self, state: FarmState) -> None:
        self._heights = served_heights(state)
        first = state.agents[0].stop
        self._before = state.position[first:].copy()
        ways = np.concatenate([stride * MOVES / np.linalg.norm(MOVES, axis=1)[:, None] for stride in STRIDES])
        self._ways = np.concatenate([np.zeros((1, 2)), ways])

    def goals(self, state: FarmState) -> Array:
        """Return the best places, [n_c, 2] m."""
        world, first = state.config.world, state.agents[0].stop
        own, served = state.position[:first], state.position[first:]
        size = np.array([world.field_x, world.field_y])
        coming = np.clip(served + STEPS_AHEAD[:, None, None] * (served - self._before), 0.0, size)
        self._before = served.copy()
        centres = served_centres(own, served, state.assignment)
        goals = own.copy()
        for relay in range(first):
            serves = state.assignment == relay
            if serves.any():
                # The centre is one of the places, so that a relay which has lost everybody finds back.
                places = np.clip(np.concatenate([own[relay] + self._ways, centres[relay][None]]), 0.0, size)
                cost = self._cost(state, own[relay], places, coming[:, serves], self._heights[serves])
                goals[relay] = places[np.argmin(cost)]
        return goals

    def _cost(self, state: FarmState, own: Array, places: Array, coming: Array, heights: Array) -> Array:
        """Return what going to each place [K, 2] costs, [K], with the served UAVs at `coming` [T, n, 2]."""
        world, way = state.config.world, places - own
        reach = np.array([world.speed_x_max, world.speed_y_max]) * world.step_seconds
        needed = np.maximum(np.abs(way / reach).max(axis=1), 1e-9)
        at = own + way * np.minimum(1.0, STEPS_AHEAD[:, None] / needed)[..., None]
        flat = ((at[:, :, None] - coming[:, None]) ** 2).sum(axis=-1)
        slack = state.config.relay.link_range - np.sqrt(flat + (heights - world.height_communication) ** 2)
        danger = (slack < 0.0) + np.clip(1.0 - slack / BUFFER, 0.0, None)
        cost: Array = danger.sum(axis=(0, 2)) + MOVING * np.linalg.norm(way, axis=1)
        return cost
