"""What the UAVs of a farm observe: one table of its parts, from which names, sizes, bounds and the docs follow.

To add an observation, add its row here, write its numbers in `rollout/sim/observation/added.py`, at the same place in
the order, and in the reference, `rollout/sim/reference/added.py`. The bounds hold in every state; no value is clipped
to meet them. UAVs never leave the field, so an offset is at most 1. A distance is three-dimensional but divided by the
field's two-dimensional diagonal, so it may exceed 1 where two UAVs fly at different heights.
"""

import functools
import math
from collections.abc import Sequence
from typing import Final, NamedTuple

from eia_sec.common.config import DynamicsConfig, FarmConfig, WorldConfig

COMMUNICATION: Final = "communication"
MONITORING: Final = "monitoring"
COLLECTION: Final = "collection"
TYPES: Final = (COMMUNICATION, MONITORING, COLLECTION)
"""The types in row order."""

SENSOR_SCALE: Final = 50.0
"""Offset to a sensor that is observed as 1, m; larger ones are clipped (ours, so that near sensors stay distinct)."""
MOST_UNITS: Final = 2.0
"""Most units of one move that are seen, over their scale; two moves may bring twice as many (ours)."""
MOST_RISK: Final = 4.0
"""Most risk of a move that is held that is seen, over d_safety (ours)."""
PLAN_LOSS: Final = 0.25
"""Loss that marks a plan with 1/e, as a share of a full item (ours)."""
FIELD_SCALE: Final = 0.2
"""Scale of the logarithm of 1 + a value field (ours)."""
FIELD_RANGE: Final = 120.0
"""Range of the far value field, m (ours)."""
FIELD_RANGES: Final = 1000.0
"""Most ranges in the field's longer side; in a wider field the range grows, so that no exponential overflows (ours)."""
BLOCK: Final = 4
"""Plots or sensor cells along each side of a block of the coarse maps (ours)."""
BLOCKS: Final = 5
"""Blocks along each side of a map (ours)."""
CELLS: Final = 7
"""Sensor cells along each side of the map of single cells (ours)."""
ROUTE_PLOTS: Final = 4
"""Plots on its sweep route that a monitoring UAV sees (ours)."""
ROUTE_OFFSET: Final = 2.0
"""Largest observed offset to one of them (ours)."""
SOON, LATER = 25, 100
"""Steps before the end at which the two counts of the steps left begin to fall (ours)."""

HOLD: Final = 3
"""Steps for which UAVs with inertia are taken to hold a velocity that they see as a move (ours)."""

PLAN: Final = "plan"
ROUTE: Final = "route"

INERTIAL: Final = "farm.dynamics.model inertial"
CHAIN: Final = "link, with a base station"
OFFSET: Final = "offset (dx / X, dy / Y)"
SLACK: Final = "link range less distance, over the range, clipped"

DIAGONAL: Final = math.sqrt(0.5)
"""Largest component of D_VDF and D_AoI, which are unit diagonals or 0."""
ROUNDING: Final = 1.0 + 1e-12
"""Allowance for the order of float64 operations in a distance before it is rounded to float32."""
STEP_ROUNDING: Final = 1.0 + 1e-9
"""The same for differences of distances over a short step."""
FIELD_ROUNDING: Final = 4e-6
"""Rounding of the logarithm of a value field, which is a sum of float32."""


class Part(NamedTuple):
    """Consecutive numbers of an observation that share bounds and meaning.

    Attributes:
        label: short name.
        names: of each number, as in exported policies.
        low: lower bound.
        high: upper bound.
        meaning: what the numbers mean.
        when: the option of `farm.observation`, or what else, that adds them; empty if they are always there.
    """

    label: str
    names: tuple[str, ...]
    low: float
    high: float
    meaning: str
    when: str = ""

    @property
    def size(self) -> int:
        """Count of numbers."""
        return len(self.names)


class _Table(list[Part]):
    """Rows of the table."""

    def add(
        self, present: object, when: str, label: str, names: Sequence[str], low: float, high: float, meaning: str
    ) -> None:
        """Add a part if it is present."""
        if present:
            self.append(Part(label, tuple(names), float(low), float(high), meaning, when))


@functools.lru_cache(maxsize=256)
def observation_parts(farm: FarmConfig, name: str) -> tuple[Part, ...]:
    """Return the parts of the observation of a type, in their order."""
    seen, table = farm.observation, _Table()
    table.add(True, "", "place", ("x", "y"), -1, 1, "own (x, y), 2 x / X - 1")
    signs = "of the agent's axes, 1 or -1; they scale values along the axes and flip the VDF window"
    table.add(seen.mirrored, "mirrored", "signs", ("sign_x", "sign_y"), -1, 1, signs)
    {COMMUNICATION: _see_team, MONITORING: _see_plots, COLLECTION: _see_sensors}[name](farm, table)
    _see_others(farm, name, table)
    if name == COMMUNICATION:
        _see_served(farm, table)
    else:
        _see_task(farm, name, table)
    _see_conditions(farm, name, table)
    rank = [f"rank_{index}" for index in range(farm.world.counts[TYPES.index(name)])]
    table.add(seen.identity, "identity", "rank", rank, 0, 1, "one-hot index of the agent within its type")
    table.add(seen.clock, "clock", "clock", ["clock"], 0, 1, "fraction of the episode that has passed")
    return tuple(table)


def observation_names(farm: FarmConfig, name: str) -> tuple[str, ...]:
    """Return the name of each number of the observation of a type."""
    return tuple(each for part in observation_parts(farm, name) for each in part.names)


def _see_team(farm: FarmConfig, table: _Table) -> None:
    world = farm.world
    served = _apart(world, world.height_communication, (world.height_monitoring, world.height_collection))
    _see_place(table, "nearest relay", "nearest_relay", 1)
    _see_place(table, "centroid of all relays", "relay_centroid", 1)
    _see_place(table, "centroid of those served", "served_centroid", served)
    _see_place(table, "farthest served", "farthest_served", served)
    _see_nearest(farm, world.height_communication, table)


def _see_plots(farm: FarmConfig, table: _Table) -> None:
    window = farm.observation.window
    around = f"VDF over its largest value of the {window} x {window} plots around, x outer; 0 outside"
    table.add(True, "", "VDF", _square("vdf", window), 0, 1, around)
    most = "unit diagonal to the quadrant with most VDF; 0 if there is none"
    table.add(True, "", "D_VDF", ("d_vdf_x", "d_vdf_y"), -DIAGONAL, DIAGONAL, most)
    _see_nearest(farm, farm.world.height_monitoring, table)
    middle = "offset to the middle of the own plot over half a plot"
    table.add(farm.observation.lattice, "lattice", "place in the plot", ("plot_dx", "plot_dy"), -1, 1, middle)


def _see_sensors(farm: FarmConfig, table: _Table) -> None:
    printed = farm.observation.form == "printed"
    label, offset = "sensors" if printed else "sensor", f"offset (dx, dy) over {SENSOR_SCALE:g} m, clipped"
    for k in range(farm.observation.sensors):
        table.add(True, "", label, [f"sensor_{k}_aoi"], 0, 1, "AoI over its largest value")
        table.add(not printed, "", label, _offset(f"sensor_{k}"), -1, 1, offset)
    most = "unit diagonal to the quadrant with most AoI; 0 if there is none"
    table.add(True, "", "D_AoI", ("d_aoi_x", "d_aoi_y"), -DIAGONAL, DIAGONAL, most)
    _see_nearest(farm, farm.world.height_collection, table)


def _see_others(farm: FarmConfig, name: str, table: _Table) -> None:
    seen, offset = farm.observation, f"{OFFSET} of the nearest, second nearest .. of the type; 0 if none"
    for k in range(seen.peers):
        table.add(True, "peers", "peer", _offset(f"peer_{k}"), -1, 1, offset)
        table.add(True, "peers", "peer", _xy(f"peer_{k}_velocity"), -1, 1, "its last velocity over full speed")
        table.add(True, "peers", "peer", [f"peer_{k}_present"], 0, 1, "1 if there is one")
    last = "own, over full speed; with inertia the present one"
    table.add(seen.last_move, "last_move", "last velocity", _xy("last_velocity"), -1, 1, last)
    if farm.dynamics.inertial:
        _see_motion(table)


def _see_motion(table: _Table) -> None:
    table.add(True, INERTIAL, "motion", _xy("acceleration"), -1, 1, "own acceleration over its limit")
    table.add(True, INERTIAL, "motion", _xy("command"), -1, 1, "last commanded velocity over full speed")
    stop = "way to where it can stop, over the longest such way"
    table.add(True, INERTIAL, "motion", _xy("stop"), -ROUNDING, ROUNDING, stop)
    overruns = "1 for each of nine moves after a step of which it cannot stop in the field and before a zone"
    table.add(True, INERTIAL, "motion", nine_names("overruns"), 0, 1, overruns)


def _see_left(farm: FarmConfig, table: _Table) -> None:
    left = f"steps left over {SOON} and over {LATER}, at most 1"
    table.add(farm.observation.phases, "phases", "left", (f"left_{SOON}", f"left_{LATER}"), 0, 1, left)


def _see_task(farm: FarmConfig, name: str, table: _Table) -> None:
    seen, world, monitor, held = farm.observation, farm.world, name == MONITORING, farm.dynamics.inertial
    if seen.closing:
        _see_risk(held, table)
    unit = "VDF over its largest value" if monitor else "AoI over twice its largest value"
    brings = f"{unit} that each of nine moves would bring, clipped"
    table.add(seen.units > 0, "units", "units", nine_names("units_1"), 0, MOST_UNITS, brings)
    longer = f"that each would bring if held for {2 * HOLD} steps" if held else "of each move and the best after it"
    brings = f"{unit} {longer}, clipped"
    table.add(seen.units > 1, "units", "units of two", nine_names("units_2"), 0, 2.0 * MOST_UNITS, brings)
    loses = f"the best plan of {seen.plan} steps that begins with it loses, in full items"
    table.add(seen.plan, "plan", "plan", nine_names(PLAN), 0, 1, f"e to the minus {1 / PLAN_LOSS:g} times what {loses}")
    worth = "worth of the best plan of all in full items for each step, clipped"
    table.add(seen.plan, "plan", "plan", ["plan_best"], -1, 1, worth)
    grown, points = 1.0 + field_rounding(world), world.plots_x * world.plots_y if monitor else world.sensors
    most, here = FIELD_SCALE * math.log1p(points) * STEP_ROUNDING, f"{FIELD_SCALE:g} ln(1 + field) at the own place"
    growth = "logarithm of its growth with each of nine moves"
    for reach in ("near", "far"):
        table.add(seen.fields, "fields", f"{reach} field", nine_names(reach), -grown, grown, growth)
        table.add(seen.fields, "fields", f"{reach} field", [f"{reach}_here"], 0, most, here)
    blocks = f"of {BLOCKS} x {BLOCKS} blocks of {BLOCK} x {BLOCK}"
    if monitor:
        vdf = f"mean VDF over its largest value {blocks} plots, x outer"
        table.add(seen.coarse, "coarse", "blocks", _square("block_vdf", BLOCKS), 0, 1, vdf)
        stale = "share of the plots with VDF_max - 1 or more"
        table.add(seen.coarse, "coarse", "stale blocks", _square("block_stale", BLOCKS), 0, 1, stale)
    else:
        aoi = f"AoI over twice its largest value of {CELLS} x {CELLS} sensor cells, x outer, clipped"
        table.add(seen.coarse, "coarse", "cells", _square("cell_aoi", CELLS), 0, 1, aoi)
        aoi = f"mean of the same, without clipping, {blocks} cells, clipped"
        table.add(seen.coarse, "coarse", "blocks", _square("block_aoi", BLOCKS), 0, 1, aoi)
    phases = ["vdf_phase"] if monitor else [f"aoi_phase_{k}" for k in range(len(world.sensor_cycles))]
    table.add(seen.phases, "phases", "phase", phases, 0, 1, "elapsed share of the counters' cycle")
    _see_left(farm, table)
    if monitor:
        follows = "1 for the one of nine moves that follows the own sweep route"
        table.add(seen.route, "route", "route", nine_names(ROUTE), 0, 1, follows)
        ahead = "offset to the next, second next .. plot on the route over 20 m, clipped"
        for k in range(ROUTE_PLOTS):
            plot = _offset(f"{ROUTE}_{k + 1}")
            table.add(seen.route, "route", "plot ahead", plot, -ROUTE_OFFSET, ROUTE_OFFSET, ahead)
    table.add(seen.link, "link", "relay", _offset("relay"), -1, 1, f"{OFFSET} to the own relay; 0 if none")
    table.add(seen.link, "link", "link", ["relay_slack"], -1, 1, f"slack of the link, {SLACK}")
    table.add(seen.link, "link", "link", ["relay_up"], 0, 1, "1 if it is up")
    slack = "its slack over a diagonal step after each of nine moves, clipped"
    table.add(seen.link, "link", "link", nine_names("slack"), -1, 1, slack)
    joined = seen.link and farm.relay.chained
    table.add(joined, CHAIN, "joined", ["relay_joined"], 0, 1, "1 if the relay is joined")
    stressed = f"share of stressed plots {blocks} plots, x outer"
    table.add(seen.stress, "stress", "stress", _square("block_stress", BLOCKS), 0, 1, stressed)


def _see_risk(held: bool, table: _Table) -> None:
    near, most = "SR over d_safety of each of nine moves, over the two nearest peers", 2.0 * STEP_ROUNDING
    table.add(True, "closing", "risk, any", nine_names("risk_any"), 0, most, f"{near}; mean over the peer's nine moves")
    way = f", added up over {2 * HOLD} steps of it, clipped" if held else ""
    on, most = f"{near}{way}; the peer keeps its velocity", MOST_RISK if held else most
    table.add(True, "closing", "risk, same", nine_names("risk_same"), 0, most, on)


def _see_served(farm: FarmConfig, table: _Table) -> None:
    seen, relay, world = farm.observation, farm.relay, farm.world
    _see_left(farm, table)
    served = _apart(world, world.height_communication, (world.height_monitoring, world.height_collection))
    far, both = relay.weight_centroid + relay.weight_farthest, relay.weight_relays
    most, change = (far * served + both) * STEP_ROUNDING, (far + both) * STEP_ROUNDING
    table.add(seen.service, "service", "service", ["service"], 0, most, "D_c over the field's diagonal")
    changes = "change of D_c over a diagonal step with each of nine moves"
    table.add(seen.service, "service", "service", nine_names("service"), -change, change, changes)
    offset = f"{OFFSET} of the first, second .. UAV that it serves; 0 if none"
    for k in range(relay.capacity_for(world)):
        table.add(seen.link, "link", "served", _offset(f"served_{k}"), -1, 1, offset)
        table.add(seen.link, "link", "served", [f"served_{k}_slack"], -1, 1, f"slack of its link, {SLACK}")
        table.add(seen.link, "link", "served", [f"served_{k}_present"], 0, 1, "1 if there is one")
    up = "share of its links that would be up after each of nine moves"
    table.add(seen.link, "link", "links", nine_names("links_up"), 0, 1, up)
    least = "the least slack of them over a diagonal step, clipped"
    table.add(seen.link, "link", "links", nine_names("least_slack"), -1, 1, least)
    chained = seen.link and relay.chained
    table.add(chained, CHAIN, "base", _offset("base"), -1, 1, f"{OFFSET} to the base station")
    table.add(chained, CHAIN, "joined", ["joined"], 0, 1, "1 if it is joined to the base station itself")
    joined = "share of the living relays that would be joined after each of nine moves"
    table.add(chained, CHAIN, "joined", nine_names("joined"), 0, 1, joined)


def _see_conditions(farm: FarmConfig, name: str, table: _Table) -> None:
    seen = farm.observation
    table.add(seen.charge, "charge", "charge", ["charge"], 0, 1, "charge over capacity")
    table.add(seen.charge, "charge", "station", _offset("station"), -1, 1, f"{OFFSET} to the nearest station")
    there = "the same after a straight flight to it, clipped"
    table.add(seen.charge, "charge", "charge there", ["charge_there"], -1, 1, there)
    table.add(seen.wind, "wind", "wind", _xy("wind"), -1, 1, "of the last step, over full speed")
    refused = "1 for each of nine moves that a no-fly zone would refuse"
    table.add(seen.zones, "zones", "refused", nine_names("refused"), 0, 1, refused)
    alive = "share of the own type's UAVs that have not failed"
    table.add(farm.loses_in_flight, "where UAVs can fail", "alive", ["alive"], 0, 1, alive)


def _see_place(table: _Table, label: str, name: str, farthest: float) -> None:
    table.add(True, "", label, _offset(name), -1, 1, OFFSET)
    table.add(True, "", label, [f"{name}_distance"], 0, farthest, "distance over the field's diagonal")


def _see_nearest(farm: FarmConfig, height: float, table: _Table) -> None:
    """Add the view of the nearest UAV of the same plane (W10)."""
    _see_place(table, "nearest UAV", "nearest_uav", _apart(farm.world, height, (height,)))


def _apart(world: WorldConfig, height: float, others: tuple[float, ...]) -> float:
    """Return the largest distance to a UAV at any of the other heights, divided by the field's diagonal."""
    rise = max(abs(other - height) for other in others)
    diagonal = math.hypot(world.field_x, world.field_y)
    return math.hypot(diagonal, rise) / diagonal * (ROUNDING if rise else 1.0)


def farthest_stop(dynamics: DynamicsConfig, kind: int) -> float:
    """Return the longest way along an axis in which a UAV of a type stops, m.

    It flies at top speed until the command arrives, and until an acceleration at its limit has ended; then it brakes.
    """
    most, jerk, delay, top = (dynamics.of_types(name)[kind] for name in ("acceleration", "jerk", "delay", "speed"))
    return top * (delay + most / jerk) + 0.5 * top * (top / most + most / jerk)


def field_range(world: WorldConfig) -> float:
    """Return the range of the far value field, m."""
    return max(FIELD_RANGE, max(world.field_x, world.field_y) / FIELD_RANGES)


def field_rounding(world: WorldConfig) -> float:
    """Return how far rounding takes a value field's observed growth with a move, which is scaled by range over step."""
    step = (world.speed_x_max + world.speed_y_max) * world.step_seconds
    return FIELD_ROUNDING * max(1.0, field_range(world) / step)


def nine_names(name: str) -> list[str]:
    """Return a name for each of nine moves, in the order of `NineMoves`."""
    return _square(f"{name}_move", 3)


def _square(name: str, side: int) -> list[str]:
    around = range(-(side // 2), side // 2 + 1)
    return [f"{name}_{column}_{row}" for column in around for row in around]


def _offset(name: str) -> list[str]:
    return [f"{name}_dx", f"{name}_dy"]


def _xy(name: str) -> list[str]:
    return [f"{name}_x", f"{name}_y"]
