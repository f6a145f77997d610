"""Numbers that a PettingZoo environment puts into its infos, as metrics of an episode.

A number's metric is its mean over the steps and agents that gave it, so one that only the last step gives is that
step's. What is not a single number, such as an action mask, is no metric.
"""

import math
from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from eia_sec.common.log import log
from eia_sec.common.names import is_name
from eia_sec.common.transitions import LARGEST, MOST_INFOS

SHOWN: Final = 3
"""Refused names that the alarm names."""
MOST_REFUSED: Final = 1000
"""Most refused names that are told apart."""


class EpisodeInfos:
    """The means of the running episodes of a batch.

    Args:
        environments: E.
        name: of the environment, for the alarm.

    Attributes:
        refused: numbers that were refused, because there are more than MOST_INFOS names, their name is none (see
            `eia_sec.common.names`), or they are not finite or too large.
    """

    def __init__(self, environments: int, name: str) -> None:
        self._name = name
        self._sums: list[dict[str, tuple[float, int]]] = [{} for _ in range(environments)]
        self._known: set[str] = set()
        self._odd: set[str] = set()
        self.refused = 0

    @property
    def alarm(self) -> str:
        """A sentence about what was refused, with its count, or an empty string."""
        if not self.refused:
            return ""
        names = ", ".join(repr(name[:40]) for name in sorted(self._odd)[:SHOWN])
        return (
            f"{self._name}: {self.refused} numbers in infos are no metrics, among them {names}: metrics have at most "
            f"{MOST_INFOS} names of 1 to 63 letters, digits, '.', '_' or '-', and finite values up to {LARGEST:g}."
        )

    def begin(self, index: int) -> None:
        """Begin an environment's episode."""
        self._sums[index] = {}

    def add(self, index: int, infos: Mapping[Any, Mapping[Any, Any]]) -> None:
        """Take in what a step of an environment gave its agents."""
        sums = self._sums[index]
        for info in infos.values():
            for name, value in info.items():
                if isinstance(value, bool | int | float | np.number | np.bool_):
                    self._add(sums, name, _number(value))

    def _add(self, sums: dict[str, tuple[float, int]], name: Any, value: float) -> None:
        if not self._takes(name) or not math.isfinite(value) or abs(value) > LARGEST:
            if len(self._odd) < MOST_REFUSED:
                self._odd.add(str(name))
            self.refused += 1
            if self.refused == 1:
                log(self.alarm)
            return
        total, count = sums.get(name, (0.0, 0))
        sums[name] = total + value, count + 1

    def _takes(self, name: Any) -> bool:
        if name in self._known:
            return True
        if len(self._known) >= MOST_INFOS or not isinstance(name, str) or not is_name(name):
            return False
        self._known.add(name)
        return True

    def means(self, index: int) -> dict[str, float]:
        """Return the means of an environment's episode so far, by name."""
        return {name: total / count for name, (total, count) in self._sums[index].items()}


def _number(value: Any) -> float:
    """Return a number as a float; an integer that no float can hold is not a number."""
    try:
        return float(value)
    except OverflowError:
        return math.nan
