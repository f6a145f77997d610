"""Labels of agent types and episode metrics in a view, taken from the learner's metric messages."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

from eia_sec.common.transitions import INFOS

NAME_LENGTH: Final = 14
"""Most characters of a name."""
MOST_DIGITS: Final = 6
MOST_PLOTTED: Final = 2
"""Most episode metrics, or numbers of infos, that a view shows."""


@dataclass(frozen=True)
class Curve:
    """An episode metric that a view shows.

    Attributes:
        name: its name in the learner's curves.
        label: what the view calls it.
        digits: decimals that are shown.
    """

    name: str
    label: str
    digits: int


LENGTH: Final = Curve("steps", "episode steps", 0)
"""Shown if the environment plots no episode metric."""


def plotted(learner: Mapping[str, Any]) -> list[Curve]:
    """Return the episode metrics that a view shows; where there are none, the first numbers of infos.

    Args:
        learner: the learner's metrics.

    Raises:
        TypeError, ValueError, LookupError or AttributeError: the environment's labels are malformed.
    """
    metrics = learner.get("environment", {}).get("episode_metrics", [])
    curves = [
        Curve(str(metric["name"]), str(metric["label"])[:NAME_LENGTH], max(0, min(int(metric["digits"]), MOST_DIGITS)))
        for metric in metrics
        if metric["plotted"]
    ]
    if not curves and isinstance(infos := learner.get("curves", {}).get(INFOS), Mapping):
        curves = [Curve(f"{INFOS}/{name}", str(name)[:NAME_LENGTH], 2) for name in sorted(infos)]
    return curves[:MOST_PLOTTED] or [LENGTH]


def value_of(curves: Mapping[str, Any], curve: Curve) -> Any:
    """Return a curve's newest value in the learner's curves, or None where there is none."""
    section, _, name = curve.name.partition("/")
    return curves.get(INFOS, {}).get(name) if section == INFOS else curves.get(curve.name)


def type_label(learner: Mapping[str, Any], kind: Any) -> str:
    """Return what a view calls a type of agent: its short name, else the beginning of its name."""
    return str(learner.get("environment", {}).get("short_names", {}).get(kind, kind))[:NAME_LENGTH]
