"""Receding horizon: every UAV plans some steps ahead by the reward, flies the first few, and replans.

Source: receding-horizon control with beam search over a grid, as in informative path planning (Binney and Sukhatme
2012). UAVs plan one after another, as in sequential allocation (Singh et al. 2009).
"""

import functools
from dataclasses import dataclass
from typing import Final

import numpy as np

from eia_sec.common.config import FarmConfig
from eia_sec.common.farm import lattice_of
from eia_sec.rollout.heuristics.composite import COLLECTORS, MONITORS, FarmState, GroupPolicy
from eia_sec.rollout.heuristics.detours import Airspace, airspace_of
from eia_sec.rollout.heuristics.inertia import Inertia
from eia_sec.rollout.heuristics.tasks import lawnmower
from eia_sec.rollout.heuristics.tasks.beam import Array, Flags, Indices, SearchGrid, StepReward, best_path
from eia_sec.rollout.heuristics.tasks.motion_search import CELL, Limits, Reward, best_commands, make_sites
from eia_sec.rollout.heuristics.tasks.sites import images_succeed, packet_chances, pairs_within, radio_range
from eia_sec.rollout.sim.boxes import reach
from eia_sec.rollout.sim.core.constants import constants
from eia_sec.rollout.sim.core.motion import flight_power
from eia_sec.rollout.sim.sweep_routes import plot_centres, plot_qualities

LAST: Final = 60
"""Number of last steps in which plans look further ahead, because whatever is unserved at the end is lost."""
NOBODY: Final[Indices] = np.zeros(0, np.int64)
"""The plan of a UAV that has no plan yet."""
FAINT: Final = 0.02
"""Sensors whose packets arrive with a smaller probability are ignored."""


@dataclass(frozen=True)
class Effort:
    """Size of the search for a plan.

    Attributes:
        horizon: steps that a plan looks ahead.
        width: paths that the search keeps.
        last_horizon: horizon during the last LAST steps.
        last_width: width during the last LAST steps.
        same: kept paths that may end in one place.
        discount: discount factor per step.
        hold: steps for which UAVs with inertia hold a command in a plan.
    """

    horizon: int = 16
    width: int = 32
    last_horizon: int = 30
    last_width: int = 64
    same: int = 4
    discount: float = 0.98
    hold: int = 1


EFFORT: Final = Effort()
"""The heuristic's search effort without stress. `research.experiments.search` shows what more effort gains."""
STRESS_EFFORT: Final = Effort(horizon=24, width=256, last_width=256)
"""Its effort where there can be stress: a larger search pays there, for `uneven` 2 %."""

MOTION_EFFORT: Final = Effort(horizon=40, width=200, last_horizon=40, last_width=200, same=8, discount=0.96, hold=2)
"""Its effort where UAVs have inertia."""
PIECES: Final = 80
"""Pieces of a table of probabilities along each axis."""


def monitors(state: FarmState) -> GroupPolicy:
    """Return monitors that sweep until the last steps, and where there can be stress, monitors that plan throughout.

    Where all plots are alike, no plan beats a sweep.
    """
    if state.config.dynamics.inertial:
        return MotionGroupPolicy(state, MONITORS)
    if state.config.stress.some:
        return HorizonGroupPolicy(state, MONITORS, effort_of(state.config))
    return Handover(state, lawnmower.monitors(state), HorizonGroupPolicy(state, MONITORS))


def collectors(state: FarmState) -> GroupPolicy:
    """Return collectors that plan ahead."""
    if state.config.dynamics.inertial:
        return MotionGroupPolicy(state, COLLECTORS)
    return HorizonGroupPolicy(state, COLLECTORS, effort_of(state.config))


def effort_of(config: FarmConfig) -> Effort:
    """Return the heuristic's search effort on a farm."""
    return STRESS_EFFORT if config.stress.some else EFFORT


class Handover:
    """One group policy flies until the last steps of the episode; another flies those.

    Args:
        state: state at the start of the episode.
        early: the policy that flies first.
        late: the policy that flies the last LAST steps.
    """

    def __init__(self, state: FarmState, early: GroupPolicy, late: GroupPolicy) -> None:
        self._change = state.config.world.steps - LAST
        self._early, self._late = early, late

    def goals(self, state: FarmState) -> Array:
        """Return the goals of the current policy, [n_v, 2] m."""
        return (self._early if state.time < self._change else self._late).goals(state)


class HorizonGroupPolicy:
    """UAVs plan in turn, one per step. A plan does not count what the other UAVs' plans will serve.

    Args:
        state: state at the start of the episode.
        kind: the UAVs' type.
        effort: size of the search.
    """

    def __init__(self, state: FarmState, kind: int, effort: Effort = EFFORT) -> None:
        layout = state.layout
        self._kind = kind
        self._effort = effort
        self._reward = step_reward(state.config, kind, effort.discount)
        if kind == MONITORS:
            self._grid = plot_grid(state.config)
        else:
            self._grid = sensor_grid(state.config, layout.sensor_xy)
        if state.layout.zones:
            airspace = airspace_of(state.config, state.layout)
            self._grid = self._grid._replace(free=free_moves(self._grid.place, self._grid.rows, airspace))
        self._plans: list[Indices] = [NOBODY] * len(state.of(kind))

    def goals(self, state: FarmState) -> Array:
        """Return the next place on each plan, [n_v, 2] m."""
        count = len(self._plans)
        self._plans = [plan[1:] for plan in self._plans]
        for uav in range(count):
            if state.time % count == uav or len(self._plans[uav]) == 0:
                self._plans[uav] = self._plan(state, uav)
        return self._grid.place[[plan[0] for plan in self._plans]]

    def _plan(self, state: FarmState, uav: int) -> Indices:
        """Return the places [H] that a UAV will fly over."""
        ahead, effort = state.config.world.steps - state.time, self._effort
        late = ahead <= LAST
        most, width = (effort.last_horizon, effort.last_width) if late else (effort.horizon, effort.width)
        horizon = max(1, min(most, ahead))
        position, place = state.of(self._kind), self._grid.place
        others = np.empty((horizon + 1, len(position) - 1, 2))
        for column, other in enumerate(np.flatnonzero(np.arange(len(position)) != uav)):
            plan = self._plans[other][:horizon]
            others[0, column] = position[other]
            others[1 : 1 + len(plan), column] = place[plan]
            others[1 + len(plan) :, column] = others[len(plan), column]
        claimed = np.concatenate([plan for index, plan in enumerate(self._plans) if index != uav] or [NOBODY])
        start = int(np.abs(place - position[uav]).max(axis=1).argmin())
        levels = self._levels(state, horizon)
        return best_path(self._grid, self._reward, start, levels, claimed, others, width, effort.same)

    def _levels(self, state: FarmState, horizon: int) -> Array:
        """Return the counters [horizon, S] that the coming steps would credit if no UAV served anything."""
        return coming_levels(state, self._kind, horizon)


class MotionGroupPolicy:
    """UAVs with inertia plan commands in turn, one per step, as `HorizonGroupPolicy` does places.

    Args:
        state: state at the start of the episode.
        kind: the UAVs' type.
        effort: size of the search.
    """

    def __init__(self, state: FarmState, kind: int, effort: Effort = MOTION_EFFORT) -> None:
        config, world, dynamics = state.config, state.config.world, state.config.dynamics
        self._kind, self._effort = kind, effort
        own = step_reward(config, kind, effort.discount)
        boundary = -config.reward.boundary
        self._reward = Reward(own.unit, own.idle, own.risk, own.safety, boundary, own.discount)
        self._inertia = Inertia(config, np.full(len(state.of(kind)), kind))
        most, jerk, delay = (dynamics.of_types(name)[kind] for name in ("acceleration", "jerk", "delay"))
        top = self._inertia.top[0]
        size = (world.field_x, world.field_y)
        self._limits = Limits(most, jerk, delay, float(top[0]), float(top[1]), world.step_seconds, *size)
        if kind == MONITORS:
            self._sites = make_sites(plot_centres(world), size, *image_table(config))
        else:
            self._sites = make_sites(state.layout.sensor_xy, size, *packet_table(config))
        self._barred = barred_cells(state)
        self._commands: list[Array] = [np.zeros((0, 2))] * len(state.of(kind))
        self._places = list(self._commands)

    def goals(self, state: FarmState) -> Array:
        """Return where each UAV would stop after the next command of its plan, [n_v, 2] m; steering finds it again."""
        count = len(self._commands)
        self._commands = [plan[1:] for plan in self._commands]
        self._places = [plan[1:] for plan in self._places]
        for uav in range(count):
            if state.time % count == uav or len(self._commands[uav]) == 0:
                self._plan(state, uav)
        motion = state.motion[state.agents[self._kind]]
        way = self._inertia.stopping_way(motion, np.stack([plan[0] for plan in self._commands]))
        return np.asarray(state.of(self._kind) + way)

    def _plan(self, state: FarmState, uav: int) -> None:
        """Plan a UAV's commands anew."""
        ahead, effort = state.config.world.steps - state.time, self._effort
        late = ahead <= LAST
        most, width = (effort.last_horizon, effort.last_width) if late else (effort.horizon, effort.width)
        horizon = max(1, min(most, ahead))
        position = state.of(self._kind)
        others = np.empty((horizon + 1, len(position) - 1, 2))
        for column, other in enumerate(np.flatnonzero(np.arange(len(position)) != uav)):
            plan = self._places[other][:horizon]
            others[0, column] = position[other]
            others[1 : 1 + len(plan), column] = plan
            others[1 + len(plan) :, column] = others[len(plan), column]
        rest = [plan for index, plan in enumerate(self._places) if index != uav]
        self._commands[uav], self._places[uav] = best_commands(
            self._sites,
            self._limits,
            self._reward,
            position[uav],
            state.motion[state.agents[self._kind]][uav],
            coming_levels(state, self._kind, horizon),
            np.concatenate([*rest, np.zeros((0, 2))]),
            others,
            self._barred,
            width,
            effort.same,
            effort.hold,
        )


@functools.lru_cache(maxsize=8)
def image_table(config: FarmConfig) -> tuple[Array, float]:
    """Return whether images of a plot succeed by the distance from its centre along both axes; see `Sites`."""
    far = max(1.0, constants(config).added.image_reach)
    offsets = _offsets(far)
    good = plot_qualities(config, offsets) >= config.camera.plot_threshold
    return good.reshape(PIECES, PIECES).astype(np.float64), far


@functools.lru_cache(maxsize=8)
def packet_table(config: FarmConfig) -> tuple[Array, float]:
    """Return the probability of a packet by the distance from its sensor along both axes; see `Sites`."""
    far = max(1.0, radio_range(config, FAINT))
    return packet_chances(config, np.linalg.norm(_offsets(far), axis=1)).reshape(PIECES, PIECES), far


def _offsets(far: float) -> Array:
    """Return the middles of the squares of a table as far as a distance along both axes, [PIECES^2, 2] m."""
    middle = (np.arange(PIECES) + 0.5) * far / PIECES
    return np.stack(np.meshgrid(middle, middle, indexing="ij"), axis=-1).reshape(-1, 2)


def barred_cells(state: FarmState) -> Flags:
    """Return the cells of the search in which zones lie, [columns, rows]; none without zones."""
    if not state.layout.zones:
        return np.zeros((0, 0), np.bool_)
    world = state.config.world
    counts = [max(1, int(side / CELL)) for side in (world.field_x, world.field_y)]
    x, y = ((np.arange(n) + 0.5) * side / n for n, side in zip(counts, (world.field_x, world.field_y), strict=True))
    return airspace_of(state.config, state.layout).inside(np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1))


def coming_levels(state: FarmState, kind: int, horizon: int) -> Array:
    """Return the counters [horizon, S] of plots or sensors that the coming steps would credit if nothing was served."""
    world = state.config.world
    if kind == MONITORS:
        now, cycle, most = state.vdf, state.cycles[0], world.vdf_max
    else:
        now, cycle, most = state.aoi, state.cycles[1], world.aoi_max
    then = state.time + np.arange(horizon)[:, None]
    rises = then // cycle - state.time // cycle
    levels: Array = np.minimum(now + rises, float(most))
    return levels


def step_reward(config: FarmConfig, kind: int, discount: float) -> StepReward:
    """Return the reward of UAVs of a type for one step. Both UAVs of a pair pay for closing in."""
    reward, world = config.reward, config.world
    flight, across = constants(config).flight, reach(world) / world.step_seconds
    speeds = 0.0, float(across.mean()), float(np.hypot(*across))
    still, straight, diagonal = (-reward.energy * flight_power(flight, v) * world.step_seconds for v in speeds)
    monitoring = kind == MONITORS
    return StepReward(
        unit=float(reward.monitoring if monitoring else reward.collection),
        idle=-float(reward.monitoring_idle if monitoring else reward.collection_idle),
        risk=-2.0 * reward.collision_risk,
        safety=world.safety_distance,
        flight=(still, straight, diagonal),
        discount=discount,
    )


@functools.lru_cache(maxsize=8)
def plot_grid(config: FarmConfig) -> SearchGrid:
    """Return the grid with the plots that a UAV can image from each place."""
    place, rows = _places(config)
    far = config.camera.image_distance + 2.0 * reach(config.world).max()
    node, plot, _ = pairs_within(place, plot_centres(config.world), far)
    return _grid(place, rows, node, plot, images_succeed(config, place[node], plot).astype(np.float64))


@functools.lru_cache(maxsize=64)
def _sensor_grid(config: FarmConfig, sensors: bytes) -> SearchGrid:
    place, rows = _places(config)
    node, sensor, distance = pairs_within(place, np.frombuffer(sensors).reshape(-1, 2), radio_range(config, FAINT))
    chance = packet_chances(config, distance)
    return _grid(place, rows, node, sensor, np.where(chance > FAINT, chance, 0.0))


def sensor_grid(config: FarmConfig, xy: Array) -> SearchGrid:
    """Return the grid with the sensors [S, 2] that a UAV can hear from each place."""
    return _sensor_grid(config, xy.tobytes())


def _places(config: FarmConfig) -> tuple[Array, int]:
    """Return the points of the farm's lattice, [K, 2] m, and its number of places along y."""
    lattice = lattice_of(config.world)
    size, counts = (config.world.field_x, config.world.field_y), (lattice.columns, lattice.rows)
    x, y = ((np.arange(count) + 0.5) * width / count for count, width in zip(counts, size, strict=True))
    return np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2), int(counts[1])


def _grid(place: Array, rows: int, node: Indices, site: Indices, chance: Array) -> SearchGrid:
    """Return a grid from triples (node, site, chance), [P] each. Triples with chance 0 are left out."""
    node, site, chance = node[chance > 0.0], site[chance > 0.0], chance[chance > 0.0]
    first = np.searchsorted(node, np.arange(len(place) + 1)).astype(np.int64)
    return SearchGrid(place, rows, first, site, chance, np.ones((len(place), 3, 3), np.bool_))


def free_moves(place: Array, rows: int, airspace: Airspace) -> Flags:
    """Return which moves between neighbouring places [K, 2] m no zone refuses, [K, 3, 3].

    Staying is always possible, and so is leaving a place in a zone, which a UAV next to the zone may be nearest to.
    """
    grid = place.reshape(-1, rows, 2)
    free, inside = np.ones((*grid.shape[:2], 3, 3), np.bool_), airspace.inside(grid)
    for x in range(-1, 2):
        for y in range(-1, 2):
            if x or y:
                to = np.roll(grid, (-x, -y), axis=(0, 1))
                free[..., x + 1, y + 1] = ~airspace.inside(to) & (inside | ~airspace.refused(grid, to))
    return free.reshape(-1, 3, 3)
