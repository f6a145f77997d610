"""Farms whose UAVs see what a heuristic would do in their place (`farm.observation.advice`).

A fresh actor follows the advice, so that learning begins where the heuristic is, and finds what the heuristic leaves.
Sources: action advising (Torrey and Taylor 2013), residual policy learning (Silver et al. 2018).
"""

import numpy as np
from numpy.typing import NDArray

from eia_sec.common.actions.adapters import POSITION, SIGNS, Headings, Lattice, NineMoves
from eia_sec.common.config import FarmConfig
from eia_sec.common.errors import ConfigError
from eia_sec.common.farm import advice_columns
from eia_sec.common.team import Float32, GroupSpec
from eia_sec.rollout.heuristics.composite import CompositePolicy
from eia_sec.rollout.heuristics.failsafe import FailsafeFarms
from eia_sec.rollout.heuristics.registry import RELAYS, TASKS, heuristic
from eia_sec.rollout.sim.boxes import Array


class AdvisedFarms(FailsafeFarms):
    """Farms that write the advice of a heuristic into the observations after each step.

    The heuristic flies along with the UAVs, wherever they go. After the last step nothing is advised. Options are
    coarser than what a heuristic does, so a UAV that chooses the marked one flies exactly as advised.

    Args:
        config: the farm.
        environments: E.
        threads: number of threads of the simulator; the heuristic has one.
        hindsight: as for `FarmBatch`.
    """

    advised = True

    def __init__(self, config: FarmConfig, environments: int, threads: int = 1, hindsight: bool = False) -> None:
        super().__init__(config, environments, threads, hindsight)
        found = heuristic(config.observation.advice, config)
        if not isinstance(found, CompositePolicy):
            raise ConfigError(
                f"farm.observation.advice must be one of {', '.join(TASKS)}, or TASK+{'|'.join(RELAYS)}, "
                f"not {config.observation.advice!r}."
            )
        self._heuristic = found
        self._columns = advice_columns(config)
        shape = environments, config.world.uavs, 2
        self._velocity: Float32 = np.zeros(shape, np.float32)
        self._marked: Float32 = np.full(shape, np.nan, np.float32)

    def reset(self, index: int, farm_seed: int, episode_seed: int) -> None:
        """Start an episode in one environment; see `FarmBatch.reset`."""
        super().reset(index, farm_seed, episode_seed)
        self._heuristic.reset(self, index)
        self._advise(np.array([index]))

    def step(self, action: Float32) -> None:
        """Step every environment; see `FarmBatch.step`."""
        super().step(self._followed(action) if action.shape == (len(self.time), self._marked[0].size) else action)
        under_way = np.flatnonzero(~self.ended)
        if len(under_way):
            self._advise(under_way)

    def _followed(self, action: Float32) -> Float32:
        """Return the actions, with the heuristic's own in place of those of the options that it marked."""
        chosen = action.reshape(self._marked.shape)
        follows = (chosen == self._marked).all(axis=-1, keepdims=True)
        return np.where(follows, self._velocity, chosen).reshape(action.shape)

    def _advise(self, indices: NDArray[np.int64]) -> None:
        """Write the advice of the present step into the observations of some environments."""
        velocity = self._heuristic.velocities(self, indices)
        self._velocity[indices] = velocity
        views, mirrored = self.team.split_observations(self.observation), self.config.observation.mirrored
        for group, rows, view, columns in zip(
            self.team.groups, self.team.agent_slices(), views, self._columns, strict=True
        ):
            seen, left = view[indices], ~self.gone[indices, rows, None]
            own = velocity[:, rows] * (seen[..., SIGNS] if mirrored else 1.0)
            marks = advice(group, seen, own)
            seen[..., columns] = marks * left
            view[indices] = seen
            if group.choices:
                option = marks.argmax(axis=-1)[..., None].astype(np.float32)
                self._marked[indices, rows] = np.where(left, group.adapt(seen, option), np.nan)


def advice(group: GroupSpec, observation: Float32, velocity: Array) -> Float32:
    """Return the numbers of an observation that advise a velocity.

    Args:
        group: the UAVs' type.
        observation: [..., o] float32.
        velocity: [..., 2] along the UAVs' own axes, as shares of full speed.

    Returns:
        [..., k] float32: 1 for the option that comes nearest to the velocity and 0 for all others; or, if the type has
        no options, the velocity.
    """
    for adapter in group.adapters:
        if isinstance(adapter, Lattice) and group.choices:
            return np.eye(NineMoves.options, dtype=np.float32)[nearest_move(adapter, observation, velocity)]
        if isinstance(adapter, Headings):
            return np.eye(Headings.options, dtype=np.float32)[nearest_heading(adapter, velocity)]
    return velocity.astype(np.float32)


def nearest_move(lattice: Lattice, observation: Float32, velocity: Array) -> NDArray[np.int64]:
    """Return which of nine moves leads to the cell that a velocity leads to, or towards it, [...]."""
    now, reach = observation[..., POSITION], np.array([lattice.reach_x, lattice.reach_y])
    then = (now + 2.0 * velocity * reach).astype(np.float32)
    step = np.clip(lattice.cell(then) - lattice.cell(now), -1, 1).astype(np.int64)
    move: NDArray[np.int64] = 3 * (step[..., 0] + 1) + step[..., 1] + 1
    return move


def nearest_heading(headings: Headings, velocity: Array) -> NDArray[np.int64]:
    """Return which option of headings is nearest to a velocity, [...]; idling counts as standing still."""
    options = np.concatenate([np.zeros((1, 2)), headings.velocities()])
    nearest: NDArray[np.int64] = ((velocity[..., None, :] - options) ** 2).sum(axis=-1).argmin(axis=-1)
    return nearest
