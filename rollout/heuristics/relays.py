"""Heuristics for the communication UAVs. Each combines with any task heuristic."""

from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from eia_sec.common.config import FarmConfig, WorldConfig
from eia_sec.rollout.heuristics.composite import COLLECTORS, MONITORS, RELAYS, FarmState
from eia_sec.rollout.sim.boxes import Array
from eia_sec.rollout.sim.conditions.links import joined_relays, relay_gaps
from eia_sec.rollout.sim.core.constants import LEAST_LINK, RelayConstants, constants

GAIN: Final = 0.02
"""Fraction of the distance to its centre that a relay flies in one step."""
LAST: Final = 30
"""Number of last steps in which the search runs."""
STRIDES: Final = (3.0, 6.0, 12.0, 25.0, 50.0)
"""Lengths of the moves to try, m; each step tries one of them."""
MOVES: Final = np.array([(x, y) for x in (-1.0, 0.0, 1.0) for y in (-1.0, 0.0, 1.0) if x or y])
"""Directions of the moves to try."""
STEPS_AHEAD: Final = np.array([1.0, 2.0, 3.0])
"""Steps ahead for which links are judged."""
WAYS: Final = (4.0, 10.0, 20.0, 40.0)
"""Lengths of the ways to places that are tried, m."""
BUFFER: Final = 8.0
"""Slack below which a link counts as in danger, m."""
MONITOR: Final = 2.0
"""Worth of a monitor's link, in collectors' links: it earns about twice as much, and in every step."""
MOVING: Final = 1e-3
"""Price of a metre, in links that are down for a step."""


class CentroidRelays:
    """Each relay follows the centre of the UAVs that it serves. A relay that serves none stays in place."""

    def __init__(self, _: FarmState) -> None:
        """Keep no state."""

    def goals(self, state: FarmState) -> Array:
        """Return places on the way to the centres, [n_c, 2] m."""
        first = state.agents[0].stop
        own = state.position[:first]
        centre = served_centres(own, state.position[first:], state.assignment)
        goals: Array = own + GAIN * (centre - own)
        return goals


class SearchRelays:
    """Local search for the relay positions with the least sum of D_c, which the relays reach as the episode ends.

    The reward pays changes of D_c, which add up to D_c at the start minus D_c at the end. So only the final position
    matters, and a relay flies no faster than it must.

    Args:
        state: state at the start of the episode.
    """

    def __init__(self, state: FarmState) -> None:
        self._relay = constants(state.config).relay
        self._heights = served_heights(state)
        self._places: Array | None = None

    def goals(self, state: FarmState) -> Array:
        """Return places on the way to the best positions found so far, [n_c, 2] m."""
        first = state.agents[0].stop
        own, served = state.position[:first], state.position[first:]
        left = state.config.world.steps - state.time
        if left > LAST:
            return own.copy()
        if self._places is None:
            self._places = served_centres(own, served, state.assignment)
        stride = STRIDES[(left - 1) % len(STRIDES)]
        self._places = self._improved(state.config.world, self._places, served, stride)
        # UAVs with inertia could not fly a share of the way in each step, and stop where they are sent.
        steps = 1 if state.config.dynamics.inertial else left
        goals: Array = own + (self._places - own) / steps
        return goals

    def _improved(self, world: WorldConfig, places: Array, served: Array, stride: float) -> Array:
        """Return the places after each relay in turn makes its best move of one length or stays."""
        size = np.array([world.field_x, world.field_y])
        for relay in range(len(places)):
            tried = np.repeat(places[None], 1 + len(MOVES), axis=0)
            tried[1:, relay] = np.clip(places[relay] + stride * MOVES, 0.0, size)
            places = tried[
                np.argmin([total_service(world, self._relay, candidate, served, self._heights) for candidate in tried])
            ]
        return places


class CoverageRelays:
    """Each relay goes where most of its links are up in the coming steps, by a search over places around it.

    The UAVs that it serves are taken to keep their velocity, and the assignment to stay. A link costs its worth, 1 or
    MONITOR, for each step of STEPS_AHEAD in which it is down, and what its slack falls short of BUFFER, as a share of
    it.

    With a base station, relays also keep their chain to it together; the others are taken to stay where they are. In
    each of these steps, a place costs the worth of the links whose relay would not be joined. It also costs what the
    hop to the base station, or to the nearest relay that is joined without this one, would cost as a link that is worth
    as much as those of the relay together, and 1 at least. So a relay that is not joined finds back.

    Args:
        state: state at the start of the episode.
    """

    def __init__(self, state: FarmState) -> None:
        self._heights = served_heights(state)
        self._worth = np.repeat([MONITOR, 1.0], [len(state.of(kind)) for kind in (MONITORS, COLLECTORS)])
        first = state.agents[0].stop
        self._before = state.position[first:].copy()
        ways = np.concatenate([stride * MOVES / np.linalg.norm(MOVES, axis=1)[:, None] for stride in WAYS])
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
            if serves.any() or state.config.relay.chained:
                # The centre is one of the places, so that a relay which has lost everybody finds back.
                places = np.clip(np.concatenate([own[relay] + self._ways, centres[relay][None]]), 0.0, size)
                at = _on_the_way(state.config.world, own[relay], places)
                cost = _links_cost(state.config, at, coming[:, serves], self._heights[serves], self._worth[serves])
                if state.config.relay.chained:
                    cost += _chain_cost(state, self._worth, relay, at)
                cost += MOVING * np.linalg.norm(places - own[relay], axis=1)
                goals[relay] = places[np.argmin(cost)]
        return goals


def _links_cost(config: FarmConfig, at: Array, coming: Array, heights: Array, worth: Array) -> Array:
    """Return what places cost a relay's own links, [K]: it is at `at` [T, K, 2], its UAVs at `coming` [T, n, 2].

    `heights` [n] m and `worth` [n] are those of the UAVs and of their links.
    """
    flat = ((at[:, :, None] - coming[:, None]) ** 2).sum(axis=-1)
    slack = config.relay.link_range - np.sqrt(flat + (heights - config.world.height_communication) ** 2)
    cost: Array = (_danger(slack) @ worth).sum(axis=0)
    return cost


def _danger(slack: Array) -> Array:
    """Return what links of this slack cost for a step, m."""
    down = (slack < 0.0).astype(np.float64)
    danger: Array = down + np.clip(1.0 - slack / BUFFER, 0.0, None)
    return danger


def _on_the_way(world: WorldConfig, own: Array, places: Array) -> Array:
    """Return where a relay is after each of STEPS_AHEAD on its way to places [K, 2], [T, K, 2] m."""
    way, reach = places - own, np.array([world.speed_x_max, world.speed_y_max]) * world.step_seconds
    needed = np.maximum(np.abs(way / reach).max(axis=1), 1e-9)
    at: Array = own + way * np.minimum(1.0, STEPS_AHEAD[:, None] / needed)[..., None]
    return at


def _chain_cost(state: FarmState, worth: Array, relay: int, at: Array) -> Array:
    """Return what places cost the chain to the base station, [K], if a relay is at `at` [T, K, 2].

    `worth` [n_m + n_d] is that of each UAV's link.
    """
    config, relays = state.config, state.of(RELAYS)
    places = np.broadcast_to(relays, (*at.shape[:2], *relays.shape)).copy()
    places[:, :, relay] = at
    assigned = state.assignment >= 0
    serves = np.bincount(state.assignment[assigned], worth[assigned], len(relays))
    apart = (~joined_relays(config, places) @ serves).sum(axis=0)
    between, down = relay_gaps(config, places)
    rest = joined_relays(config, relays, np.arange(len(relays)) == relay)
    gap = np.minimum(np.where(rest, between[:, :, relay], np.inf).min(axis=-1), down[:, :, relay])
    cost: Array = apart + max(1.0, serves[relay]) * _danger(config.relay.hop_range - gap).sum(axis=0)
    return cost


def served_centres(own: Array, served: Array, assignment: NDArray[np.int64]) -> Array:
    """Return the centre of the UAVs that each relay serves, or its own position if it serves none: [n_c, 2] m."""
    serves = (assignment == np.arange(len(own))[:, None]).astype(np.float64)
    number = serves.sum(axis=1, keepdims=True)
    centres: Array = np.where(number > 0, serves @ served / np.maximum(number, 1.0), own)
    return centres


def served_heights(state: FarmState) -> Array:
    """Return the flight heights of the monitors and the collectors, [n_m + n_d] m."""
    world, numbers = state.config.world, [len(state.of(kind)) for kind in (MONITORS, COLLECTORS)]
    return np.repeat([world.height_monitoring, world.height_collection], numbers)


def total_service(world: WorldConfig, relay: RelayConstants, places: Array, served: Array, heights: Array) -> float:
    """Return the sum of D_c for relays at `places` [n_c, 2], under the assignment that results there.

    `served` [n_m + n_d, 2] m are the UAVs to serve, and `heights` [n_m + n_d] m their heights.

    Relays closer to each other than d_safety could not get there without risk, so the missing distance is added.
    """
    across = np.linalg.norm(served[:, None] - places[None], axis=2)
    apart = np.hypot(across, (heights - world.height_communication)[:, None])
    loss = 20.0 * np.log10(np.maximum(apart, LEAST_LINK)) + relay.loss_offset
    cost = relay.cost_distance * apart + relay.cost_link * loss
    _, column = linear_sum_assignment(np.repeat(cost, relay.capacity, axis=1))
    serves = (column // relay.capacity)[:, None] == np.arange(len(places))
    number = serves.sum(axis=0)
    middle = np.column_stack([served, heights])
    centre = serves.T @ middle / np.maximum(number, 1)[:, None]
    own = np.column_stack([places, np.full(len(places), world.height_communication)])
    to_centre = np.where(number > 0, np.linalg.norm(centre - own, axis=1), 0.0)
    farthest = np.where(serves, apart, 0.0).max(axis=0)
    to_relays = np.linalg.norm(places - places.mean(axis=0), axis=1)
    service = relay.weight_centroid * to_centre + relay.weight_farthest * farthest + relay.weight_relays * to_relays
    gap = np.linalg.norm(places[:, None] - places[None], axis=2)[np.triu_indices(len(places), 1)]
    return float(service.sum() + np.maximum(0.0, world.safety_distance - gap).sum())
