"""A batch of simulated farms, stepped by one compiled call."""

import copy
import itertools
from concurrent.futures import ThreadPoolExecutor
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from eia_sec.common.config import FarmConfig
from eia_sec.common.environment import EnvironmentSpec
from eia_sec.common.errors import SimulationError
from eia_sec.common.farm import farm_environment
from eia_sec.common.team import Float32, TeamSpec
from eia_sec.common.transitions import EpisodeSummary
from eia_sec.rollout.sim.conditions.failures import NEVER, failure_steps
from eia_sec.rollout.sim.conditions.stress import first_counters, patches, shorter, within
from eia_sec.rollout.sim.conditions.wind import wind_series
from eia_sec.rollout.sim.conditions.zones import zone_sides
from eia_sec.rollout.sim.core.arrays import REWARD_PARTS, make_scratch
from eia_sec.rollout.sim.core.step import BEGIN, NOT_FINITE, OUT_OF_TIME, STEP, check_step, step_range
from eia_sec.rollout.sim.core.workspace import PackedArguments, make_workspace
from eia_sec.rollout.sim.layout import Layout, by_rows, make_layout
from eia_sec.rollout.sim.start import packet_key, start_levels, start_positions
from eia_sec.rollout.sim.sweep_routes import divided_among, plot_centres

__all__ = ["REWARD_PARTS", "FarmBatch"]


class FarmBatch:
    """Farms that share a configuration and nothing else.

    An episode is a pure function of (farm seed, episode seed, actions), and is bit-equal in any batch. There is no
    automatic reset. All arrays stay the same objects over steps and resets; callers must not write to them.

    Args:
        config: the farm.
        environments: E.
        threads: number of threads; each steps a share of the environments. The number does not change the results.
        hindsight: whether to track what visits turn out to be worth.

    Attributes:
        config: the farm.
        team: layout of a row: c, then m, then d.
        observation: [E, O] float32, current observations of all agents.
        reward: [E, n] float32 rewards of the last step.
        parts: [E, n, K] weighted parts of the last step's reward, named by REWARD_PARTS; they sum to the reward.
        terminated: [E] always False (A5).
        position: [E, n, 2] m; a UAV that is gone stays where it failed.
        gone: [E, n] whether a UAV has failed (`farm.failures`), is missing or has no charge left.
        aoi: [E, S] age of information.
        vdf: [E, n_px, n_py] visual data freshness counters.
        assignment: [E, n_m + n_d] relay (0 .. n_c - 1) of each monitoring, then of each data collection UAV; -1 if
            the UAV or all relays are gone.
        service: [E, n_c] D_c, m.
        direction: [E, n, 2] current D_VDF or D_AoI; (0, 0) if there is none, and for relays.
        energy: [E, n] energy used in the last step, J.
        utility: [E, n] VMUF or DCUF of the last step, units; 0 for relays.
        served_sensors: [E, n_d] number of sensors with AoI above 0 that each UAV served in the last step.
        link_quality: [E, n_m + n_d] signal-to-noise ratio of the link between each served UAV and its relay, dB:
            P_ut minus the free-space loss (km and MHz, as in the assignment's cost) minus the noise k_B T B in dBm;
            NO_LINK without a relay.
        motion: [E, n, 6] velocity, acceleration and last command along x and y, m/s and m/s^2; [E, 0, 6] where UAVs
            reach any velocity at once (`farm.dynamics`).
        charge: [E, n] of the batteries, J; [E, 0] without batteries (`farm.battery`).
        patch_place: [E, P, 2] centres of the patches of stress, m.
        patch_time: [E, P, 2] first step of each patch, and the first one without it.
        patch_known: [E, P] whether the team knows it (`farm.stress`).
        plot_growth: [E, n_px, n_py] how many times as often VDF rises because of areas (`farm.stress.areas`), without
            patches; [E, 0, n_py] if there is no stress.
        sensor_growth: [E, S] the same of AoI; [E, 0] if there is no stress.
        stressed: [E, n_px, n_py] 1 for plots in areas, and in living patches that are known; [E, 0, n_py] if there is
            no stress.
        hindsight: [E, T, n] float32 what to add to the reward of each of the episode's T steps so that a visit is paid
            what it was worth to the team as far as known, see `eia_sec.rollout.sim.core.hindsight`; None unless
            tracked.

    Raises:
        ConfigError: the field is too small for the link budget.
        SimulationError: there is no environment, or no thread; or the configuration wants autopilots, which
            `eia_sec.rollout.heuristics.farms.make_farms` adds.
    """

    failsafe: ClassVar[bool] = False
    """Whether the class heeds `farm.battery.failsafe`."""

    def __init__(self, config: FarmConfig, environments: int, threads: int = 1, hindsight: bool = False) -> None:
        if config.battery.watched and not self.failsafe:
            raise SimulationError(
                "farms with farm.battery.failsafe are made by eia_sec.rollout.heuristics.farms.make_farms."
            )
        if environments < 1 or threads < 1:
            raise SimulationError(f"got {environments} environments and {threads} threads; both must be at least 1.")
        self.config = config
        self.spec: EnvironmentSpec = farm_environment(config)
        self.team: TeamSpec = self.spec.team
        shared = make_workspace(config, environments, hindsight)
        numbers = shared.constants
        scratches = (shared.scratch, *(make_scratch(config, numbers) for _ in range(min(threads, environments) - 1)))
        self._arguments = [PackedArguments(shared._replace(scratch=scratch)) for scratch in scratches]
        borders = [environments * k // len(self._arguments) for k in range(len(self._arguments) + 1)]
        self._shares = list(itertools.pairwise(borders))
        self._sweeping: NDArray[np.int64] = np.zeros(environments, np.int64)
        self._pool = ThreadPoolExecutor(len(self._arguments) - 1, "farms") if len(self._arguments) > 1 else None
        self._constants, self._state, self._action = shared.constants, shared.state, shared.action
        self._seeds: list[tuple[int, int]] = [(-1, -1)] * environments
        self.observation: Float32 = self._state.observation
        self.reward: Float32 = self._state.reward
        self.parts: NDArray[np.float64] = self._state.parts
        self.terminated: NDArray[np.bool_] = np.zeros(environments, np.bool_)
        self.position: NDArray[np.float64] = self._state.shown if config.loses_uavs else self._state.position
        self.gone: NDArray[np.bool_] = self._state.gone
        self.aoi: NDArray[np.float64] = self._state.age
        self.vdf: NDArray[np.float64] = self._state.level
        self.assignment: NDArray[np.int64] = self._state.assignment
        self.service: NDArray[np.float64] = self._state.service
        self.direction: NDArray[np.float64] = self._state.direction
        self.energy: NDArray[np.float64] = self._state.energy
        self.utility: NDArray[np.float64] = self._state.utility
        self.served_sensors: NDArray[np.float64] = self._state.served
        self.link_quality: NDArray[np.float64] = self._state.quality
        self.motion: NDArray[np.float64] = self._state.motion
        self.charge: NDArray[np.float64] = self._state.charge
        self.patch_place: NDArray[np.float64] = self._state.patch_place
        self.patch_time: NDArray[np.int32] = self._state.patch_time
        self.patch_known: NDArray[np.bool_] = self._state.patch_known
        self.stressed: NDArray[np.float64] = self._state.stressed
        self.hindsight: Float32 | None = self._state.hindsight if hindsight else None

    @property
    def time(self) -> NDArray[np.int64]:
        """[E] steps done in this episode; -1 before the first reset. A new view at each access."""
        return self._state.time[:, 0]

    @property
    def plot_growth(self) -> NDArray[np.int32]:
        """[E, n_px, n_py] how many times as often VDF rises because of areas; see above. A new view at each access."""
        return self._state.plot_cycle[:, 1]

    @property
    def sensor_growth(self) -> NDArray[np.int32]:
        """[E, S] how many times as often AoI rises because of areas; see above. A new view at each access."""
        return self._state.sensor_cycle[:, 1]

    @property
    def wind(self) -> NDArray[np.float64]:
        """[E, 2] wind of the last step, m/s; before the first that at the start, and 0 without wind."""
        series = self._state.wind
        if series.shape[1] == 0:
            return np.zeros((len(series), 2))
        return series[np.arange(len(series)), np.maximum(self.time, 0)]

    @property
    def potential(self) -> Float32:
        """[E, n] Phi = alpha_1 D_c t_step of relays (W1); else 0.

        The positioning part of r_c is -(Phi(k) - Phi(k-1)), see `eia_sec.rollout.sim.core.rewards`.
        """
        weight, phi = self._constants.reward, np.zeros_like(self.reward)
        phi[:, : self.service.shape[1]] = -weight.positioning * self.service * self.config.world.step_seconds
        return phi

    @property
    def ended(self) -> NDArray[np.bool_]:
        """[E] whether the episode is over. A farm's episode is truncated and never terminates."""
        return self.truncated

    @property
    def truncated(self) -> NDArray[np.bool_]:
        """[E] whether the episode has reached its last step."""
        finished: NDArray[np.bool_] = self.time == self.config.world.steps
        return finished

    def layout(self, index: int) -> Layout:
        """Return the farm of an environment; raise SimulationError before its first reset."""
        self._begun(index)
        return make_layout(self.config, self._seeds[index][0])

    def known_cycles(self, index: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return the cycles of an environment's counters as the team knows them, plots [P] and sensors [S], steps."""
        layout, world, stress = self.layout(index), self.config.world, self.config.stress
        plots = np.full(world.plots_x * world.plots_y, round(world.vdf_cycle / world.step_seconds))
        sensors = layout.sensor_cycle_steps
        if stress.some:
            first, end = self.patch_time[index].T
            known = self.patch_known[index] & (first <= self.time[index]) & (self.time[index] < end)
            place = self.patch_place[index]
            in_patch = (within(self.config, place, known, xy) for xy in (plot_centres(world), layout.sensor_xy))
            in_area = self.plot_growth[index].reshape(-1), self.sensor_growth[index]
            plots, sensors = (
                shorter(cycles, np.where(covered, np.maximum(growth, stress.growth), growth))
                for cycles, covered, growth in zip((plots, sensors), in_patch, in_area, strict=True)
            )
        return plots, sensors

    def seeds(self, index: int) -> tuple[int, int]:
        """Return the farm seed and the episode seed of an environment; -1 twice before its first reset."""
        return self._seeds[index]

    def reset(self, index: int, farm_seed: int, episode_seed: int) -> None:
        """Start an episode in one environment.

        Args:
            index: the environment.
            farm_seed: determines the farm.
            episode_seed: determines where the UAVs start, which packets arrive, when UAVs fail and how the wind blows.

        Raises:
            ConfigError: the sensors do not fit at their spacing.
        """
        layout = make_layout(self.config, farm_seed)
        state, e, world = self._state, index, self.config.world
        self._seeds[e] = (farm_seed, episode_seed)
        state.key[e] = packet_key(farm_seed, episode_seed)
        state.time[e] = 0
        state.motion[e] = 0.0
        state.position[e] = start_positions(world, farm_seed, episode_seed, layout.zones)
        state.age[e], state.level[e] = start_levels(world, farm_seed, episode_seed)
        state.sensor[e] = layout.sensor_xy.T
        state.cell_start[e] = layout.cell_start
        state.by_row[e], state.row_start[e] = by_rows(layout)
        self._begin_counters(e, layout)
        state.wind[e] = wind_series(self.config, farm_seed, episode_seed)
        state.zone_side[e], state.zone_box[e] = zone_sides(layout.zones)
        state.failure[e] = failure_steps(self.config, farm_seed, episode_seed)
        state.gone[e], state.living[e] = False, world.counts
        if self.config.battery.some:
            state.charge[e] = self.config.battery.capacity
        if self.config.observation.route:
            self._divide_field(e)
        for array in (state.reward, state.parts, state.energy, state.utility, state.served, state.returns, state.sums):
            array[e] = 0.0
        for visits in (state.plot_visit, state.sensor_visit, state.hindsight):
            visits[e] = 0
        step_range(self._arguments[0].address, e, e + 1, False, BEGIN)

    def _begin_counters(self, e: int, layout: Layout) -> None:
        """Set the cycles and first rises of an episode that begins, and draw patches of stress that nobody knows."""
        state, counters = self._state, first_counters(self.config, layout)
        state.cycle[e] = counters.sensor_cycle
        state.age_due[e], state.level_due[e] = counters.sensor_cycle, counters.plot_cycle
        state.rising[e] = counters.sensor_cycle.min(), counters.plot_cycle.min()
        if self.config.stress.some:
            state.patch_place[e], state.patch_time[e] = patches(self.config, *self._seeds[e])
            state.patch_known[e], state.stressed[e] = False, counters.plot_growth > 1
            state.plot_cycle[e] = counters.plot_cycle, counters.plot_growth
            state.sensor_cycle[e] = np.minimum(layout.sensor_cycle_steps, NEVER), counters.sensor_growth

    def step(self, action: Float32) -> None:
        """Step every environment.

        Args:
            action: [E, A] float32 velocities as fractions of the top speed; clipped to [-1, 1].

        Raises:
            SimulationError: an environment's episode has ended or was never begun, or the actions have the wrong shape
                or are not finite.
        """
        own = self._action
        if action.shape != own.shape or action.dtype != own.dtype:
            raise SimulationError(f"actions are {action.dtype}{list(action.shape)}, not float32{list(own.shape)}.")
        own[...] = action
        self._divide_again()
        address = self._arguments[0].address
        objection = check_step(address) if self._pool else step_range(address, 0, len(own), True, STEP)
        if objection == NOT_FINITE:
            raise SimulationError("an action is not finite.")
        if objection == OUT_OF_TIME:
            raise SimulationError("an environment was stepped before its reset or after its episode ended.")
        if self._pool:
            self._step_shares(self._pool)

    def _divide_again(self) -> None:
        """Divide the fields anew whose monitors have become fewer since they were divided."""
        if self.config.observation.route and self.config.loses_uavs:
            for e in np.flatnonzero(self._state.living[:, 1] != self._sweeping).tolist():
                self._divide_field(e)

    def _divide_field(self, e: int) -> None:
        """Give the monitors of an environment that are left the sweep routes of a field that is divided among them."""
        monitors = self.team.agent_slices()[1]
        left = ~self.gone[e, monitors]
        self._sweeping[e] = left.sum()
        if left.any():
            self._state.sweep[e][left] = divided_among(self.config, self._state.position[e, monitors][left])

    def _step_shares(self, pool: ThreadPoolExecutor) -> None:
        """Step a share of the environments on each thread; the caller's own thread takes the first."""
        work = [
            (packed.address, *share, False, STEP) for packed, share in zip(self._arguments, self._shares, strict=True)
        ]
        others = [pool.submit(step_range, *share) for share in work[1:]]
        step_range(*work[0])
        for other in others:
            other.result()

    def summary(self, index: int) -> EpisodeSummary:
        """Return the summary of an environment's episode so far; raise SimulationError before the first."""
        self._begun(index)
        farm, episode = self._seeds[index]
        steps = int(self.time[index])
        aoi, vdf, *rest = self._state.sums[index].tolist()
        failed = [float(self.gone[index].sum())] if self.config.loses_uavs else []
        metrics = (aoi / max(steps, 1), vdf / max(steps, 1), *rest, *failed)
        return EpisodeSummary(
            farm=farm,
            episode=episode,
            steps=steps,
            reward=tuple(self._state.returns[index].tolist()),
            metrics=dict(zip(self.spec.metric_names, metrics, strict=True)),
        )

    def close(self) -> None:
        """Do nothing: farms hold nothing outside this process's memory."""

    def __deepcopy__(self, memo: dict[int, Any]) -> "FarmBatch":
        """Return a copy that continues exactly as this batch would, with threads of its own."""
        twin = object.__new__(type(self))
        memo[id(self)] = twin
        fresh = ThreadPoolExecutor(len(self._arguments) - 1, "farms") if self._pool else None
        twin.__dict__ |= copy.deepcopy({name: item for name, item in self.__dict__.items() if name != "_pool"}, memo)
        twin._pool = fresh
        return twin

    def _begun(self, index: int) -> None:
        if self.time[index] < 0:
            raise SimulationError(f"environment {index} has not been reset yet.")
