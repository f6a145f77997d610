"""Records one environment of a batch step by step, for people watching."""

from abc import ABC, abstractmethod
from typing import Final, Generic, Protocol, TypeVar

from eia_sec.common.protocol.messages import StepsMessage, ViewMessage
from eia_sec.common.protocol.view_checks import FRAMES, MOST_PICTURES
from eia_sec.rollout.envs.base import Environments

HELD: Final = 1024
"""Most frames held before they are taken. A full probe closes."""


class Frame(Protocol):
    """One step of an environment."""

    @property
    def step(self) -> int:
        """Number of the step; 0 is the state after the reset."""

    @property
    def weight(self) -> int:
        """Bytes of its picture."""


F = TypeVar("F", bound=Frame)
M = TypeVar("M", ViewMessage, StepsMessage)


class Probe(ABC, Generic[F, M]):
    """Keeps frames of one environment from its opening to the end of an episode.

    Args:
        environments: the batch.
        index: index of the environment.
        longest: most frames from an opening on. What ends in the middle of an episode goes on there when it is opened
            again.

    Attributes:
        index: index of the environment.
        again: whether it continues with the next episode when one ends.
        is_open: whether it records frames or waits for an episode to begin.
        pictures: pictures that it has recorded.
    """

    def __init__(self, environments: Environments, index: int, longest: int) -> None:
        self._environments, self.index, self._longest = environments, index, longest
        self._frames: list[F] = []
        self._waiting = self._cut = False
        self._since = 0
        self.again = True
        self.is_open = False
        self.pictures = 0

    @property
    def silence(self) -> str:
        """Return why the environment's code draws no pictures, a sentence, or an empty text."""
        return ""

    def open(self, *, at_once: bool) -> None:
        """Record frames from now on, or from the next episode's first step."""
        self.is_open, self._waiting = True, not (at_once or self._cut)
        self._since, self._cut = 0, False

    def close(self) -> None:
        """Stop recording frames."""
        self.is_open = self._cut = False

    def record(self) -> None:
        """Record a frame of the current state. Call it after every reset and every step of the environment."""
        if self._waiting and self._environments.time[self.index] == 0:
            self._waiting = False
        if not self.is_open or self._waiting:
            return
        if len(self._frames) >= HELD:
            self.is_open = False
            return
        self._frames.append(self._look())
        self._since += 1
        over = bool(self._environments.ended[self.index])
        if self._since >= self._longest:
            self.is_open, self._cut = False, not over
        elif over:
            self.is_open = self.again

    def take(self, skipped: int, noise_std: float, uniform: bool) -> list[M]:
        """Return the frames as messages of consecutive frames of one episode, and drop them here.

        Args:
            skipped: steps that were collected and not shown.
            noise_std: standard deviation of the exploration noise.
            uniform: whether actions were drawn uniformly instead.
        """
        held, self._frames = self._frames, []
        found: list[M] = []
        begin = weight = 0
        for end in range(1, len(held) + 1):
            weight += held[end - 1].weight
            if (
                end == len(held)
                or end - begin == FRAMES
                or held[end].step != held[end - 1].step + 1
                or weight + held[end].weight > MOST_PICTURES
            ):
                found.append(self._message(held[begin:end], skipped, noise_std, uniform))
                begin, weight = end, 0
        return found

    @abstractmethod
    def _look(self) -> F:
        """Return a frame of the current state."""

    @abstractmethod
    def _message(self, frames: list[F], skipped: int, noise_std: float, uniform: bool) -> M:
        """Return frames as a message."""
