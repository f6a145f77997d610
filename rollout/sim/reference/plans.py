"""Plans as the reference farm's UAVs see them, written from what they mean.

They share with the kernel the table of delivery probabilities, the constants that are ours, and the order in which
equal plans are taken.
"""

import functools
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from eia_sec.common.config import FarmConfig
from eia_sec.common.config.farm.polygons import refused
from eia_sec.common.farm import lattice_of
from eia_sec.common.farm_observation import PLAN_LOSS
from eia_sec.rollout.sim.conditions.stress import within
from eia_sec.rollout.sim.core.link import radio_constants, reach_of
from eia_sec.rollout.sim.observation.constants import PIECES, chance_table
from eia_sec.rollout.sim.observation.plans.constants import DISCOUNT, HEARD
from eia_sec.rollout.sim.observation.plans.search import NOTHING
from eia_sec.rollout.sim.observation.plans.view import LATE
from eia_sec.rollout.sim.reference.axes import place_of
from eia_sec.rollout.sim.reference.power import flight_power
from eia_sec.rollout.sim.reference.state import FarmState
from eia_sec.rollout.sim.reference.stress import growth_of_areas, living

Array = NDArray[np.float64]
Float32 = NDArray[np.float32]
Point = tuple[int, int]


class Plan(NamedTuple):
    """A path that ends at a lattice point, what it is worth in units, and the counters that it leaves, [S]."""

    point: Point
    worth: float
    counters: Float32


class Planner:
    """What the plans of one UAV reckon with.

    Args:
        farm: the farm.
        u: the UAV, a monitor or a collector.
    """

    def __init__(self, farm: FarmState, u: int) -> None:
        self._farm, self._monitors = farm, farm.kind[u] == 1
        world, reward, lattice = farm.config.world, farm.config.reward, lattice_of(farm.config.world)
        self.counts = lattice.columns, lattice.rows
        self._size, self.ways = (world.field_x, world.field_y), farm.ways
        self._sites = farm.plot_xy if self._monitors else farm.layout.sensor_xy
        self.most = float(world.vdf_max if self._monitors else world.aoi_max)
        self._unit = float(reward.monitoring if self._monitors else reward.collection) * world.step_seconds
        idle = float(reward.monitoring_idle if self._monitors else reward.collection_idle) * world.step_seconds
        self._idle = idle / self._unit if self._unit > 0.0 else 0.0
        self._heard: dict[Point, tuple[NDArray[np.int64], Float32]] = {}
        self._own = np.array([_owner(farm, u, site) == u for site in self._sites])

    def first_counters(self) -> Float32:
        """Return the counters of the UAV's own sites, and 0 for those of others, [S]."""
        now = self._farm.vdf.reshape(-1) if self._monitors else self._farm.aoi
        return np.where(self._own, now, 0.0).astype(np.float32)

    def rising(self, step: int) -> NDArray[np.bool_]:
        """Return which of the UAV's own counters rise in a step to come, as far as the team knows, [S]."""
        farm, stress = self._farm, self._farm.config.stress
        if self._monitors:
            world = farm.config.world
            usual: NDArray[np.int64] = np.full(len(self._sites), round(world.vdf_cycle / world.step_seconds))
        else:
            usual = farm.layout.sensor_cycle_steps
        known = within(farm.config, farm.patches.place, living(farm) & farm.known, self._sites)
        growth = np.maximum(growth_of_areas(farm, self._sites), np.where(known, stress.growth, 1))
        return np.asarray(self._own & (step % np.maximum(1, usual // growth) == 0))

    def served(self, point: Point) -> tuple[NDArray[np.int64], Float32]:
        """Return the sites that are served from over a lattice point, and the share of their counters, [k] each.

        Where links count, none is served from a point that no relay reaches.
        """
        if point not in self._heard:
            middle = (np.array(point) + 0.5) * self._size / self.counts
            share = self._images(middle) if self._monitors else self._packets(middle)
            if self._farm.config.relay.require_link and not self._has_link(middle):
                share = np.zeros(len(share))
            sites = np.flatnonzero(share)
            self._heard[point] = sites, share[sites].astype(np.float32)
        return self._heard[point]

    def _has_link(self, middle: Array) -> bool:
        """Return whether a relay that is joined would be within link range of a UAV of the type, relays as they are."""
        farm, world = self._farm, self._farm.config.world
        below = world.height_communication - (world.height_monitoring if self._monitors else world.height_collection)
        return any(
            math.sqrt(((farm.position[relay] - middle) ** 2).sum() + below**2) <= farm.config.relay.link_range
            for relay in farm.living(0)
            if farm.joined[relay]
        )

    def _images(self, middle: Array) -> Array:
        """Return 1 for the plots whose image would succeed, [S]."""
        world, camera = self._farm.config.world, self._farm.config.camera
        size = np.array(self._size) / (world.plots_x, world.plots_y)
        x = ((np.arange(camera.grid_x) + 0.5) / camera.grid_x - 0.5) * size[0]
        y = ((np.arange(camera.grid_y) + 0.5) / camera.grid_y - 0.5) * size[1]
        offset = self._sites - middle
        flat = (offset[:, 0, None, None] + x[:, None]) ** 2 + (offset[:, 1, None, None] + y) ** 2
        good = np.sqrt(flat + world.height_monitoring**2) < camera.image_distance
        return np.asarray(good.mean(axis=(1, 2)) >= camera.plot_threshold, np.float64)

    def _packets(self, middle: Array) -> Array:
        """Return the probabilities with which sensors' packets arrive, 0 for those hardly heard, [S]."""
        chance, limit, reach = _table(self._farm.config)
        square = ((middle - self._sites) ** 2).sum(axis=1)
        near = square <= min(reach**2, limit)
        at = np.where(near, square * (PIECES / limit), 0.0)
        piece = np.minimum(at.astype(np.int64), PIECES)
        heard = chance[piece] + (at - piece) * (chance[piece + 1] - chance[piece])
        return np.asarray(np.where(near & (heard >= HEARD), heard, 0.0))

    def step(self, plan: Plan, point: Point, factor: float) -> float:
        """Return what a plan is worth with one step more, to a neighbouring lattice point."""
        sites, share = self.served(point)
        units = 0.0
        for level, chance in zip(plan.counters[sites].tolist(), share.tolist(), strict=True):
            units += level * chance
        cost = self._flight(plan.point, point) + (self._idle if units < NOTHING else 0.0)
        return plan.worth + factor * (units - cost)

    def _flight(self, start: Point, end: Point) -> float:
        """Return the energy's part of a step, in units."""
        if self._unit <= 0.0:
            return 0.0
        across, along = np.abs(np.subtract(end, start)) * self._size / self.counts
        seconds = self._farm.config.world.step_seconds
        power = flight_power(self._farm.config.energy, math.hypot(across, along) / seconds)
        return float(self._farm.config.reward.energy * seconds * power / self._unit)

    def after(self, plan: Plan, point: Point, worth: float, step: int) -> Plan:
        """Return a plan with one step more: counters rise, and those that are served fall."""
        counters = plan.counters.copy()
        rising = self.rising(step)
        counters[rising] = np.minimum(np.float32(self.most), counters[rising] + np.float32(1))
        sites, share = self.served(point)
        counters[sites] = (counters[sites].astype(np.float64) * (1.0 - share.astype(np.float64))).astype(np.float32)
        return Plan(point, worth, counters)


@functools.lru_cache(maxsize=8)
def _table(config: FarmConfig) -> tuple[Array, float, float]:
    """Return the table of delivery probabilities, the square of its last distance, and the farthest that counts."""
    radio = radio_constants(config)
    return *chance_table(radio, config.world.height_collection), reach_of(radio, config.world.height_collection, HEARD)


def _owner(farm: FarmState, u: int, site: Array) -> int:
    """Return the UAV of a UAV's type that is nearest to a site."""
    mates = farm.living(farm.kind[u])
    return int(mates[int(((site - farm.position[mates]) ** 2).sum(axis=1).argmin())])


def worths(farm: FarmState, u: int, signs: Array, goals: Array) -> Array:
    """Return what the best plan that begins with each of nine moves is worth, in units, [9].

    Monitors who sweep along routes plan in the last steps only; before, their plans are worth nothing. None begins with
    a move that a zone refuses, whose worth is -inf.

    Args:
        farm: the farm.
        u: the UAV.
        signs: [2] of its axes.
        goals: [9, 2] where its moves lead, m.
    """
    seen, left = farm.config.observation, farm.config.world.steps - farm.time
    steps = min(seen.plan, left)
    if not plans(farm, u):
        return np.zeros(9)
    planner, start, zones = Planner(farm, u), _start(farm, u, signs), farm.layout.zones
    stopped = refused(farm.position[u], goals, zones)
    if steps == 0 or stopped.all():
        return np.where(stopped, -np.inf, 0.0)
    turns = [(int(signs[0]) * x, int(signs[1]) * y) for x in (-1, 0, 1) for y in (-1, 0, 1)]
    found: list[tuple[int, Plan]] = []
    for move in np.flatnonzero(~stopped).tolist():
        column, row = np.clip(np.add(start, turns[move]), 0, np.array(planner.counts) - 1).tolist()
        plan = Plan(start, 0.0, planner.first_counters())
        found.append((move, planner.after(plan, (column, row), planner.step(plan, (column, row), 1.0), farm.time + 1)))
    factor = 1.0
    for ahead in range(1, steps):
        factor *= DISCOUNT
        found = [
            (move, planner.after(plan, end, worth, farm.time + ahead + 1))
            for worth, move, end, plan in _kept(_longer(planner, found, turns, factor), seen.plan_paths)
        ]
    best = [max((plan.worth for first, plan in found if first == move), default=-np.inf) for move in range(9)]
    return np.array(best)


def plans(farm: FarmState, u: int) -> bool:
    """Return whether a UAV sees plans now."""
    seen, left = farm.config.observation, farm.config.world.steps - farm.time
    return seen.plan > 0 and not (farm.kind[u] == 1 and seen.route and left > LATE * seen.plan)


def plan_view(farm: FarmState, u: int, worth: Array) -> Array:
    """Return how near each move's best plan comes to the best of all, and the worth of that."""
    if not plans(farm, u):
        return np.zeros(10)
    most = float(farm.config.world.vdf_max if farm.kind[u] == 1 else farm.config.world.aoi_max)
    top = worth.max() / (most * farm.config.observation.plan)
    loss = np.where(np.isfinite(worth), worth.max() - np.where(np.isfinite(worth), worth, 0.0), np.inf)
    return np.append(np.exp(-loss / (PLAN_LOSS * most)), np.clip(top, -1.0, 1.0))


Longer = tuple[float, int, Point, Plan]
"""A plan with one step more: what it is worth, its first move, its end, and the plan that it extends."""


def _longer(planner: Planner, found: list[tuple[int, Plan]], turns: list[Point], factor: float) -> list[Longer]:
    """Return all plans with one step more that stay in the field and outside no-fly zones."""
    longer: list[Longer] = []
    ways = planner.ways
    for move, plan in found:
        for x, y in turns:
            end = plan.point[0] + x, plan.point[1] + y
            possible = 0 <= end[0] < planner.counts[0] and 0 <= end[1] < planner.counts[1]
            if possible and (ways is None or ways.allows(plan.point, end)):
                longer.append((planner.step(plan, end, factor), move, end, plan))
    return longer


def _kept(longer: list[Longer], count: int) -> list[Longer]:
    """Return `count` plans: the best of each first move, and the best others; no two with the same first move and end.

    The best ones come first, but for those that are not among the `count` best of all.
    """
    best: dict[tuple[int, Point], Longer] = {}
    for found in sorted(longer, key=lambda found: -found[0]):  # equal ones stay in their order
        best.setdefault((found[1], found[2]), found)
    unique = list(best.values())
    leads = [next(found for found in unique if found[1] == move) for move in sorted({found[1] for found in unique})]
    is_lead = [any(found is lead for lead in leads) for found in unique[:count]]
    others = np.cumsum(np.logical_not(is_lead))
    listed = [found for k, found in enumerate(unique[:count]) if is_lead[k] or others[k] <= count - len(leads)]
    return [*listed, *(lead for lead in leads if not any(lead is found for found in unique[:count]))]


def _start(farm: FarmState, u: int, signs: Array) -> Point:
    """Return the lattice point of a UAV, chosen along its own axes."""
    lattice = lattice_of(farm.config.world)
    count = np.array((lattice.columns, lattice.rows))
    own = lattice.cell((place_of(farm, u) * signs).astype(np.float32)).astype(np.int64)
    column, row = np.where(signs > 0.0, own, count - 1 - own).tolist()
    return column, row
