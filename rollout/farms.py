"""A batch of simulated farms, stepped together by one compiled call."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from common.config import FarmConfig, WorldConfig
from common.errors import SimulationError
from common.seeds import derive, stream
from common.team import Float32, TeamSpec, farm_team
from common.transitions import EpisodeSummary
from rollout.kernel.arrays import make_scratch, make_state
from rollout.kernel.constants import constants
from rollout.kernel.rewards import REWARD_PARTS
from rollout.kernel.step import run
from rollout.layout import Layout, cell_counts, make_layout

__all__ = ["REWARD_PARTS", "FarmBatch", "packet_key", "start_levels", "start_positions"]

TRIES: Final = 200
"""Random places that are tried for a UAV before the distance it must keep shrinks by a tenth."""


class FarmBatch:
    """Environments that share a configuration and nothing else.

    An episode is a pure function of (farm seed, episode seed, actions): bit-equal in a batch of any size and order.
    There is no automatic reset. All arrays keep their identity over steps and resets; read them, do not write.

    Args:
        config: the farm.
        environments: E.

    Attributes:
        config: the farm.
        team: layout of a row: c, then m, then d.
        observation: [E, O] float32, what everybody sees now.
        reward: [E, n] float32, of the last step.
        parts: [E, n, K] weighted parts of the last step's reward, named by REWARD_PARTS; they sum to the reward.
        time: [E] steps done in this episode; -1 before the first reset.
        position: [E, n, 2] m.
        aoi: [E, S] age of information.
        vdf: [E, n_px, n_py] visual data freshness counters.
        assignment: [E, n_m + n_d] relay (0 .. n_c - 1) of each monitoring, then of each data collection UAV.
        service: [E, n_c] D_c, m.
        direction: [E, n, 2] D_VDF and D_AoI as seen now; (0, 0) if none, and for relays.
        energy: [E, n] of the last step, J.
        utility: [E, n] VMUF or DCUF of the last step, units; 0 for relays.
        served_sensors: [E, n_d] sensors of AoI above 0 that each UAV served in the last step (sum of the shares
            delivered when `delivery` is expected).

    Raises:
        ConfigError: the field is too small for the link budget.
        SimulationError: there is no environment.
    """

    def __init__(self, config: FarmConfig, environments: int) -> None:
        if environments < 1:
            raise SimulationError(f"a batch needs at least one environment, not {environments}.")
        self.config = config
        self.team: TeamSpec = farm_team(config)
        self._constants = constants(config, cell_counts(config.world))
        self._state = make_state(config, environments)
        self._scratch = make_scratch(config)
        self._still: Float32 = np.zeros((environments, self.team.action_size), np.float32)
        self._seeds: list[tuple[int, int]] = [(-1, -1)] * environments
        self.observation: Float32 = self._state.observation
        self.reward: Float32 = self._state.reward
        self.parts: NDArray[np.float64] = self._state.parts
        self.time: NDArray[np.int64] = self._state.time
        self.position: NDArray[np.float64] = self._state.position
        self.aoi: NDArray[np.float64] = self._state.age
        self.vdf: NDArray[np.float64] = self._state.level
        self.assignment: NDArray[np.int64] = self._state.assignment
        self.service: NDArray[np.float64] = self._state.service
        self.direction: NDArray[np.float64] = self._state.direction
        self.energy: NDArray[np.float64] = self._state.energy
        self.utility: NDArray[np.float64] = self._state.utility
        self.served_sensors: NDArray[np.float64] = self._state.served

    @property
    def truncated(self) -> NDArray[np.bool_]:
        """[E] whether the episode has reached its last step."""
        finished: NDArray[np.bool_] = self.time == self.config.world.steps
        return finished

    def layout(self, index: int) -> Layout:
        """Return the farm of an environment; raise SimulationError before its first reset."""
        self._begun(index)
        return make_layout(self.config, self._seeds[index][0])

    def reset(self, index: int, farm_seed: int, episode_seed: int) -> None:
        """Start an episode in one environment.

        Args:
            index: the environment.
            farm_seed: which farm.
            episode_seed: where the UAVs start, and which packets arrive.

        Raises:
            ConfigError: so many sensors do not fit at their spacing.
        """
        layout = make_layout(self.config, farm_seed)
        state, e, world = self._state, index, self.config.world
        self._seeds[e] = (farm_seed, episode_seed)
        state.key[e] = packet_key(farm_seed, episode_seed)
        state.time[e] = 0
        state.position[e] = start_positions(world, farm_seed, episode_seed)
        state.age[e], state.level[e] = start_levels(world, farm_seed, episode_seed)
        state.sensor[e] = layout.sensor_xy.T
        state.cell_start[e] = layout.cell_start
        state.cycle[e] = layout.sensor_cycle_steps
        state.age_due[e] = np.where(layout.sensor_phase > 0, layout.sensor_phase, layout.sensor_cycle_steps)
        state.level_due[e] = np.where(layout.plot_phase > 0, layout.plot_phase, self._constants.camera.cycle)
        for array in (state.reward, state.parts, state.energy, state.utility, state.served, state.returns, state.sums):
            array[e] = 0.0
        run(self._constants, state, self._scratch, self._still, e)

    def step(self, action: Float32) -> None:
        """Step every environment.

        Args:
            action: [E, A] float32, velocities as shares of the largest ones; clipped to [-1, 1].

        Raises:
            SimulationError: an environment is finished or was never reset, or the actions have another shape or are
                not finite.
        """
        wanted = (len(self.time), self.team.action_size)
        if action.shape != wanted or action.dtype != np.float32:
            raise SimulationError(f"actions are {action.dtype}{list(action.shape)}, not float32{list(wanted)}.")
        if not np.isfinite(action).all():
            raise SimulationError("an action is not finite.")
        if self.time.min() < 0 or self.time.max() >= self.config.world.steps:
            raise SimulationError("an environment was stepped before its reset or beyond its episode's end.")
        run(self._constants, self._state, self._scratch, np.ascontiguousarray(action), -1)

    def summary(self, index: int) -> EpisodeSummary:
        """Return what the running episode of an environment came to so far; raise SimulationError before any."""
        self._begun(index)
        farm, episode = self._seeds[index]
        steps = int(self.time[index])
        aoi, vdf, collisions, boundary, energy = self._state.sums[index].tolist()
        return EpisodeSummary(
            farm=farm,
            episode=episode,
            steps=steps,
            reward=tuple(self._state.returns[index].tolist()),
            aoi=aoi / max(steps, 1),
            vdf=vdf / max(steps, 1),
            collisions=collisions,
            boundary=boundary,
            energy_j=energy,
        )

    def _begun(self, index: int) -> None:
        if self.time[index] < 0:
            raise SimulationError(f"environment {index} has not been reset yet.")


def packet_key(farm_seed: int, episode_seed: int) -> int:
    """Return the 63-bit key from which the fate of every packet of an episode follows."""
    return derive(farm_seed, episode_seed, "packets")


def start_positions(world: WorldConfig, farm_seed: int, episode_seed: int) -> NDArray[np.float64]:
    """Return where the UAVs start, [n, 2] m: uniform, in one plane at least d_safety apart.

    Where a plane is too crowded for that, the distance shrinks by a tenth until a place is found.
    """
    random = stream(farm_seed, episode_seed, "start")
    size = np.array([world.field_x, world.field_y])
    planes = []
    for count in (world.communication_uavs, world.monitoring_uavs, world.collection_uavs):
        plane, apart = np.empty((count, 2)), world.safety_distance
        for uav in range(count):
            tries = 0
            plane[uav] = random.uniform(0.0, size)
            while uav > 0 and np.linalg.norm(plane[:uav] - plane[uav], axis=1).min() < apart:
                tries += 1
                if tries % TRIES == 0:
                    apart *= 0.9
                plane[uav] = random.uniform(0.0, size)
        planes.append(plane)
    return np.concatenate(planes)


def start_levels(
    world: WorldConfig, farm_seed: int, episode_seed: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return AoI [S] and VDF [n_px, n_py] at the start: all 0, or uniform over 0..max."""
    age, level = np.zeros(world.sensors), np.zeros((world.plots_x, world.plots_y))
    if world.start_levels == "random":
        random = stream(farm_seed, episode_seed, "levels")
        age += random.integers(0, world.aoi_max, world.sensors, endpoint=True)
        level += random.integers(0, world.vdf_max, level.shape, endpoint=True)
    return age, level
