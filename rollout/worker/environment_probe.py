"""Records one environment that is no farm step by step, with pictures where it draws some, for people watching."""

import io
import math
import time
from collections import deque
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from eia_sec.common.protocol.messages import StepsMessage
from eia_sec.common.protocol.view_checks import MOST_PICTURE, MOST_SIDE
from eia_sec.common.team import Float32, slices
from eia_sec.rollout.envs.pettingzoo_batch import PettingZooBatch
from eia_sec.rollout.envs.vectorised import VectorisedBatch
from eia_sec.rollout.worker.probe import Probe

LONGEST: Final = 500
"""Most frames from an opening on."""
SHARE: Final = 0.1
"""Most of the worker's time that pictures take, on average."""
HELD_BYTES: Final = 32 * 2**20
"""Most bytes of pictures held before they are taken; further steps have none."""
TIMED: Final = 5
"""Newest pictures whose mean tells what one costs; the first of all is not counted, because it may load a library."""


@dataclass(frozen=True)
class _Frame:
    seeds: tuple[int, int]
    step: int
    reward: Float32
    action: Float32
    seen: Float32
    alive: NDArray[np.bool_]
    picture: bytes

    @property
    def weight(self) -> int:
        return len(self.picture)


class EnvironmentProbe(Probe[_Frame, StepsMessage]):
    """Records an environment; see `Probe`.

    It asks for pictures when it is opened the first time. Of the steps it draws so many that at `pace` steps a second
    they take SHARE of the time.

    Args:
        batch: the environments.
        index: index of the environment.
        pace: steps shown in a second, on average.
        silence: why nothing is to be drawn, a sentence, or empty.
    """

    def __init__(self, batch: PettingZooBatch | VectorisedBatch, index: int, pace: float, silence: str = "") -> None:
        super().__init__(batch, index, LONGEST)
        self._batch, self._pace, self._forbidden = batch, pace, silence
        sizes = [group.observation_size for group in batch.team.groups for _ in range(group.count)]
        self._parts = slices(tuple(sizes))
        self._seconds: deque[float] = deque(maxlen=TIMED)
        self._undrawn = self._held = 0

    @property
    def silence(self) -> str:
        """Return why the environment's code draws no pictures, a sentence, or an empty text."""
        return self._forbidden or self._batch.silence

    def open(self, *, at_once: bool) -> None:
        """Record frames from now on, or from the next episode's first step."""
        super().open(at_once=at_once)
        if not self._forbidden:
            self._batch.ask_for_pictures(self.index)

    def close(self) -> None:
        """Stop recording frames, and let the environment be a plain one again from its next episode on."""
        super().close()
        self._batch.ask_for_no_pictures(self.index)

    def take(self, skipped: int, noise_std: float, uniform: bool) -> list[StepsMessage]:
        """Return the frames as messages, see `Probe.take`."""
        self._held = 0
        return super().take(skipped, noise_std, uniform)

    def _look(self) -> _Frame:
        batch, e = self._batch, self.index
        row = batch.observation[e]
        seen = [[part.min(), part.mean(), part.max()] for part in (row[place] for place in self._parts)]
        return _Frame(
            batch.seeds(e),
            int(batch.time[e]),
            batch.reward[e].copy(),
            batch.action[e].copy(),
            np.array(seen, np.float32),
            batch.alive(e),
            self._picture(),
        )

    def _picture(self) -> bytes:
        """Return a picture of the state as a PNG file, or nothing where none is due."""
        self._undrawn += 1
        cost = sum(self._seconds) / max(1, len(self._seconds))
        if self._undrawn < math.ceil(cost * self._pace / SHARE) or self._held + MOST_PICTURE > HELD_BYTES:
            return b""
        began = time.perf_counter()
        found = None if self._forbidden else self._batch.picture(self.index)
        if found is None:
            return b""
        file = _png(found)
        if self.pictures:
            self._seconds.append(time.perf_counter() - began)
        self._undrawn = 0
        self._held += len(file)
        self.pictures += 1
        return file

    def _message(self, frames: list[_Frame], skipped: int, noise_std: float, uniform: bool) -> StepsMessage:
        files = [frame.picture for frame in frames]
        return StepsMessage(
            scenario=frames[0].seeds[0],
            episode=frames[0].seeds[1],
            first=frames[0].step,
            skipped=skipped,
            noise_std=noise_std,
            uniform=uniform,
            reward=np.stack([frame.reward for frame in frames]),
            action=np.stack([frame.action for frame in frames]),
            seen=np.stack([frame.seen for frame in frames]),
            alive=np.stack([frame.alive for frame in frames]).astype(np.uint8),
            pictures=np.frombuffer(b"".join(files), np.uint8),
            ends=np.cumsum([len(file) for file in files]).astype(np.int64),
            silence=self.silence,
        )


def _png(picture: NDArray[np.uint8]) -> bytes:
    """Return a picture as a PNG file, made smaller where a side has more than MOST_SIDE pixels."""
    image = Image.fromarray(picture)
    image.thumbnail((MOST_SIDE, MOST_SIDE), Image.Resampling.BILINEAR)
    file = io.BytesIO()
    image.save(file, "PNG", compress_level=1)
    return file.getvalue()
