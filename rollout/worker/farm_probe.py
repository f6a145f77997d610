"""Records one farm of a batch step by step, for people watching."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from eia_sec.common.protocol.messages import ViewMessage
from eia_sec.rollout.sim.batch import REWARD_PARTS, FarmBatch
from eia_sec.rollout.worker.probe import HELD, Probe


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
    weight: int = 0


class FarmProbe(Probe[_Frame, ViewMessage]):
    """Records a farm; see `Probe`.

    Args:
        batch: the simulator.
        index: index of the environment.
        parts: how many of the reward's parts it records, the first ones.
    """

    def __init__(self, batch: FarmBatch, index: int, parts: int = len(REWARD_PARTS)) -> None:
        super().__init__(batch, index, HELD)
        self._batch, self._parts = batch, parts
        slices = batch.team.agent_slices()
        self._starts = [part.start for part in slices]
        self._counts = np.array([part.stop - part.start for part in slices])[None, :, None]

    def _look(self) -> _Frame:
        batch, e = self._batch, self.index
        return _Frame(
            batch.seeds(e),
            int(batch.time[e]),
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

    def _message(self, frames: list[_Frame], skipped: int, noise_std: float, uniform: bool) -> ViewMessage:
        world = self._batch.config.world
        aoi, vdf = np.stack([frame.aoi for frame in frames]), np.stack([frame.vdf for frame in frames])
        parts = np.stack([frame.parts for frame in frames])[..., : self._parts]
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
