"""One piece of work of a study, and the record that it leaves.

A job is named by a digest of everything that decides its outcome: its kind, the whole configuration with the seed, and
what is evaluated. Its record lies in a file of that name, so a study that is started again finds what is there, does
what is missing, and does again what another configuration made. Studies share the records: the twelve-UAV runs of
`scalability` are those of `training`.
"""

import hashlib
import json
import math
import os
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal, get_args

from eia_sec.common.config import RunConfig
from eia_sec.common.config.files import digest, read_saved, to_toml
from eia_sec.common.errors import RunDirError, UsageError
from eia_sec.common.log import log
from research.studies.record_checks import check_result

Kind = Literal["train", "fly", "time"]
FORMAT: Final = 1
"""Raised when what a record means changes; older records are then made anew."""
MAX_BYTES: Final = 16 * 2**20
"""No record is larger."""
POLICY_SUFFIX: Final = ".safetensors"
JOB_SUFFIX: Final = ".job.json"
_NEEDED: Final = {
    "format": int,
    "kind": str,
    "job": str,
    "command": str,
    "seed": int,
    "commit": str,
    "config": str,
    "seconds": float,
    "result": dict,
}


@dataclass(frozen=True)
class Job:
    """One piece of work.

    Attributes:
        kind: train a run and evaluate it, fly a policy that learns nothing, or time decisions.
        label: what it is called while it runs; no part of its identity.
        config: the run.
        options: what else decides the outcome, as JSON can hold it; see `research.studies.perform`.
    """

    kind: Kind
    label: str
    config: RunConfig
    options: Mapping[str, Any]

    @property
    def digest(self) -> str:
        """Return sixteen hexadecimal digits that name the job."""
        text = json.dumps([FORMAT, self.kind, digest(self.config), self.options], sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()[:16]

    def to_json(self) -> str:
        """Return the job as a file holds it."""
        whole = {"kind": self.kind, "label": self.label, "config": to_toml(self.config), "options": dict(self.options)}
        return json.dumps(whole, indent=1) + "\n"

    @classmethod
    def from_file(cls, path: Path) -> "Job":
        """Read a job; raise UsageError when the file is none."""
        try:
            data = json.loads(_bounded(path))
            if data["kind"] not in get_args(Kind) or not isinstance(data["options"], dict):
                raise ValueError("kind or options")
            return cls(data["kind"], str(data["label"]), read_saved(str(data["config"])), data["options"])
        except (OSError, ValueError, LookupError, TypeError, RecursionError) as error:
            raise UsageError(f"{path} is not a study's run: {error}.") from None


class Records:
    """The folder of all records; what cannot be read counts as missing.

    Args:
        folder: made when there is none.

    Raises:
        RunDirError: it cannot be made.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise RunDirError(f"cannot write into {folder}: {error.strerror}.") from error

    def path(self, job: Job, suffix: str = ".json") -> Path:
        """Return the path of a job's record, or of another of its files."""
        return self.folder / (job.digest + suffix)

    def get(self, job: Job) -> dict[str, Any] | None:
        """Return a job's record, or None when there is none that is whole."""
        path = self.path(job)
        try:
            record = json.loads(_bounded(path), parse_constant=_not_finite)
        except FileNotFoundError:
            return None
        except (OSError, ValueError, RecursionError) as error:
            log(f"{path} cannot be read and is made anew: {error}")
            return None
        if not isinstance(record, dict) or any(type(record.get(name)) is not kind for name, kind in _NEEDED.items()):
            log(f"{path} is no record and is made anew.")
            return None
        if record["format"] != FORMAT or record["job"] != job.digest:
            return None
        try:
            if not math.isfinite(record["seconds"]):
                raise ValueError("its time is not finite")
            check_result(job.kind, job.config, job.options, record["result"])
        except ValueError as error:
            log(f"{path} is no such record and is made anew: {error}.")
            return None
        return record

    def forget(self, job: Job) -> None:
        """Remove a job's record, so that it is done again."""
        self.path(job).unlink(missing_ok=True)

    def result(self, job: Job) -> dict[str, Any]:
        """Return the result of a job that is done."""
        record = self.get(job)
        assert record is not None, "asked for before it was done"
        found: dict[str, Any] = record["result"]
        return found

    def missing(self, jobs: list[Job], *, flown: bool = False) -> list[Job]:
        """Return the jobs without a record, each once; where they are to be `flown`, trainings without a policy too."""
        return [job for job in {job.digest: job for job in jobs}.values() if not self._is_done(job, flown=flown)]

    def _is_done(self, job: Job, *, flown: bool) -> bool:
        lost = flown and job.kind == "train" and not self.path(job, POLICY_SUFFIX).is_file()
        return self.get(job) is not None and not lost

    def put(self, job: Job, made: Mapping[str, Any], seconds: float, result: Mapping[str, Any]) -> None:
        """Write a record; the file appears whole or not at all.

        Raises:
            RunDirError: it cannot be written; its cause is the OSError.
        """
        record = {
            "format": FORMAT,
            "kind": job.kind,
            "job": job.digest,
            "label": job.label,
            "seed": job.config.seed,
            "config": digest(job.config),
            "options": dict(job.options),
            "seconds": round(seconds, 2),
            **made,
            "result": dict(result),
        }
        self._write(self.path(job), json.dumps(record) + "\n")

    def hand_over(self, job: Job) -> None:
        """Write a job into a file with JOB_SUFFIX, for the process that will do it.

        Raises:
            RunDirError: it cannot be written; its cause is the OSError.
        """
        self._write(self.path(job, JOB_SUFFIX), job.to_json())

    def _write(self, path: Path, text: str) -> None:
        unfinished = path.with_suffix(f".{os.getpid()}.tmp")
        try:
            unfinished.write_text(text, encoding="utf-8")
            os.replace(unfinished, path)
        except OSError as error:
            with suppress(OSError):
                unfinished.unlink(missing_ok=True)
            raise RunDirError(f"cannot write {path}: {error.strerror}.") from error


def _not_finite(name: str) -> float:
    raise ValueError(f"it holds {name}")


def _bounded(path: Path) -> str:
    """Return a file's text; raise ValueError when it is too large to be one of ours."""
    if path.stat().st_size > MAX_BYTES:
        raise ValueError(f"it has more than {MAX_BYTES} bytes")
    return path.read_text(encoding="utf-8")
