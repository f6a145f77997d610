"""A run that callbacks steer, counted by its trainer."""

from eia_sec.common.config import RunConfig
from eia_sec.common.steered_progress import SteeredProgress
from eia_sec.learner.trainer import Trainer


class TrainerProgress(SteeredProgress):
    """A run whose trainer is in this process.

    Args:
        config: the run.
        trainer: its counters.
    """

    def __init__(self, config: RunConfig, trainer: Trainer) -> None:
        super().__init__(config)
        self._trainer = trainer

    @property
    def environment_steps(self) -> int:
        """See `TrainingProgress`."""
        return self._trainer.environment_steps

    @property
    def episodes(self) -> int:
        """See `TrainingProgress`."""
        return self._trainer.episodes

    @property
    def updates(self) -> int:
        """See `TrainingProgress`."""
        return self._trainer.updates

    @property
    def progress(self) -> float:
        """See `TrainingProgress`."""
        return self._trainer.progress
