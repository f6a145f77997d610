"""What the learner keeps in its run directory: checkpoints of the whole run, and the newest actors."""

from pathlib import Path
from typing import Any

import torch

from common.config import RunConfig
from common.config.files import digest
from common.errors import CheckpointError, RunDirError
from common.policy_file import save_policy
from common.process import log
from learner import checkpoint
from learner.intake import Intake
from learner.trainer import Trainer

CHECKPOINTS = "checkpoints"
POLICY = "policy.safetensors"


class RunStorage:
    """The run directory as the learner uses it; without a directory nothing is kept.

    Args:
        directory: the run directory, or None.
        config: the run; a checkpoint of another configuration is refused.
    """

    def __init__(self, directory: Path | None, config: RunConfig) -> None:
        self._directory = directory
        self._config = config

    def save(self, trainer: Trainer, intake: Intake, elapsed: float, epoch: int) -> bool:
        """Write a checkpoint; return False, and log why, when it is not fit to be kept or the disk does not take it.

        Training goes on after a failure: the checkpoint before is still whole.

        Args:
            trainer: its whole state is kept.
            intake: the ledger of what is in that state.
            elapsed: seconds that the run has taken.
            epoch: the learner's fencing epoch.
        """
        if self._directory is None:
            return True
        tensors, state = trainer.state()
        if not all(bool(torch.isfinite(tensor).all()) for tensor in tensors.values() if tensor.is_floating_point()):
            log("ALARM: no checkpoint is written, because a number of the training is no longer finite.")
            return False
        manifest: dict[str, Any] = {
            "configuration": digest(self._config),
            "trainer": state,
            "intake": intake.state(),
            "elapsed": elapsed,
            "epoch": epoch,
        }
        try:
            keep = self._config.learner.keep_checkpoints
            checkpoint.save(self._directory / CHECKPOINTS, tensors, manifest, keep)
        except OSError as error:
            log(f"ALARM: the checkpoint could not be written: {error}")
            return False
        return True

    def restore(self, trainer: Trainer, intake: Intake) -> tuple[float, int]:
        """Take up the newest whole checkpoint; return the seconds that the run has taken and the epoch it was in.

        A run that was killed before its first checkpoint begins anew.

        Raises:
            RunDirError: when the checkpoint is of another configuration.
            CheckpointError: when there are checkpoints and none of them is whole.
        """
        if self._directory is None or not (self._directory / CHECKPOINTS).is_dir():
            return 0.0, 0
        found = checkpoint.load_latest(self._directory / CHECKPOINTS)
        if found is None:
            return 0.0, 0
        for message in found.skipped:
            log(f"ALARM: {message}")
        manifest = found.manifest
        if manifest.get("configuration") != digest(self._config):
            raise RunDirError(f"the checkpoint in {self._directory} belongs to another configuration.")
        try:
            trainer.restore(found.tensors, manifest["trainer"])
            intake.restore(manifest["intake"])
            return float(manifest["elapsed"]), int(manifest["epoch"])
        except (KeyError, TypeError, ValueError) as error:
            raise CheckpointError(f"the checkpoint in {self._directory} is not readable: {error}") from error

    def write_policy(self, trainer: Trainer) -> None:
        """Write the present actors as policy.safetensors."""
        if self._directory is None:
            return
        metadata = {
            "seed": str(self._config.seed),
            "configuration": digest(self._config),
            "episodes": str(trainer.episodes),
            "environment_steps": str(trainer.environment_steps),
            "updates": str(trainer.updates),
        }
        save_policy(self._directory / POLICY, trainer.actors(), metadata)
