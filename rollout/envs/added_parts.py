"""The parts of the added observations, with their bounds; they follow from `rollout/sim/kernel/views`."""

import math
from typing import Final, NamedTuple

from eia_sec.common.config import FarmConfig, WorldConfig
from eia_sec.common.farm import COLLECTION, COMMUNICATION, MONITORING, ROUTE_PLOTS, advice_sizes
from eia_sec.rollout.sim.kernel.plans.view import SHARE
from eia_sec.rollout.sim.kernel.views.constants import field_range
from eia_sec.rollout.sim.kernel.views.fields import SCALE
from eia_sec.rollout.sim.kernel.views.maps import BLOCK, BLOCKS, CELLS
from eia_sec.rollout.sim.kernel.views.routes import MOST_OFFSET
from eia_sec.rollout.sim.kernel.views.units import MOST

ROUNDING: Final = 1.0 + 1e-9
"""Allowance for differences of float64 distances over a short step before they are rounded to float32."""
FIELD_ROUNDING: Final = 4e-6
"""Rounding of the logarithm of a value field, which is a sum of float32."""


class Part(NamedTuple):
    """Consecutive numbers of an observation that share bounds and meaning.

    Attributes:
        name: short name.
        size: count of numbers.
        low: lower bound.
        high: upper bound.
        meaning: what the numbers mean.
    """

    name: str
    size: int
    low: float
    high: float
    meaning: str


def field_rounding(world: WorldConfig) -> float:
    """Return how far rounding takes a value field's observed growth with a move, which is scaled by range over step."""
    step = (world.speed_x_max + world.speed_y_max) * world.step_seconds
    return FIELD_ROUNDING * max(1.0, field_range(world) / step)


def added_parts(config: FarmConfig, name: str, served: float) -> tuple[Part, ...]:
    """Return the parts of a type's added observations in their order.

    Args:
        config: the farm.
        name: of the type.
        served: largest distance from a relay to a UAV that it serves, over the field's diagonal.
    """
    seen, task, parts = config.observation, name != COMMUNICATION, list[Part]()
    peer = (
        Part("peer", 2, -1.0, 1.0, "offset (dx / X, dy / Y) of the nearest, second nearest .. of the type; 0 if none"),
        Part("peer", 2, -1.0, 1.0, "its last velocity over full speed"),
        Part("peer", 1, 0.0, 1.0, "1 if there is one"),
    )
    parts += peer * seen.peers
    if seen.last_move:
        parts.append(Part("last velocity", 2, -1.0, 1.0, "own, over full speed"))
    if task:
        parts += _tasks(config, name)
    if seen.phases:
        parts += _phases(config, name)
    if seen.route and name == MONITORING:
        parts.append(Part("route", 9, 0.0, 1.0, "1 for the one of nine moves that follows the own sweep route"))
        plots = "offset to the next, second next .. plot on the route over 20 m, clipped"
        parts += (Part("plot ahead", 2, -MOST_OFFSET, MOST_OFFSET, plots),) * ROUTE_PLOTS
    if seen.service and not task:
        parts += _service(config, served)
    if seen.link:
        parts += _link(config) if task else _links(config)
    if seen.stress and task:
        blocks = f"of {BLOCKS} x {BLOCKS} blocks of {BLOCK} x {BLOCK} plots, x outer"
        parts.append(Part("stress", BLOCKS**2, 0.0, 1.0, f"share of stressed plots {blocks}"))
    if seen.charge:
        parts.append(Part("charge", 1, 0.0, 1.0, "charge over capacity"))
        parts.append(Part("station", 2, -1.0, 1.0, "offset (dx / X, dy / Y) to the nearest station"))
        parts.append(Part("charge there", 1, -1.0, 1.0, "the same after a straight flight to it, clipped"))
    if seen.wind:
        parts.append(Part("wind", 2, -1.0, 1.0, "of the last step, over full speed"))
    if seen.zones:
        parts.append(Part("refused", 9, 0.0, 1.0, "1 for each of nine moves that a no-fly zone would refuse"))
    if config.loses_in_flight:
        parts.append(Part("alive", 1, 0.0, 1.0, "share of the own type's UAVs that have not failed"))
    if seen.advice:
        parts.append(_advice(config, name))
    return tuple(parts)


def _advice(config: FarmConfig, name: str) -> Part:
    size = advice_sizes(config)[(COMMUNICATION, MONITORING, COLLECTION).index(name)]
    if getattr(config.control, name) in ("moves", "headings"):
        return Part("advice", size, 0.0, 1.0, "1 for the option that is nearest to what the advised heuristic would do")
    return Part("advice", size, -1.0, 1.0, "velocity of the advised heuristic over full speed")


def _tasks(config: FarmConfig, name: str) -> list[Part]:
    """Return what only UAVs with a task see, without the phases."""
    seen, world, parts = config.observation, config.world, list[Part]()
    if seen.closing:
        near = "SR over d_safety of each of nine moves, over the two nearest peers"
        parts.append(Part("risk, any", 9, 0.0, 2.0 * ROUNDING, f"{near}; mean over the peer's nine moves"))
        parts.append(Part("risk, same", 9, 0.0, 2.0 * ROUNDING, f"{near}; the peer keeps its velocity"))
    unit = "VDF over its largest value" if name == MONITORING else "AoI over twice its largest value"
    if seen.units > 0:
        parts.append(Part("units", 9, 0.0, MOST, f"{unit} that each of nine moves would bring, clipped"))
    if seen.units > 1:
        parts.append(Part("units of two", 9, 0.0, 2.0 * MOST, f"{unit} of each move and the best after it, clipped"))
    if seen.plan:
        plan = f"the best plan of {seen.plan} steps that begins with it"
        parts.append(Part("plan", 9, 0.0, 1.0, f"e to the minus {1 / SHARE:g} times what {plan} loses, in full items"))
        parts.append(Part("plan", 1, -1.0, 1.0, "worth of the best plan of all in full items for each step, clipped"))
    points = world.plots_x * world.plots_y if name == MONITORING else world.sensors
    grown = 1.0 + field_rounding(world)
    for reach in ("near", "far") if seen.fields else ():
        most = SCALE * math.log1p(points) * ROUNDING
        parts.append(Part(f"{reach} field", 9, -grown, grown, "logarithm of its growth with each of nine moves"))
        parts.append(Part(f"{reach} field", 1, 0.0, most, f"{SCALE:g} ln(1 + field) at the own place"))
    blocks = f"of {BLOCKS} x {BLOCKS} blocks of {BLOCK} x {BLOCK}"
    if seen.coarse and name == MONITORING:
        parts.append(Part("blocks", BLOCKS**2, 0.0, 1.0, f"mean VDF over its largest value {blocks} plots, x outer"))
        parts.append(Part("stale blocks", BLOCKS**2, 0.0, 1.0, "share of the plots with VDF_max - 1 or more"))
    if seen.coarse and name == COLLECTION:
        cells = f"of {CELLS} x {CELLS} sensor cells"
        parts.append(Part("cells", CELLS**2, 0.0, 1.0, f"AoI over twice its largest value {cells}, x outer, clipped"))
        parts.append(
            Part("blocks", BLOCKS**2, 0.0, 1.0, f"mean of the same, without clipping, {blocks} cells, clipped")
        )
    return parts


def _phases(config: FarmConfig, name: str) -> list[Part]:
    """Return the phases of the counters that a type looks after, and the steps left."""
    numbers = {MONITORING: 1, COLLECTION: len(config.world.sensor_cycles)}.get(name, 0)
    phase = [Part("phase", numbers, 0.0, 1.0, "elapsed share of the counters' cycle")] if numbers else []
    return [*phase, Part("left", 2, 0.0, 1.0, "steps left over 25 and over 100, at most 1")]


def _link(config: FarmConfig) -> list[Part]:
    step = "its slack over a diagonal step after each of nine moves, clipped"
    link = [
        Part("relay", 2, -1.0, 1.0, "offset (dx / X, dy / Y) to the own relay; 0 if none"),
        Part("link", 1, -1.0, 1.0, "slack of the link, link range less distance, over the range, clipped"),
        Part("link", 1, 0.0, 1.0, "1 if it is up"),
        Part("link", 9, -1.0, 1.0, step),
    ]
    return [*link, *[Part("joined", 1, 0.0, 1.0, "1 if the relay is joined")] * config.relay.chained]


def _links(config: FarmConfig) -> list[Part]:
    served = (
        Part("served", 2, -1.0, 1.0, "offset (dx / X, dy / Y) of the first, second .. UAV that it serves; 0 if none"),
        Part("served", 1, -1.0, 1.0, "slack of its link, link range less distance, over the range, clipped"),
        Part("served", 1, 0.0, 1.0, "1 if there is one"),
    )
    chain = (
        Part("base", 2, -1.0, 1.0, "offset (dx / X, dy / Y) to the base station"),
        Part("joined", 1, 0.0, 1.0, "1 if it is joined to the base station itself"),
        Part("joined", 9, 0.0, 1.0, "share of the living relays that would be joined after each of nine moves"),
    )
    return [
        *served * config.relay.capacity_for(config.world),
        Part("links", 9, 0.0, 1.0, "share of its links that would be up after each of nine moves"),
        Part("links", 9, -1.0, 1.0, "the least slack of them over a diagonal step, clipped"),
        *chain * config.relay.chained,
    ]


def _service(config: FarmConfig, served: float) -> list[Part]:
    relay = config.relay
    far, both = relay.weight_centroid + relay.weight_farthest, relay.weight_relays
    most, change = far * served + both, (far + both) * ROUNDING
    return [
        Part("service", 1, 0.0, most * ROUNDING, "D_c over the field's diagonal"),
        Part("service", 9, -change, change, "change of D_c over a diagonal step with each of nine moves"),
    ]
