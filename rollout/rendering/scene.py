"""What a picture of one environment shows: its current state and its history in this episode."""

import math
from collections import deque
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from eia_sec.common.config import FarmConfig
from eia_sec.rollout.rendering.palette import TYPES
from eia_sec.rollout.sim.batch import FarmBatch
from eia_sec.rollout.sim.conditions.links import joined_relays, relay_gaps
from eia_sec.rollout.sim.layout import Layout
from eia_sec.rollout.sim.reference.farm import noise_mw, packet_loss, received_mw
from eia_sec.rollout.sim.stations import base_place

Numbers = NDArray[np.float64]

TRAIL_STEPS: Final = 40
"""Length of a UAV's trail, steps."""
HALF: Final = 0.5
"""A packet from inside a data collection UAV's circle arrives with at least this probability."""


@dataclass(frozen=True)
class Scene:
    """Snapshot of one environment. The caller owns the arrays.

    Attributes:
        config: the farm.
        layout: the farm's sensors.
        step: steps done.
        position: [n, 2] m.
        trail: [t + 1, n, 2] recent positions, m; the current one comes last.
        assignment: [n_m + n_d] relay of each served UAV.
        aoi: [S] units.
        vdf: [n_px, n_py] units.
        course: [step + 1, 2] mean AoI and mean VDF of every step; NaN for steps that were not observed.
        wind: [2] of the last step, m/s.
        reward: reward per agent in this episode so far, by type; "mean" is the mean over all agents.
        gone: [n] whether a UAV has failed.
        linked: [n_m + n_d] whether the link of a served UAV is up.
        joined: [n_c] whether hops lead from a relay to the base station; of farms without one, whether it lives.
        stress: [K, 2] centres of the patches of stress that there are now, m.
        known: [K] whether the team knows them.
        charge: [n] charge over capacity; [0] without batteries.
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
    wind: Numbers
    reward: dict[str, float]
    gone: NDArray[np.bool_]
    linked: NDArray[np.bool_]
    joined: NDArray[np.bool_]
    stress: Numbers
    known: NDArray[np.bool_]
    charge: Numbers

    @property
    def headline(self) -> str:
        """The farm's seed and the episode's progress."""
        return f"farm {self.layout.seed}, step {self.step} of {self.config.world.steps}"


class Observer:
    """Records the history that a scene needs beyond the current state.

    Args:
        batch: the simulator.
        index: index of the environment.
    """

    def __init__(self, batch: FarmBatch, index: int) -> None:
        self._batch, self._index = batch, index
        self._trail: deque[Numbers] = deque(maxlen=TRAIL_STEPS + 1)
        self._course: Numbers = np.full((batch.config.world.steps + 1, 2), np.nan)

    def observe(self) -> None:
        """Record the current state. Call it after every reset and every step."""
        batch, index = self._batch, self._index
        step = int(batch.time[index])
        if step == 0:
            self._trail.clear()
            self._course[:] = np.nan
        self._trail.append(batch.position[index].copy())
        self._course[step] = batch.aoi[index].mean(), batch.vdf[index].mean()

    def scene(self) -> Scene:
        """Return the current scene; raise SimulationError before the first reset."""
        batch, index = self._batch, self._index
        layout = batch.layout(index)
        rewards, step = np.array(batch.summary(index).reward), int(batch.time[index])
        by_type = {
            name: float(rewards[part].mean()) for name, part in zip(TYPES, batch.team.agent_slices(), strict=True)
        }
        position = batch.position[index].copy()
        joined = chain_of(batch.config, position, batch.gone[index])
        first, end = batch.patch_time[index].T
        lives = (first <= step) & (step < end)
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
            wind=batch.wind[index].copy(),
            reward={**by_type, "mean": float(rewards.mean())},
            gone=batch.gone[index].copy(),
            linked=links_up(batch.config, position, batch.assignment[index], joined),
            joined=joined,
            stress=batch.patch_place[index, lives].copy(),
            known=batch.patch_known[index, lives].copy(),
            charge=np.maximum(batch.charge[index], 0.0) / max(batch.config.battery.capacity, 1e-9),
        )


def chain_of(config: FarmConfig, position: Numbers, gone: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return which relays are joined to the base station, [n_c]; of farms without one, which live.

    Args:
        config: the farm.
        position: [n, 2] m.
        gone: [n] whether a UAV has failed.
    """
    relays = config.world.communication_uavs
    return joined_relays(config, position[:relays], gone[:relays])


def hop_lines(config: FarmConfig, position: Numbers, joined: NDArray[np.bool_]) -> list[Numbers]:
    """Return the ends of all hops between joined relays, and from them to the base station, [2, 2] m each.

    Args:
        config: a farm with a base station.
        position: [n, 2] of all UAVs, m.
        joined: [n_c] whether each relay is joined.
    """
    relays = position[: len(joined)]
    between, down = relay_gaps(config, relays)
    near = joined[:, None] & joined & (between <= config.relay.hop_range)
    pairs = np.argwhere(np.triu(near, 1))
    last = np.flatnonzero(joined & (down <= config.relay.hop_range))
    base = base_place(config)
    return [*relays[pairs], *(np.stack([relays[i], base]) for i in last)]


def links_up(
    config: FarmConfig, position: Numbers, assignment: NDArray[np.int64], joined: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """Return whether each served UAV has a relay, and where links count, one within range and joined, [n_m + n_d].

    Args:
        config: the farm.
        position: [n, 2] m.
        assignment: [n_m + n_d] relays; -1 for none.
        joined: [n_c] whether each relay is joined, see `chain_of`.
    """
    world, relay = config.world, config.relay
    height = np.repeat((world.height_monitoring, world.height_collection), world.counts[1:])
    flat = ((position[world.communication_uavs :] - position[assignment]) ** 2).sum(axis=1)
    near = flat + (height - world.height_communication) ** 2 <= relay.link_range**2
    up: NDArray[np.bool_] = (assignment >= 0) & (near & joined[assignment] if relay.require_link else True)
    return up


def wind_text(wind: Numbers) -> str:
    """Return speed and direction of a wind [2] m/s, or nothing without one."""
    if not wind.any():
        return ""
    bearing = round(math.degrees(math.atan2(-wind[0], -wind[1]))) % 360
    return f"wind {math.hypot(*wind):.1f} m/s from {bearing:03d}\N{DEGREE SIGN}"


BISECTIONS: Final = 64
"""Limit on bisection steps. On huge fields, floating point may never resolve the tolerance that we ask for."""


def camera_radius(config: FarmConfig) -> float:
    """Return the horizontal distance within which a grid cell gets a good image, sqrt(d_th^2 - H_m^2), m."""
    return math.sqrt(max(0.0, config.camera.image_distance**2 - config.world.height_monitoring**2))


def radio_radius(config: FarmConfig) -> float:
    """Return the horizontal distance within which a packet arrives with a probability of at least one half, m.

    It is 0 if not even a sensor right below the UAV reaches that probability. It never exceeds the field's diagonal.
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
    """Return 1 - PLR at a horizontal distance."""
    radio, distance = config.radio, math.hypot(horizontal, config.world.height_collection)
    return 1.0 - float(packet_loss(radio, received_mw(radio, distance) / noise_mw(radio)))
