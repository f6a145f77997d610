"""Calls the callbacks of plug-ins while the learner trains."""

from collections.abc import Mapping, Sequence

from eia_sec.common.callbacks import Callback, call
from eia_sec.common.config import RunConfig
from eia_sec.common.log import log
from eia_sec.learner.process.command_server import CommandServer
from eia_sec.learner.process.reporter import Reporter
from eia_sec.learner.process.trainer_progress import TrainerProgress
from eia_sec.learner.trainer import Trainer


class PluginCallbacks(TrainerProgress):
    """The callbacks, and the run as they see it.

    Args:
        config: the run.
        callbacks: what is called.
        trainer: its counters.
        reporter: its metrics.
        commands: ends the run, and hands arguments to the workers.
    """

    def __init__(
        self,
        config: RunConfig,
        callbacks: Sequence[Callback],
        trainer: Trainer,
        reporter: Reporter,
        commands: CommandServer,
    ) -> None:
        super().__init__(config, trainer)
        self._callbacks, self._reporter, self._commands = callbacks, reporter, commands

    @property
    def metrics(self) -> Mapping[str, float]:
        """See `TrainingProgress`."""
        return self._reporter.metrics

    def look(self) -> None:
        """Let them look at the run; drain if one stops it."""
        self.arguments = self._commands.arguments or self.arguments  # a command or a checkpoint may have set them
        call(self._callbacks, "on_progress", self)
        if self.stopped and not self._commands.draining:
            log(f"draining, because a callback stops the run: {self.reason}")
            self._commands.draining = True

    def end(self) -> None:
        """Tell them that the run has ended."""
        call(self._callbacks, "on_end", self)

    def _change(self, arguments: str) -> None:
        self._commands.arguments = arguments
