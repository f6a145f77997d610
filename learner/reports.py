"""What the learner tells: metrics.jsonl in the run directory, and lossy metric messages on the bus."""

import json
import math
import os
import time
from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, TextIO

from common.imitation import ImitationEvent
from common.team import TeamSpec
from common.transitions import EpisodeSummary
from learner.tensorboard import flattened

IMITATIONS = 4
"""Newest imitation events that metric messages tell of."""
SMOOTHED_EPISODES = 40
"""Episodes in the moving averages of the live view."""


class Journal:
    """Appends one JSON object per line to metrics.jsonl; without a directory it writes nothing.

    Args:
        directory: the run directory, or None.
        elapsed: seconds that earlier parts of a resumed run took.

    Attributes:
        failure: why a record could not be written, or empty.
        imitations: the newest records of imitation events.
    """

    def __init__(self, directory: Path | None, elapsed: float = 0.0) -> None:
        self.failure = ""
        self.imitations: deque[dict[str, Any]] = deque(maxlen=IMITATIONS)
        self._path = None if directory is None else directory / "metrics.jsonl"
        self._file: TextIO | None = None
        self._lost = 0
        self._started = time.monotonic() - elapsed
        self._append("")

    @property
    def elapsed(self) -> float:
        """Return the seconds since the run began."""
        return time.monotonic() - self._started

    def write(self, kind: str, **values: Any) -> None:
        """Append one record; one that the disk does not take is lost and counted, and the next is tried again."""
        if kind == "imitation":
            self.imitations.append(values)
        self._append(json.dumps({"kind": kind, "time": round(self.elapsed, 3), **values}) + "\n")

    def close(self) -> None:
        """Close the file; nothing is written any more."""
        self._shut()
        self._path = None

    def _append(self, line: str) -> None:
        if self._path is None:
            return
        try:
            if self._file is None:
                self._file = _continued(self._path)
            self._file.write(line)
            self._file.flush()
        except OSError as error:
            self._lost += bool(line)
            self.failure = f"metrics.jsonl cannot be written: {error.strerror}; {self._lost} records are lost."
            self._shut()
        else:
            self.failure = f"{self._lost} records of metrics.jsonl could not be written." if self._lost else ""

    def _shut(self) -> None:
        file, self._file = self._file, None
        if file is not None:
            # What it still holds is a piece of a record that is counted as lost.
            with suppress(OSError):
                file.close()


class Curves:
    """Moving averages over the newest finished episodes.

    Args:
        team: the layout of the team.
        recent: episodes that had finished before a run was resumed, oldest first.
    """

    def __init__(self, team: TeamSpec, recent: Iterable[EpisodeSummary] = ()) -> None:
        self._team = team
        self._recent: deque[dict[str, Any]] = deque(map(self._figures, recent), maxlen=SMOOTHED_EPISODES)

    def add(self, episodes: Sequence[EpisodeSummary]) -> dict[str, Any]:
        """Take finished episodes in; return their own means."""
        rows = [self._figures(episode) for episode in episodes]
        self._recent.extend(rows)
        return _mean(rows)

    def smoothed(self) -> dict[str, Any]:
        """Return the moving averages, or an empty map before the first episode."""
        return _mean(list(self._recent)) if self._recent else {}

    def _figures(self, episode: EpisodeSummary) -> dict[str, Any]:
        reward = {"mean": sum(episode.reward) / len(episode.reward)}
        for group, part in zip(self._team.groups, self._team.agent_slices(), strict=True):
            reward[group.name] = sum(episode.reward[part]) / group.count
        return {**episode.metrics, "reward": reward, "steps": episode.steps}


def diverging(statistics: Mapping[str, Any]) -> str:
    """Return that a figure of the training is not finite any more, or nothing."""
    odd = sorted(name for name, value in flattened(statistics).items() if not math.isfinite(value))
    more = f" and {len(odd) - 1} more" if len(odd) > 1 else ""
    return f"the training diverges: {odd[0]}{more} is not finite." if odd else ""


def _continued(path: Path) -> TextIO:
    """Open a file for further lines; one that a crash has cut is ended, so that it spoils no other."""
    with path.open("ab+") as file:
        if file.tell():
            file.seek(-1, os.SEEK_END)
            if file.read(1) != b"\n":
                file.write(b"\n")
    return path.open("a", encoding="utf-8")


def imitation_record(team: TeamSpec, event: ImitationEvent) -> dict[str, Any]:
    """Return an imitation event as it stands in metrics.jsonl."""
    names = [group.name for group in team.groups]
    return {
        "event": event.event,
        "episode": event.episode,
        "version": event.version,
        "rate": event.rate,
        "elites": dict(zip(names, event.elites, strict=True)),
        "scores": {name: list(scores) for name, scores in zip(names, event.scores, strict=True)},
        "evaluation_steps": event.evaluation_steps,
    }


def _mean(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the means of what all rows have; a checkpoint of another version may hold others beside them."""
    first = {name: value for name, value in rows[0].items() if all(name in row for row in rows)}
    return {
        name: _mean([row[name] for row in rows])
        if isinstance(value, dict)
        else sum(row[name] for row in rows) / len(rows)
        for name, value in first.items()
    }
