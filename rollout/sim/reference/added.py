"""The added observations of the reference farm, written from what they mean.

They share with the kernel the table of delivery probabilities and the constants that are ours.
"""

import functools
import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from eia_sec.common.actions.adapters import MirroredAxes, NineMoves
from eia_sec.common.config import FarmConfig
from eia_sec.common.farm import COLLECTION, MONITORING, inset_of, lattice_of
from eia_sec.common.farm_observation import FIELD_SCALE, HOLD, MOST_RISK, MOST_UNITS, field_range
from eia_sec.rollout.sim.core.link import radio_constants
from eia_sec.rollout.sim.observation.constants import PIECES, RATIO, chance_table
from eia_sec.rollout.sim.observation.fields import FLOOR
from eia_sec.rollout.sim.observation.routes import STAY
from eia_sec.rollout.sim.reference.airspace import airspace_view
from eia_sec.rollout.sim.reference.axes import place_of, signs_of
from eia_sec.rollout.sim.reference.battery import charge_view
from eia_sec.rollout.sim.reference.dynamics import held_places, motion_view
from eia_sec.rollout.sim.reference.links import link_view, links_view
from eia_sec.rollout.sim.reference.plans import plan_view, plans, worths
from eia_sec.rollout.sim.reference.routes import route_view
from eia_sec.rollout.sim.reference.state import FarmState
from eia_sec.rollout.sim.reference.stress import stress_view

Array = NDArray[np.float64]
MOVES = NineMoves().adapt(np.zeros(0, np.float32), np.arange(9, dtype=np.float32)[:, None])
"""The nine moves, [9, 2] steps along the agent's own axes."""


def added_view(farm: FarmState, u: int, signs: Array) -> Array:
    """Return the added observations of a UAV whose axes have these signs."""
    seen, kind = farm.config.observation, farm.kind[u]
    worth = worths(farm, u, signs, places(farm, u)) if kind else np.zeros(9)
    parts = [_peers(farm, u, signs)]
    parts += [velocity(farm, u) * signs] if seen.last_move else []
    parts += [motion_view(farm, u, signs, MOVES)] if farm.config.dynamics.inertial else []
    if kind > 0:
        parts += [_risk(farm, u)] if seen.closing else []
        parts += [_units(farm, u, signs)] if seen.units else []
        parts += [plan_view(farm, u, worth)] if seen.plan else []
        parts += [_fields(farm, u)] if seen.fields else []
        parts += [_maps(farm, u, signs)] if seen.coarse else []
    parts += [_phases(farm, u)] if seen.phases else []
    if seen.route and kind == 1:
        route = route_view(farm, u, signs, places(farm, u))
        parts += [
            np.append(np.arange(9) == (worth.argmax() if np.isfinite(worth).any() else STAY), route[9:])
            if plans(farm, u)
            else route
        ]
    parts += [_service(farm, u, signs)] if seen.service and kind == 0 else []
    if seen.link:
        parts += [
            link_view(farm, u, signs, places(farm, u))
            if kind
            else links_view(farm, u, signs, relay_places(farm, u, signs))
        ]
    parts += [stress_view(farm, u, signs)] if seen.stress and kind else []
    parts += [charge_view(farm, u, signs)] if seen.charge else []
    if seen.wind or seen.zones:
        parts += [airspace_view(farm, u, signs, places(farm, u) if kind else relay_places(farm, u, signs))]
    share = len(farm.living(kind)) / (farm.kind == kind).sum()
    parts += [np.array([share])] if farm.config.loses_in_flight else []
    return np.concatenate(parts)


def _world(farm: FarmState) -> tuple[Array, Array]:
    """Return the field's sides and the length of a step at full speed, [2] m each."""
    world = farm.config.world
    step = np.array([world.speed_x_max, world.speed_y_max]) * world.step_seconds
    return np.array([world.field_x, world.field_y]), step


def velocity(farm: FarmState, u: int) -> Array:
    """Return a UAV's last velocity [2] as a share of full speed; with inertia, the present one."""
    if farm.config.dynamics.inertial:
        return np.asarray(farm.velocity[u] / (_world(farm)[1] / farm.config.world.step_seconds))
    return np.asarray((farm.position[u] - farm.before[u]) / _world(farm)[1])


def nearest_of_type(farm: FarmState, u: int) -> list[int]:
    """Return the other UAVs of a UAV's type, nearest first."""
    mates = [int(o) for o in farm.living(farm.kind[u]) if o != u]
    return sorted(mates, key=lambda o: float(((farm.position[o] - farm.position[u]) ** 2).sum()))


def places(farm: FarmState, u: int) -> Array:
    """Return where the nine moves of a UAV lead, [9, 2] m: the adapters' actions, flown for one step.

    With inertia they are velocities that are held.
    """
    if farm.config.dynamics.inertial:
        return held_places(farm, u, MOVES)
    world, signs, (size, _) = farm.config.world, signs_of(farm, u), _world(farm)
    own = (place_of(farm, u) * signs).astype(np.float32)
    inset = inset_of(farm.config, MONITORING if farm.kind[u] == 1 else COLLECTION)
    action = lattice_of(world, inset).velocity(np.tile(own, (9, 1)), MOVES)
    turned = MirroredAxes().adapt(np.tile(np.append(own, signs.astype(np.float32)), (9, 1)), action).astype(np.float64)
    moved = farm.position[u] + turned * (world.speed_x_max, world.speed_y_max) * world.step_seconds
    return np.asarray(np.clip(moved, 0.0, size))


def relay_places(farm: FarmState, u: int, signs: Array) -> Array:
    """Return where the nine moves of a relay lead, [9, 2] m: at full speed along each axis, up to the border."""
    if farm.config.dynamics.inertial:
        return held_places(farm, u, MOVES)
    size, step = _world(farm)
    return np.asarray(np.clip(farm.position[u] + MOVES * signs * step, 0.0, size))


def _peers(farm: FarmState, u: int, signs: Array) -> Array:
    """Return offset, last velocity and presence of the nearest UAVs of the type, zeros for missing ones."""
    size, _ = _world(farm)
    view = np.zeros((farm.config.observation.peers, 5))
    for row, other in zip(view, nearest_of_type(farm, u), strict=False):
        row[:2] = (farm.position[other] - farm.position[u]) / size * signs
        row[2:4] = velocity(farm, other) * signs
        row[4] = 1.0
    return view.reshape(-1)


def _risk(farm: FarmState, u: int) -> Array:
    """Return SR over d_safety of each move: mean over the peer's moves, then for a peer that keeps its velocity."""
    safety, (size, step) = farm.config.world.safety_distance * farm.move_steps, _world(farm)
    own, view = places(farm, u), np.zeros((2, 9))
    for other in nearest_of_type(farm, u)[:2]:
        now = math.sqrt(((farm.position[other] - farm.position[u]) ** 2).sum())
        goes_on = np.clip(farm.position[other] + velocity(farm, other) * step * farm.move_steps, 0.0, size)
        for row, goals in enumerate((places(farm, other), goes_on[None])):
            then = np.sqrt(((own[:, None] - goals) ** 2).sum(axis=2))
            view[row] += np.where(then < farm.config.world.safety_distance, np.maximum(0.0, now - then), 0.0).mean(
                axis=1
            )
    if farm.config.dynamics.inertial:
        safety = farm.config.world.safety_distance
        on = sum(_risk_on_the_way(farm, u, other) for other in nearest_of_type(farm, u)[:2])
        return np.concatenate([view[0] / (safety * farm.move_steps), np.minimum(MOST_RISK, on / safety) * np.ones(9)])
    return view.reshape(-1) / safety


def _risk_on_the_way(farm: FarmState, u: int, other: int) -> Array:
    """Return SR of nine moves that are held, added up over their steps, beside a peer that keeps its velocity, [9]."""
    (size, step), place = _world(farm), farm.position[other]
    before, risk = np.full(9, math.dist(place, farm.position[u])), np.zeros(9)
    for steps in range(1, 2 * HOLD + 1):
        place = np.clip(place + velocity(farm, other) * step, 0.0, size)
        then = np.linalg.norm(held_places(farm, u, MOVES, steps) - place, axis=1)
        risk += np.where(then < farm.config.world.safety_distance, np.maximum(0.0, before - then), 0.0)
        before = then
    return risk


def _two_moves(farm: FarmState, u: int, signs: Array) -> Array:
    """Return the lattice points to which a second move leads after each first one, [9, 9, 2] m."""
    world = farm.config.world
    lattice, (size, _) = lattice_of(world), _world(farm)
    count = np.array([lattice.columns, lattice.rows])
    own = (place_of(farm, u) * signs).astype(np.float32)
    once = np.clip(lattice.cell(own) + MOVES, 0, count - 1)
    twice = np.clip(once[:, None] + MOVES, 0, count - 1)
    middle = (twice + 0.5) * size / count
    return np.asarray(np.where(signs > 0.0, middle, size - middle))


def _units(farm: FarmState, u: int, signs: Array) -> Array:
    """Return the units of each move over their scale, then of each move and the best one after it."""
    world = farm.config.world
    bring, worth, scale = (
        (_images, farm.vdf.reshape(-1), world.vdf_max) if farm.kind[u] == 1 else (_packets, farm.aoi, 2 * world.aoi_max)
    )
    if farm.config.dynamics.inertial:
        most = np.repeat([MOST_UNITS, 2.0 * MOST_UNITS], 9)
        passed = np.minimum(most, _passed(farm, u, bring) @ worth / scale)
        return np.asarray(passed[: 9 * farm.config.observation.units])
    first = bring(farm, u, places(farm, u))
    view = [np.minimum(MOST_UNITS, first @ worth / scale)]
    if farm.config.observation.units > 1:
        goals, which = np.unique(_two_moves(farm, u, signs).reshape(-1, 2), axis=0, return_inverse=True)
        second = bring(farm, u, goals)[which.reshape(9, 9)]
        left = worth * (1.0 - first)
        best = np.einsum("mns,ms->mn", second, left).max(axis=1)
        view.append(np.minimum(2.0 * MOST_UNITS, (first @ worth + best) / scale))
    return np.concatenate(view)


def _passed(farm: FarmState, u: int, bring: Callable[[FarmState, int, Array], Array]) -> Array:
    """Return the share of each item that nine moves serve that are held for HOLD steps, and twice as long, [18, I]."""
    missed, shares = np.ones(1), list[Array]()
    for step in range(1, 2 * HOLD + 1):
        missed = missed * (1.0 - bring(farm, u, held_places(farm, u, MOVES, step)))
        shares.append(1.0 - missed)
    return np.concatenate([shares[HOLD - 1], shares[-1]])


def _own_points(farm: FarmState, u: int, where: Array, points: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Return squares of distances from places [K, 2] to points [I, 2], and whether u would be nearest there, [K, I]."""
    square = ((where[:, None] - points) ** 2).sum(axis=2)
    own = np.ones(square.shape, bool)
    for other in farm.living(farm.kind[u]):
        if other != u:
            rival = ((points - farm.position[other]) ** 2).sum(axis=1)
            own &= (square < rival) | ((square == rival) & (u < other))
    return np.asarray(square), own


def _images(farm: FarmState, u: int, where: Array) -> Array:
    """Return 1 where the image of a plot would succeed from a place, else 0, [K, P]."""
    world, camera = farm.config.world, farm.config.camera
    size = np.array([world.field_x / world.plots_x, world.field_y / world.plots_y])
    x = ((np.arange(camera.grid_x) + 0.5) / camera.grid_x - 0.5) * size[0]
    y = ((np.arange(camera.grid_y) + 0.5) / camera.grid_y - 0.5) * size[1]
    offset = farm.plot_xy - where[:, None]
    flat = (offset[..., 0, None, None] + x[:, None]) ** 2 + (offset[..., 1, None, None] + y) ** 2
    good = np.sqrt(flat + world.height_monitoring**2) < camera.image_distance
    quality = good.sum(axis=(2, 3)) / (camera.grid_x * camera.grid_y)
    own = _own_points(farm, u, where, farm.plot_xy)[1]
    return np.asarray((quality >= camera.plot_threshold) & own, np.float64)


@functools.lru_cache(maxsize=8)
def _table(config: FarmConfig) -> tuple[Array, Array]:
    """Return squared distances and the probability of arrival there."""
    chance, limit = chance_table(radio_constants(config), config.world.height_collection)
    return np.linspace(0.0, limit, PIECES + 1, dtype=np.float64), chance[: PIECES + 1]


def _packets(farm: FarmState, u: int, where: Array) -> Array:
    """Return the probability that a sensor's packet arrives at a place, [K, S]."""
    square, own = _own_points(farm, u, where, farm.layout.sensor_xy)
    squares, chance = _table(farm.config)
    heard = own & (square <= squares[-1])
    return np.asarray(np.where(heard, np.interp(square, squares, chance), 0.0))


def _field_points(farm: FarmState, u: int) -> tuple[Array, Array]:
    """Return the points of a UAV's value field [P, 2] and their levels over the largest [P]."""
    world = farm.config.world
    if farm.kind[u] == 1:
        return farm.plot_xy, farm.vdf.reshape(-1) / world.vdf_max
    size, sums = _world(farm)[0], cell_sums(farm)
    x, y = ((np.arange(n) + 0.5) * side / n for n, side in zip(sums.shape, size, strict=True))
    points = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
    return points, sums.reshape(-1) / world.aoi_max


def cell_sums(farm: FarmState) -> Array:
    """Return the AoI in each sensor cell, [cells_x, cells_y]."""
    number = np.diff(farm.layout.cell_start)
    cell = np.repeat(np.arange(len(number)), number)
    sums = np.bincount(cell, farm.aoi, minlength=len(number))
    return np.asarray(sums.reshape(farm.layout.cells), np.float64)


def _fields(farm: FarmState, u: int) -> Array:
    """Return for both ranges how the field grows with each move, and its size here."""
    points, level = _field_points(farm, u)
    step, goals = _world(farm)[1].sum() * farm.move_steps, np.concatenate([places(farm, u), farm.position[u][None]])
    mates = farm.living(farm.kind[u])
    square = ((farm.position[mates][:, None] - points) ** 2).sum(axis=2)
    rank = np.flatnonzero(mates == u)[0]
    own, others = square[rank] + 1e-9, np.delete(square, rank, axis=0)
    rival = others.min(axis=0) + 1e-9 if len(others) else np.full(len(points), math.inf)
    share = np.where(np.isinf(rival), 1.0, rival / (own + np.where(np.isinf(rival), 0.0, rival)))
    apart, view, far = np.abs(goals[:, None] - points).sum(axis=2), [], field_range(farm.config.world)
    for width, value in ((far / RATIO, level), (far, level * np.minimum(level, 1.0))):
        field = np.exp(-apart / width) @ (share * value)
        grown = np.log((field[:9] + FLOOR) / (field[9] + FLOOR)) * width / step
        view += [grown, [FIELD_SCALE * math.log1p(field[9])]]
    return np.concatenate(view)


def _blocks(values: Array, own: NDArray[np.int64], signs: Array, blocks: int, side: int) -> Array:
    """Return the sums over blocks of cells around a cell along a UAV's own axes, x outer; cells outside are 0."""
    padded, reach = np.pad(values, blocks * side), blocks * side
    low = -(side // 2) - (blocks // 2) * side
    view = np.zeros(blocks * blocks)
    for index in np.ndindex(blocks * side, blocks * side):
        i, j = own + signs.astype(np.int64) * (np.array(index) + low) + reach
        view[index[0] // side * blocks + index[1] // side] += padded[i, j]
    return view


def _maps(farm: FarmState, u: int, signs: Array) -> Array:
    """Return the coarse maps."""
    world, (size, _) = farm.config.world, _world(farm)
    values = farm.vdf if farm.kind[u] == 1 else cell_sums(farm)
    count = np.array(values.shape)
    own = np.clip(farm.position[u] / size * count, 0, count - 1).astype(np.int64)
    if farm.kind[u] == 1:
        stale = (values >= world.vdf_max - 1).astype(np.float64)
        return np.concatenate(
            [_blocks(values, own, signs, 5, 4) / (16 * world.vdf_max), _blocks(stale, own, signs, 5, 4) / 16]
        )
    near, wide = _blocks(values, own, signs, 7, 1), _blocks(values, own, signs, 5, 4)
    return np.asarray(np.minimum(1.0, np.concatenate([near / (2 * world.aoi_max), wide / (32 * world.aoi_max)])))


def _phases(farm: FarmState, u: int) -> Array:
    """Return the elapsed share of the cycles of the counters that a UAV looks after, and the steps left."""
    world = farm.config.world
    cycles = {0: (), 1: (world.vdf_cycle,), 2: world.sensor_cycles}[int(farm.kind[u])]
    steps = [round(cycle / world.step_seconds) for cycle in cycles]
    left = world.steps - farm.time
    return np.array([*(farm.time % cycle / cycle for cycle in steps), min(1.0, left / 25), min(1.0, left / 100)])


def _service(farm: FarmState, u: int, signs: Array) -> Array:
    """Return D_c over the diagonal and its change over a diagonal step for each move at full speed."""
    size, step = _world(farm)
    step = step * farm.move_steps
    here, now, view = farm.position[u].copy(), float(farm.service[u]), []
    for place in relay_places(farm, u, signs):
        farm.position[u] = place
        view.append(farm.relay_service(u) - now)
    farm.position[u] = here
    return np.concatenate([[now / math.hypot(*size)], np.array(view) / math.hypot(*step)])
