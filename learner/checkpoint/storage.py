"""The learner's part of the run directory: checkpoints of the whole run, and the newest policy."""

import time
from pathlib import Path
from typing import Any, Final, Protocol

from eia_sec.common.config import RunConfig
from eia_sec.common.config.environment import unusable_arguments
from eia_sec.common.config.files import digest, method_of
from eia_sec.common.errors import CheckpointError, PolicyError, RunDirError
from eia_sec.common.log import log
from eia_sec.common.policy_file import POLICY, save_policy
from eia_sec.learner.checkpoint import files
from eia_sec.learner.checkpoint.trainer_state import counter, finite, mapping
from eia_sec.learner.checkpoint.writer import CheckpointWriter
from eia_sec.learner.intake.ledger import Ledger
from eia_sec.learner.trainer import Trainer

SLACK_BYTES: Final = 64 * 2**20
"""Upper bound for the bytes of a checkpoint's tensors other than networks and replay."""
CHECKPOINTS: Final = "checkpoints"


class SavableLedger(Protocol):
    """A ledger of accepted chunks that a checkpoint can hold."""

    def state(self) -> dict[str, Any]:
        """Return it as plain values."""


class RunStorage:
    """Keeps checkpoints and the policy in the run directory; without a directory it keeps nothing.

    Args:
        directory: the run directory, or None.
        config: the run; checkpoints of another method are refused, see `eia_sec.common.config.files.method_of`.

    Attributes:
        arguments: the environment's arguments as a callback or a command has set them, JSON, or empty; saved and
            restored with the run.
        skipped: checkpoints that were due while the previous one was still being written.
        pause: seconds for which the newest checkpoint stopped training.
        longest_pause: the longest such pause.
    """

    def __init__(self, directory: Path | None, config: RunConfig) -> None:
        self._directory = directory
        self._config = config
        self._digest, self._method = digest(config), digest(method_of(config))
        self._writer = CheckpointWriter(directory / CHECKPOINTS, config.learner.keep_checkpoints) if directory else None
        self._identity = None if directory is None else _identity(directory)
        self.arguments = ""
        self.skipped = 0
        self.pause = self.longest_pause = 0.0

    @property
    def alarm(self) -> str:
        """Why the newest checkpoint is missing, or empty."""
        return self._writer.failure if self._writer else ""

    def alarms(self) -> list[str]:
        """Return one sentence for each problem with the checkpoints or the directory; some may be empty."""
        gone = self._directory is not None and _identity(self._directory) is None
        return [self.alarm, f"the run directory {self._directory} is gone; nothing is kept." if gone else ""]

    def require_same_directory(self) -> None:
        """Raise RunDirError when the run directory's path leads to another directory than at the start.

        This learner's files would mix with those of another run, or of a copy of this one.
        """
        if self._directory is None or self._identity is None:
            return
        if (now := _identity(self._directory)) is not None and now != self._identity:
            raise RunDirError(f"another directory has taken the place of the run directory {self._directory}.")

    def save(self, trainer: Trainer, ledger: SavableLedger, elapsed: float, epoch: int, *, wait: bool = False) -> bool:
        """Start to write a checkpoint of this instant; skip it, and count that, if the previous one is not yet written.

        Training continues meanwhile, and also after a failure (see `alarm`); the previous checkpoint then stays.

        Args:
            trainer: its whole state is saved.
            ledger: the ledger of the chunks in that state.
            elapsed: seconds that the run has taken so far.
            epoch: the learner's fencing epoch.
            wait: return only when it is on disk or has failed, and never skip it.

        Returns:
            Whether a checkpoint of this instant was begun; False without a run directory.
        """
        if self._writer is None:
            return False
        if wait:
            self._writer.join()
        elif self._writer.busy:
            self.skipped += 1
            return False
        started = time.perf_counter()
        tensors, state = trainer.snapshot()
        manifest: dict[str, Any] = {
            "method": self._method,
            "trainer": state,
            "intake": ledger.state(),
            "elapsed": elapsed,
            "epoch": epoch,
            "arguments": self.arguments,
        }
        self._writer.start(tensors, manifest)
        self.pause = time.perf_counter() - started
        self.longest_pause = max(self.longest_pause, self.pause)
        if wait:
            self._writer.join()
        return True

    def close(self) -> None:
        """Wait until no checkpoint is being written."""
        if self._writer is not None:
            self._writer.join()

    def statistics(self) -> dict[str, float]:
        """Return metrics of this start's checkpoints; pause, seconds and bytes are those of the newest one."""
        if self._writer is None:
            return {}
        return {
            "checkpoints": self._writer.written,
            "checkpoints_skipped": self.skipped,
            "checkpoint_pause_ms": round(1e3 * self.pause, 3),
            "checkpoint_longest_pause_ms": round(1e3 * self.longest_pause, 3),
            "checkpoint_write_seconds": round(self._writer.seconds, 3),
            "checkpoint_bytes": self._writer.bytes,
        }

    def restore(self, trainer: Trainer, ledger: Ledger) -> tuple[float, int]:
        """Resume from the newest whole checkpoint; return the seconds that the run has taken, and its epoch.

        Without any checkpoint (the run was killed before its first one), nothing changes and both are 0.

        Raises:
            RunDirError: when the checkpoint belongs to another configuration.
            CheckpointError: when there are checkpoints and all are damaged, or the newest whole one does not fit.
        """
        if self._directory is None or not (self._directory / CHECKPOINTS).is_dir():
            return 0.0, 0
        found = files.load_latest(self._directory / CHECKPOINTS, trainer.largest_checkpoint() + SLACK_BYTES)
        if found is None:
            return 0.0, 0
        self._set_aside(found)
        manifest = found.manifest
        if manifest.get("method") != self._method:
            raise RunDirError(f"the checkpoint in {self._directory} belongs to another configuration.")
        elapsed, epoch = finite(manifest, "elapsed"), counter(manifest, "epoch")
        self.arguments = _arguments(manifest)
        ledger.restore(mapping(manifest, "intake"))
        trainer.restore(found.tensors, mapping(manifest, "trainer"))
        return elapsed, epoch

    def newest(self) -> Path | None:
        """Return the newest checkpoint, once none is being written, or None."""
        self.close()
        return None if self._directory is None else files.newest(self._directory / CHECKPOINTS)

    def _set_aside(self, found: files.Found) -> None:
        for _, message in found.skipped:
            log(f"ALARM: {message}")
        try:
            files.set_aside([path for path, _ in found.skipped])
        except OSError as error:
            log(f"ALARM: a damaged checkpoint could not be set aside: {error.strerror or error}.")

    def write_policy(self, trainer: Trainer, name: str = POLICY) -> str:
        """Write the present actors as a file of this name; return why that failed, or an empty string."""
        if self._directory is None:
            return ""
        metadata = {
            "seed": str(self._config.seed),
            "configuration": self._digest,
            "episodes": str(trainer.episodes),
            "environment_steps": str(trainer.environment_steps),
            "updates": str(trainer.updates),
        }
        try:
            save_policy(self._directory / name, trainer.actors(), metadata)
        except PolicyError as error:
            log(f"ALARM: {error}")
            return str(error)
        return ""


def _identity(path: Path) -> tuple[int, int] | None:
    """Return the device and inode of a directory, or None when it is not there."""
    try:
        found = path.stat()
    except OSError:
        return None
    return found.st_dev, found.st_ino


def _arguments(manifest: dict[str, Any]) -> str:
    """Return the environment's arguments in a checkpoint, or empty; raise CheckpointError if they are none."""
    found = manifest.get("arguments")
    if not isinstance(found, str) or (found and unusable_arguments(found)):
        raise CheckpointError("the checkpoint's arguments are not readable.")
    return found
