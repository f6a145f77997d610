"""Every heuristic by its name.

To add one for monitors and collectors, write a module with the functions `monitors` and `collectors` beside this one
and add a line to TASKS. One for relays is a line in RELAYS. One that flies all UAVs by itself is a line in WHOLE.
"""

from collections.abc import Callable
from typing import Any, Final

from common.config import FarmConfig
from rollout.heuristics import greedy, horizon, hungarian, lawnmower, tour
from rollout.heuristics.composite import CompositePolicy, GroupPolicyFactory
from rollout.heuristics.random import RandomPolicy
from rollout.heuristics.relays import CentroidRelays, SearchRelays
from rollout.heuristics.static import StaticPolicy

WHOLE: Final[dict[str, Callable[[], Any]]] = {
    "static": StaticPolicy,
    "random": RandomPolicy,
}
"""Heuristics of all UAVs together."""

TASKS: Final[dict[str, tuple[GroupPolicyFactory, GroupPolicyFactory]]] = {
    "lawnmower": (lawnmower.monitors, lawnmower.collectors),
    "greedy": (greedy.monitors, greedy.collectors),
    "tour": (tour.monitors, tour.collectors),
    "hungarian": (hungarian.monitors, hungarian.collectors),
    "horizon": (horizon.monitors, horizon.collectors),
}
"""Heuristics of the monitors and of the collectors."""

RELAYS: Final[dict[str, GroupPolicyFactory]] = {
    "search": SearchRelays,
    "centroid": CentroidRelays,
}
"""Heuristics of the relays; the first one flies where none is named."""

HEURISTICS: Final = (*WHOLE, *TASKS)
"""The names of all heuristics. TASK+RELAYS, as in greedy+centroid, names further combinations."""


def heuristic(name: str, config: FarmConfig) -> Any:
    """Return the heuristic of a name or of TASK+RELAYS, or None when there is none."""
    if name in WHOLE:
        return WHOLE[name]()
    task, plus, relays = name.partition("+")
    if task in TASKS and (relays in RELAYS or not plus):
        return CompositePolicy(config, RELAYS[relays or next(iter(RELAYS))], *TASKS[task])
    return None
