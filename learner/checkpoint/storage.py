"""What the learner keeps in its run directory: checkpoints of the whole run, and the newest actors."""

import time
from pathlib import Path
from typing import Any, Protocol

from common.config import RunConfig
from common.config.files import digest, method_of
from common.errors import CheckpointError, PolicyError, RunDirError
from common.policy_file import save_policy
from common.process import log
from learner.checkpoint import files
from learner.checkpoint.writer import CheckpointWriter
from learner.intake.ledger import Intake
from learner.trainer import Trainer

CHECKPOINTS = "checkpoints"
POLICY = "policy.safetensors"


class Ledger(Protocol):
    """A ledger of accepted chunks that a checkpoint can hold."""

    def state(self) -> dict[str, Any]:
        """Return it as plain values."""


class RunStorage:
    """The run directory as the learner uses it; without a directory nothing is kept.

    Args:
        directory: the run directory, or None.
        config: the run; a checkpoint of another method is refused, see `common.config.files.method_of`.

    Attributes:
        skipped: checkpoints that fell due while the one before was still being written.
        pause: seconds for which the newest checkpoint stopped the training.
        longest_pause: the most that one did.
    """

    def __init__(self, directory: Path | None, config: RunConfig) -> None:
        self._directory = directory
        self._config = config
        self._digest, self._method = digest(config), digest(method_of(config))
        self._writer = CheckpointWriter(directory / CHECKPOINTS, config.learner.keep_checkpoints) if directory else None
        self.skipped = 0
        self.pause = self.longest_pause = 0.0

    @property
    def alarm(self) -> str:
        """Why the newest checkpoint is missing, or empty."""
        return self._writer.failure if self._writer else ""

    def save(self, trainer: Trainer, ledger: Ledger, elapsed: float, epoch: int, *, wait: bool = False) -> None:
        """Begin to write a checkpoint of this instant, or count it as skipped while the one before is being written.

        Training goes on meanwhile, and after a failure too (see `alarm`): the checkpoint before is still whole.

        Args:
            trainer: its whole state is kept.
            ledger: the ledger of the chunks in that state.
            elapsed: seconds that the run has taken.
            epoch: the learner's fencing epoch.
            wait: return only when it is on the disk, or has failed; it is not skipped then.
        """
        if self._writer is None:
            return
        if wait:
            self._writer.join()
        elif self._writer.busy:
            self.skipped += 1
            return
        started = time.perf_counter()
        tensors, state = trainer.snapshot()
        manifest: dict[str, Any] = {
            "configuration": self._method,
            "trainer": state,
            "intake": ledger.state(),
            "elapsed": elapsed,
            "epoch": epoch,
        }
        self._writer.start(tensors, manifest)
        self.pause = time.perf_counter() - started
        self.longest_pause = max(self.longest_pause, self.pause)
        if wait:
            self._writer.join()

    def close(self) -> None:
        """Wait until nothing is being written."""
        if self._writer is not None:
            self._writer.join()

    def statistics(self) -> dict[str, float]:
        """Return figures of the checkpoints since this start; of the newest where nothing else is said."""
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

    def restore(self, trainer: Trainer, intake: Intake) -> tuple[float, int]:
        """Take up the newest whole checkpoint; return the seconds that the run has taken and the epoch it was in.

        A run that was killed before its first checkpoint begins anew.

        Raises:
            RunDirError: when the checkpoint is of another configuration.
            CheckpointError: when there are checkpoints and none of them is whole.
        """
        if self._directory is None or not (self._directory / CHECKPOINTS).is_dir():
            return 0.0, 0
        found = files.load_latest(self._directory / CHECKPOINTS)
        if found is None:
            return 0.0, 0
        self._set_aside(found)
        manifest = found.manifest
        # Checkpoints of earlier versions name the whole configuration.
        if manifest.get("configuration") not in (self._method, self._digest):
            raise RunDirError(f"the checkpoint in {self._directory} belongs to another configuration.")
        try:
            trainer.restore(found.tensors, manifest["trainer"])
            intake.restore(manifest["intake"])
            return float(manifest["elapsed"]), int(manifest["epoch"])
        except (KeyError, TypeError, ValueError) as error:
            raise CheckpointError(f"the checkpoint in {self._directory} is not readable: {error}") from error

    def _set_aside(self, found: files.Found) -> None:
        for _, message in found.skipped:
            log(f"ALARM: {message}")
        try:
            files.set_aside([path for path, _ in found.skipped])
        except OSError as error:
            log(f"ALARM: a damaged checkpoint could not be set aside: {error.strerror or error}.")

    def write_policy(self, trainer: Trainer) -> str:
        """Write the present actors as policy.safetensors; return why that was not possible, or nothing."""
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
            save_policy(self._directory / POLICY, trainer.actors(), metadata)
        except PolicyError as error:
            log(f"ALARM: {error}")
            return str(error)
        return ""
