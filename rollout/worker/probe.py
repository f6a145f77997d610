"""Records one environment of a batch of farms step by step, for people watching."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from eia_sec.common.protocol.messages import ViewMessage
from eia_sec.common.protocol.view_checks import FRAMES
from eia_sec.rollout.sim.batch import FarmBatch

HELD: Final = 1024
"""Most frames held before they are taken. A full probe closes."""


@dataclass(frozen=True)
class _Frame:
    seeds: tuple[int, int]
    step: int
    position: NDArray[np.float64]
    assignment: NDArray[np.int64]
    quality: NDArray[np.float64]
    aoi: NDArray[np.float64]
    vdf: NDArray[np.float64]
    parts: NDArray[np.float64]
    gone: NDArray[np.bool_]
    charge: NDArray[np.float64]
    known: NDArray[np.bool_]


class Probe:
    """Keeps frames of one environment from its opening to the end of an episode.

    Args:
        batch: the simulator.
        index: index of the environment.

    Attributes:
        index: index of the environment.
        again: whether it continues with the next episode when one ends.
        is_open: whether it records frames or waits for an episode to begin.
    """

    def __init__(self, batch: FarmBatch, index: int) -> None:
        self._batch, self.index = batch, index
        self._frames: list[_Frame] = []
        self._waiting = False
        self.again = True
        self.is_open = False
        slices = batch.team.agent_slices()
        self._starts = [part.start for part in slices]
        self._counts = np.array([part.stop - part.start for part in slices])[None, :, None]

    def open(self, *, at_once: bool) -> None:
        """Record frames from now on, or from the next episode's first step."""
        self.is_open, self._waiting = True, not at_once

    def close(self) -> None:
        """Stop recording frames."""
        self.is_open = False

    def record(self) -> None:
        """Record a frame of the current state. Call it after every reset and every step of the environment."""
        batch, e = self._batch, self.index
        step = int(batch.time[e])
        if self._waiting and step == 0:
            self._waiting = False
        if not self.is_open or self._waiting:
            return
        if len(self._frames) >= HELD:
            self.is_open = False
            return
        self._frames.append(
            _Frame(
                batch.seeds(e),
                step,
                batch.position[e].copy(),
                batch.assignment[e].copy(),
                batch.link_quality[e].copy(),
                batch.aoi[e].copy(),
                batch.vdf[e].copy(),
                batch.parts[e].copy(),
                batch.gone[e].copy(),
                batch.charge[e].copy(),
                batch.patch_known[e].copy(),
            )
        )
        if step == batch.config.world.steps:
            self.is_open = self.again

    def take(self, skipped: int, noise_std: float, uniform: bool) -> list[ViewMessage]:
        """Return the frames as messages of consecutive frames of one episode, and drop them here.

        Args:
            skipped: steps that were collected and not shown.
            noise_std: standard deviation of the exploration noise.
            uniform: whether actions were drawn uniformly instead.
        """
        held, self._frames = self._frames, []
        found: list[ViewMessage] = []
        begin = 0
        for end in range(1, len(held) + 1):
            if end == len(held) or end - begin == FRAMES or held[end].step != held[end - 1].step + 1:
                found.append(self._message(held[begin:end], skipped, noise_std, uniform))
                begin = end
        return found

    def _message(self, frames: list[_Frame], skipped: int, noise_std: float, uniform: bool) -> ViewMessage:
        world = self._batch.config.world
        aoi, vdf = np.stack([frame.aoi for frame in frames]), np.stack([frame.vdf for frame in frames])
        parts = np.stack([frame.parts for frame in frames])
        means = np.stack([aoi.mean(axis=1), vdf.mean(axis=(1, 2))], axis=1)
        return ViewMessage(
            farm=frames[0].seeds[0],
            episode=frames[0].seeds[1],
            first=frames[0].step,
            skipped=skipped,
            noise_std=noise_std,
            uniform=uniform,
            position=np.stack([frame.position for frame in frames]).astype(np.float32),
            assignment=np.stack([frame.assignment for frame in frames]).astype(np.uint8),  # -1 becomes NO_RELAY
            quality=np.stack([frame.quality for frame in frames]).astype(np.float32),
            aoi=np.rint(aoi * (255.0 / world.aoi_max)).astype(np.uint8),
            vdf=np.rint(vdf * (255.0 / world.vdf_max)).astype(np.uint8),
            level=means.astype(np.float32),
            parts=(np.add.reduceat(parts, self._starts, axis=1) / self._counts).astype(np.float32),
            **self._optional(frames),
        )

    def _optional(self, frames: list[_Frame]) -> dict[str, NDArray[np.uint8]]:
        """Return the arrays that only farms with failures, batteries or patches of stress send."""
        config, found = self._batch.config, {}
        if config.loses_uavs:
            found["gone"] = np.stack([frame.gone for frame in frames]).astype(np.uint8)
        if config.battery.some:
            # The step that empties a battery can take more than was left.
            share = np.maximum(np.stack([frame.charge for frame in frames]), 0.0) / config.battery.capacity
            found["charge"] = np.rint(255.0 * share).astype(np.uint8)
        if config.stress.patches:
            found["known"] = np.stack([frame.known for frame in frames]).astype(np.uint8)
        return found
