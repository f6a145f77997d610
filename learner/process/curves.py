"""Moving averages of rewards and metrics over the newest finished episodes."""

from collections import deque
from collections.abc import Iterable, Sequence
from typing import Any, Final

from eia_sec.common.team import TeamSpec
from eia_sec.common.transitions import INFOS, EpisodeSummary

SMOOTHED_EPISODES: Final = 40
"""Episodes in a moving average."""


class Curves:
    """The newest finished episodes and their means.

    Args:
        team: the layout of the team.
        recent: episodes that finished before the run was resumed, oldest first.
    """

    def __init__(self, team: TeamSpec, recent: Iterable[EpisodeSummary] = ()) -> None:
        self._team = team
        self._recent: deque[dict[str, Any]] = deque(map(self._row, recent), maxlen=SMOOTHED_EPISODES)

    def add(self, episodes: Sequence[EpisodeSummary]) -> dict[str, Any]:
        """Add finished episodes; return the means over only these."""
        rows = [self._row(episode) for episode in episodes]
        self._recent.extend(rows)
        return _mean(rows)

    def smoothed(self) -> dict[str, Any]:
        """Return the moving averages, or an empty dictionary before the first episode."""
        return _mean(list(self._recent)) if self._recent else {}

    def _row(self, episode: EpisodeSummary) -> dict[str, Any]:
        reward = {"mean": sum(episode.reward) / len(episode.reward)}
        for group, part in zip(self._team.groups, self._team.agent_slices(), strict=True):
            reward[group.name] = sum(episode.reward[part]) / group.count
        return {**episode.metrics, "reward": reward, "steps": episode.steps, INFOS: dict(episode.infos)}


def _mean(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the means of rows; those of infos over the episodes that have them, left out where none has any."""
    infos: dict[str, list[float]] = {}
    for row in rows:
        for name, value in row[INFOS].items():
            infos.setdefault(name, []).append(value)
    means = _mean_of_all([{name: value for name, value in row.items() if name != INFOS} for row in rows])
    return means | ({INFOS: {name: sum(values) / len(values) for name, values in infos.items()}} if infos else {})


def _mean_of_all(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the mean of each metric that all rows have; rows from an older checkpoint may have others."""
    first = {name: value for name, value in rows[0].items() if all(name in row for row in rows)}
    return {
        name: _mean_of_all([row[name] for row in rows])
        if isinstance(value, dict)
        else sum(row[name] for row in rows) / len(rows)
        for name, value in first.items()
    }
