"""All heuristics by name.

To add one for monitors and collectors, write a module with the functions `monitors` and `collectors` in `tasks`,
and add a line to TASKS. A heuristic for relays is a line in RELAYS. A heuristic that flies all UAVs by itself is a line
in WHOLE.
"""

from collections.abc import Callable
from typing import Any, Final

from eia_sec.common.config import FarmConfig
from eia_sec.rollout.heuristics.composite import CompositePolicy, GroupPolicyFactory
from eia_sec.rollout.heuristics.random import RandomPolicy
from eia_sec.rollout.heuristics.relays import CentroidRelays, CoverageRelays, SearchRelays
from eia_sec.rollout.heuristics.static import StaticPolicy
from eia_sec.rollout.heuristics.tasks import greedy, horizon, hungarian, lawnmower, tour

WHOLE: Final[dict[str, Callable[[], Any]]] = {
    "static": StaticPolicy,
    "random": RandomPolicy,
}
"""Heuristics that fly all UAVs together."""

TASKS: Final[dict[str, tuple[GroupPolicyFactory, GroupPolicyFactory]]] = {
    "lawnmower": (lawnmower.monitors, lawnmower.collectors),
    "greedy": (greedy.monitors, greedy.collectors),
    "tour": (tour.monitors, tour.collectors),
    "hungarian": (hungarian.monitors, hungarian.collectors),
    "horizon": (horizon.monitors, horizon.collectors),
}
"""Heuristics for the monitors and the collectors."""

RELAYS: Final[dict[str, GroupPolicyFactory]] = {
    "search": SearchRelays,
    "centroid": CentroidRelays,
    "coverage": CoverageRelays,
}
"""Heuristics for the relays; see `default_relays`."""

HEURISTICS: Final = (*WHOLE, *TASKS)
"""Names of all heuristics. TASK+RELAYS, as in greedy+centroid, names a combination."""


def default_relays(config: FarmConfig) -> str:
    """Return the name of the relays' heuristic beside a task's: links that count are kept up."""
    return "coverage" if config.relay.require_link else "search"


def heuristic(name: str, config: FarmConfig) -> Any:
    """Return the heuristic named `name` or TASK+RELAYS, or None if there is none; see `default_relays`."""
    if name in WHOLE:
        return WHOLE[name]()
    task, plus, relays = name.partition("+")
    if task in TASKS and (relays in RELAYS or not plus):
        return CompositePolicy(config, RELAYS[relays or default_relays(config)], *TASKS[task])
    return None
