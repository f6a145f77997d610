"""Tables of the algorithms, from the registry and the first line of each algorithm's file."""

import sys
from collections.abc import Mapping

from eia_sec.common.config import ALGORITHM_CONFIGS
from eia_sec.learner.registry import OFF_POLICY, ON_POLICY
from research.pages.blocks import table


def off_policy() -> str:
    """Return one row for each algorithm that learns from a replay buffer."""
    return _rows(OFF_POLICY)


def on_policy() -> str:
    """Return one row for each algorithm that learns in iterations."""
    return _rows(ON_POLICY)


def _rows(learners: Mapping[str, type]) -> str:
    return table(["name", "file", "what it is", "elites"], [_row(name, own) for name, own in learners.items()])


def _row(name: str, learner: type) -> list[str]:
    module = learner.__module__
    title = (sys.modules[module].__doc__ or "").partition("\n")[0].rstrip(".")
    elites = "imitated" if "elite" in ALGORITHM_CONFIGS[name].sections else "no"
    return [f"`{name}`", f"`{module.removeprefix('eia_sec.').replace('.', '/')}.py`", title, elites]
