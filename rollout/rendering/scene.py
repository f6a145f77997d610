"""What a picture of one environment shows: its present state and its course so far."""

import math
from collections import deque
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from common.config import FarmConfig
from rollout.rendering.palette import TYPES
from rollout.sim.batch import FarmBatch
from rollout.sim.layout import Layout
from rollout.sim.reference import noise_mw, packet_loss, received_mw

Numbers = NDArray[np.float64]

TRAIL_STEPS: Final = 40
"""Steps that a UAV's trail is long."""
HALF: Final = 0.5
"""Least chance of a packet inside the circle that is drawn around a data collection UAV."""


@dataclass(frozen=True)
class Scene:
    """One environment as it is now. The arrays are the caller's own.

    Attributes:
        config: the farm.
        layout: its sensors.
        step: steps done.
        position: [n, 2] m.
        trail: [t + 1, n, 2] the last positions, the present one last, m.
        assignment: [n_m + n_d] relay of each served UAV.
        aoi: [S] units.
        vdf: [n_px, n_py] units.
        course: [step + 1, 2] mean AoI and mean VDF of every step that was observed; NaN where none was.
        reward: mean reward per agent of the episode so far, of each type and, under "mean", of all.
    """

    config: FarmConfig
    layout: Layout
    step: int
    position: Numbers
    trail: Numbers
    assignment: NDArray[np.int64]
    aoi: Numbers
    vdf: Numbers
    course: Numbers
    reward: dict[str, float]

    @property
    def headline(self) -> str:
        """Return which farm it is, and how far the episode has come."""
        return f"farm {self.layout.seed}, step {self.step} of {self.config.world.steps}"


class Observer:
    """Keeps what a scene needs beyond the present state.

    Args:
        batch: the simulator.
        index: which environment.
    """

    def __init__(self, batch: FarmBatch, index: int) -> None:
        self._batch, self._index = batch, index
        self._trail: deque[Numbers] = deque(maxlen=TRAIL_STEPS + 1)
        self._course: Numbers = np.full((batch.config.world.steps + 1, 2), np.nan)

    def observe(self) -> None:
        """Note the present state; to be called after every reset and step."""
        batch, index = self._batch, self._index
        step = int(batch.time[index])
        if step == 0:
            self._trail.clear()
            self._course[:] = np.nan
        self._trail.append(batch.position[index].copy())
        self._course[step] = batch.aoi[index].mean(), batch.vdf[index].mean()

    def scene(self) -> Scene:
        """Return the present scene; raise SimulationError before the first reset."""
        batch, index = self._batch, self._index
        layout = batch.layout(index)
        rewards, step = np.array(batch.summary(index).reward), int(batch.time[index])
        by_type = {
            name: float(rewards[part].mean()) for name, part in zip(TYPES, batch.team.agent_slices(), strict=True)
        }
        position = batch.position[index].copy()
        return Scene(
            config=batch.config,
            layout=layout,
            step=step,
            position=position,
            trail=np.stack([*self._trail]) if self._trail else position[None],
            assignment=batch.assignment[index].copy(),
            aoi=batch.aoi[index].copy(),
            vdf=batch.vdf[index].copy(),
            course=self._course[: step + 1].copy(),
            reward={**by_type, "mean": float(rewards.mean())},
        )


BISECTIONS: Final = 64
"""Most halvings of a distance; of fields so large that no two numbers lie as near as is asked for, fewer would do."""


def camera_radius(config: FarmConfig) -> float:
    """Return the horizontal distance below which a grid cell is photographed well, sqrt(d_th^2 - H_m^2), m."""
    return math.sqrt(max(0.0, config.camera.image_distance**2 - config.world.height_monitoring**2))


def radio_radius(config: FarmConfig) -> float:
    """Return the horizontal distance below which a packet arrives with a chance of one half, m.

    It is 0 where not even a sensor right below is heard so well, and at most the field's diagonal.
    """
    near, far = 0.0, math.hypot(config.world.field_x, config.world.field_y)
    if _chance(config, near) < HALF or _chance(config, far) >= HALF:
        return near if _chance(config, near) < HALF else far
    for _ in range(BISECTIONS):
        if far - near <= 0.01:
            break
        middle = 0.5 * (near + far)
        near, far = (middle, far) if _chance(config, middle) >= HALF else (near, middle)
    return near


def _chance(config: FarmConfig, horizontal: float) -> float:
    """Return 1 - PLR over a horizontal distance, without interference."""
    radio, distance = config.radio, math.hypot(horizontal, config.world.height_collection)
    return 1.0 - float(packet_loss(radio, received_mw(radio, distance) / noise_mw(radio)))
