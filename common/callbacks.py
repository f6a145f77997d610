"""What a program does while a run trains: stop it, change the environment's arguments, or log.

class Harder(Callback):
    def on_progress(self, training):
        if training.reward > -8.0:
            training.set_arguments(size=8)

eia_sec.train("mytask.env:Cover", callbacks=[Harder()])
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any, Final

from eia_sec.common.errors import CallbackError
from eia_sec.common.protocol.metrics import EPISODIC_RETURN

SHOWN: Final = 200
"""Most characters of a reason that a callback gives."""


class TrainingProgress(ABC):
    """A run that trains, as a callback sees it at one moment."""

    @property
    @abstractmethod
    def environment_steps(self) -> int:
        """Environment steps that the learner has accepted."""

    @property
    @abstractmethod
    def episodes(self) -> int:
        """Training episodes finished."""

    @property
    @abstractmethod
    def updates(self) -> int:
        """Updates done."""

    @property
    @abstractmethod
    def progress(self) -> float:
        """The finished share of the run, 0 to 1."""

    @property
    @abstractmethod
    def metrics(self) -> Mapping[str, float]:
        """Rewards, episode metrics and diagnostics by TensorBoard's names, `charts/episodic_return` for one."""

    @property
    def reward(self) -> float:
        """Mean reward per agent over the newest 40 episodes; not a number before the first one ends."""
        return self.metrics.get(EPISODIC_RETURN, float("nan"))

    @abstractmethod
    def stop(self, reason: str = "") -> None:
        """End the run after this moment; its policy is kept. `Run.stopped` has the reason."""

    @abstractmethod
    def set_arguments(self, **arguments: Any) -> None:
        """Change arguments of the environment, as `env.arguments` names them; others stay.

        Each environment is made anew when its next episode begins. A run that is resumed goes on with them.

        Raises:
            ConfigError: the run's environment takes no arguments, one is no JSON value, or they are too long.
        """


class Callback:
    """Called while a run trains; derive from it and override what you need.

    In one process the calls come after every chunk and its updates, with workers once a second. They come in the
    thread that trains or waits, so a slow callback slows training in one process.
    """

    def on_progress(self, training: TrainingProgress) -> None:
        """Look at a run that trains."""

    def on_end(self, training: TrainingProgress) -> None:
        """Look at a run that has ended, finished or stopped."""


def require_callbacks(found: Sequence[object]) -> None:
    """Raise CallbackError where something is no callback."""
    for each in found:
        if not isinstance(each, Callback):
            raise CallbackError(f"{each!r} is no callback; give an instance of a class derived from eia_sec.Callback.")


def call(callbacks: Sequence[Callback], method: str, training: TrainingProgress) -> None:
    """Call a method of all callbacks.

    Raises:
        CallbackError: one raises an exception; its message names the class, the method and the exception.
    """
    for callback in callbacks:
        try:
            getattr(callback, method)(training)
        except Exception as error:
            own = type(callback)
            raise CallbackError(
                f"{own.__module__}.{own.__qualname__}.{method} raised {type(error).__name__}: {error}"
            ) from error
