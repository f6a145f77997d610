"""metrics.jsonl in the run directory: one JSON object per line."""

import json
import os
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, TextIO

from eia_sec.common.clock import monotonic
from eia_sec.common.imitation import ImitationEvent
from eia_sec.common.population import Exploit
from eia_sec.common.team import TeamSpec
from eia_sec.learner.process.open_file import names_open_file


class MetricsLog:
    """Appends records to metrics.jsonl; without a directory it writes nothing.

    If the file is removed while in use, a new one is started, and `failure` reports it from then on.

    Args:
        directory: the run directory, or None.
        elapsed: seconds that earlier parts of a resumed run took.

    Attributes:
        failure: why a record could not be written, or empty.
    """

    def __init__(self, directory: Path | None, elapsed: float = 0.0) -> None:
        self.failure = ""
        self._path = None if directory is None else directory / "metrics.jsonl"
        self._file: TextIO | None = None
        self._lost = self._removed = 0
        self._started = monotonic() - elapsed
        self._append("")

    @property
    def elapsed(self) -> float:
        """Seconds since the run began, without the pauses between its starts."""
        return monotonic() - self._started

    def write(self, kind: str, **values: Any) -> None:
        """Append one record; a record that cannot be written is lost and counted, and the next write tries again."""
        self._append(json.dumps({"kind": kind, "time": round(self.elapsed, 3), **values}) + "\n")

    def close(self) -> None:
        """Close the file; later records are dropped."""
        self._shut()
        self._path = None

    def _append(self, line: str) -> None:
        if self._path is None:
            return
        try:
            if self._file is not None and not names_open_file(self._path, self._file.fileno()):
                self._removed += 1
                self._shut()
            if self._file is None:
                self._file = _reopened(self._path)
            self._file.write(line)
            self._file.flush()
        except OSError as error:
            self._lost += bool(line)
            self.failure = f"metrics.jsonl cannot be written: {error.strerror}; {self._lost} records are lost."
            self._shut()
        else:
            self.failure = self._past_failures()

    def _past_failures(self) -> str:
        """Return a sentence on records that are lost for good, or an empty string."""
        lost = f"{self._lost} records of metrics.jsonl could not be written." if self._lost else ""
        removed = "metrics.jsonl was removed while in use; its earlier records are gone." if self._removed else ""
        return f"{lost} {removed}".strip()

    def _shut(self) -> None:
        file, self._file = self._file, None
        if file is not None:
            # Its buffer holds part of a record that is already counted as lost.
            with suppress(OSError):
                file.close()


def _reopened(path: Path) -> TextIO:
    """Open a file for appending; a last line that a crash cut short gets a line end first."""
    with path.open("ab+") as file:
        if file.tell():
            file.seek(-1, os.SEEK_END)
            if file.read(1) != b"\n":
                file.write(b"\n")
    return path.open("a", encoding="utf-8")


def imitation_record(team: TeamSpec, event: ImitationEvent) -> dict[str, Any]:
    """Return an imitation event as a record for metrics.jsonl."""
    names = team.types
    return {
        "event": event.event,
        "episode": event.episode,
        "version": event.version,
        "rate": event.rate,
        "elites": dict(zip(names, event.elites, strict=True)),
        "scores": {name: list(scores) for name, scores in zip(names, event.scores, strict=True)},
        "evaluation_steps": event.evaluation_steps,
    }


def exploit_record(team: TeamSpec, event: Exploit, before: Mapping[str, float]) -> dict[str, Any]:
    """Return a round of a population as a record for metrics.jsonl.

    Args:
        team: the layout of the team.
        event: what the round meant for this member.
        before: hyperparameters before it.
    """
    sources = zip(team.types, event.sources, strict=True)
    return {
        "round": event.round,
        "scores": dict(event.scores),
        "rate": event.rate,
        "sources": {name: source for name, source in sources if source},
        "hyperparameters": dict(event.hyperparameters),
        "before": dict(before),
        "evaluation_steps": event.evaluation_steps,
    }
