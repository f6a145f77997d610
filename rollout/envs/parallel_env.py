"""The farm as a PettingZoo environment.

    from eia_sec.rollout.envs.parallel_env import parallel_env
    env = parallel_env()
    observations, infos = env.reset(seed=0)
    while env.agents:
        actions = {agent: env.action_space(agent).sample() for agent in env.agents}
        observations, rewards, terminations, truncations, infos = env.step(actions)

It matches `FarmBatch` with one environment bit for bit. Docs: docs/reference/environment.md.
"""

import itertools
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import gymnasium
import numpy as np
from gymnasium.spaces import Box
from pettingzoo import AECEnv, ParallelEnv
from pettingzoo.utils import parallel_to_aec

from eia_sec.common.config import FarmConfig
from eia_sec.common.config.presets import preset
from eia_sec.common.errors import SimulationError
from eia_sec.common.team import Float32
from eia_sec.rollout.envs.episodes import TRAINING_FARMS, EpisodeStream
from eia_sec.rollout.envs.spaces import action_box, observation_box, row_box
from eia_sec.rollout.heuristics.farms import make_farms
from eia_sec.rollout.rendering.render import FRAMES_PER_SECOND, RENDER_MODES, Renderer, require_mode
from eia_sec.rollout.sim.batch import REWARD_PARTS

Infos = dict[str, dict[str, Any]]
Observations = dict[str, Float32]


def parallel_env(
    config: FarmConfig | None = None, *, farms: Sequence[int] = TRAINING_FARMS, render_mode: str | None = None
) -> "FarmParallelEnv":
    """Return the farm as a PettingZoo ParallelEnv.

    Args:
        config: the farm; by default that of the preset study.
        farms: seeds of the farms to draw episodes from.
        render_mode: "rgb_array", "ansi", "human", or none.

    Raises:
        ConfigError: there is no farm, the farm is impossible, or the mode does not exist.
    """
    return FarmParallelEnv(config, farms=farms, render_mode=render_mode)


def env(
    config: FarmConfig | None = None, *, farms: Sequence[int] = TRAINING_FARMS, render_mode: str | None = None
) -> "AECEnv[str, Float32, Float32]":
    """Return the farm as a PettingZoo AECEnv, in which agents take turns; arguments as for `parallel_env`."""
    turns: AECEnv[str, Float32, Float32] = parallel_to_aec(parallel_env(config, farms=farms, render_mode=render_mode))
    return turns


class FarmParallelEnv(ParallelEnv[str, Float32, Float32]):  # type: ignore[misc]  # PettingZoo ships no types
    """One farm in which all UAVs act at once.

    Episodes never terminate; the last step truncates them for all agents. The caller owns the returned arrays: the next
    step does not change them.

    Args:
        config: the farm; by default that of the preset study.
        farms: seeds of the farms to draw episodes from.
        render_mode: "rgb_array", "ansi", "human", or none.

    Attributes:
        batch: the simulator, a batch of one.
        possible_agents: names of all agents in row order: "communication_0" and so on.
        agents: the same during an episode; empty before and after.
        observation_spaces: space of each agent's observations, [o_v] float32.
        action_spaces: space of each agent's actions, [2]: velocities as fractions of the top speed. The simulator
            clips actions outside it.
        state_space: space of `state()`, [O].
        render_mode: as given.

    Raises:
        ConfigError: there is no farm, the farm is impossible, or the mode does not exist.
    """

    metadata: ClassVar[dict[str, Any]] = {
        "name": "eia_sec_farm_v0",
        "render_modes": list(RENDER_MODES),
        "render_fps": FRAMES_PER_SECOND,
        "is_parallelizable": True,
    }

    def __init__(
        self,
        config: FarmConfig | None = None,
        *,
        farms: Sequence[int] = TRAINING_FARMS,
        render_mode: str | None = None,
    ) -> None:
        require_mode(render_mode)
        self.render_mode = render_mode
        self.batch = make_farms(config or preset("study").farm, 1)
        self._episodes = EpisodeStream(farms)
        self._episode = (-1, -1)
        self._renderer: Renderer | None = None
        team = self.batch.team
        self.possible_agents = list(team.agent_names)
        self.agents: list[str] = []
        types = [group for group in team.groups for _ in range(group.count)]
        ends = itertools.accumulate((group.observation_size for group in types), initial=0)
        self._slices = [slice(*pair) for pair in itertools.pairwise(ends)]
        self.observation_spaces: dict[str, Box] = {
            name: observation_box(self.batch.config, group.name)
            for name, group in zip(self.possible_agents, types, strict=True)
        }
        self.action_spaces: dict[str, Box] = {name: action_box(2) for name in self.possible_agents}
        self.state_space = row_box(self.batch.config)

    def observation_space(self, agent: str) -> Box:
        """Return the space of an agent's observations, always the same object."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> Box:
        """Return the space of an agent's actions, always the same object."""
        return self.action_spaces[agent]

    def reset(self, seed: int | None = None, options: Mapping[str, Any] | None = None) -> tuple[Observations, Infos]:
        """Begin an episode.

        Args:
            seed: restarts the stream of episodes: the same seed gives the same farms and episodes from here on. Without
                a seed the stream continues.
            options: "farm" and "episode" are the seeds of this episode; other keys are ignored.

        Returns:
            observations and infos of all agents.

        Raises:
            SimulationError: a seed is not a non-negative integer.
            ConfigError: the sensors do not fit at their spacing.
        """
        if seed is not None:
            self._episodes.begin(seed)
        self._episode = self._episodes.next(options)
        self.batch.reset(0, *self._episode)
        self.agents = list(self.possible_agents)
        self._show()
        return self._observations(), self._infos()

    def step(
        self, actions: Mapping[str, Float32]
    ) -> tuple[Observations, dict[str, float], dict[str, bool], dict[str, bool], Infos]:
        """Let all UAVs act for one step.

        Args:
            actions: one action [2] for each agent.

        Returns:
            observations, rewards, terminations (never), truncations (all at the last step) and infos.

        Raises:
            SimulationError: there is no episode, an agent is missing or unknown, or an action has the wrong shape or is
                not finite. The state stays as it was.
        """
        if not self.agents:
            raise SimulationError("there is no episode to step: it has ended or never started. Call reset first.")
        self.batch.step(self._row(actions))
        ended = bool(self.batch.truncated[0])
        agents = self.agents
        rewards = dict(zip(agents, self.batch.reward[0].tolist(), strict=True))
        result = (
            self._observations(),
            rewards,
            dict.fromkeys(agents, False),
            dict.fromkeys(agents, ended),
            self._infos(),
        )
        if ended:
            self.agents = []
        self._show()
        return result

    def state(self) -> Float32:
        """Return all observations in one row [O]; raise SimulationError before the first episode."""
        if self.batch.time[0] < 0:
            raise SimulationError("there is no state yet. Call reset first.")
        row: Float32 = self.batch.observation[0].copy()
        return row

    def render(self) -> Any:
        """Render the current state.

        Returns:
            an image [H, W, 3] uint8 for "rgb_array", coloured text for "ansi", None for "human" or without a mode.

        Raises:
            SimulationError: no episode has started yet.
        """
        if self.render_mode is None:
            gymnasium.logger.warn("render() was called, but the environment was made without a render_mode.")
            return None
        return self._drawn().render(self.render_mode)

    def close(self) -> None:
        """Release the picture and its window."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None

    def _observations(self) -> Observations:
        row = self.batch.observation[0].copy()
        return {name: row[part] for name, part in zip(self.possible_agents, self._slices, strict=True)}

    def _row(self, actions: Mapping[str, Float32]) -> Float32:
        """Return the actions as a row [1, A]."""
        if actions.keys() != set(self.agents):
            missing = [name for name in self.agents if name not in actions]
            unknown = [str(name) for name in actions if name not in self.agents]
            raise SimulationError(
                "; ".join(
                    f"{problem} {', '.join(names)}"
                    for problem, names in (("no action for", missing), ("an action for unknown", unknown))
                    if names
                )
                + "."
            )
        row = np.empty((1, self.batch.team.environment_action_size), np.float32)
        for index, name in enumerate(self.agents):
            try:
                action = np.asarray(actions[name], np.float32)
            except (TypeError, ValueError) as error:
                raise SimulationError(f"the action of {name} is {actions[name]!r}, not two numbers.") from error
            if action.shape != (2,):
                raise SimulationError(f"the action of {name} has shape {list(action.shape)}, not [2].")
            row[0, 2 * index : 2 * index + 2] = action
        return row

    def _infos(self) -> Infos:
        """Return the last step's infos for each agent."""
        batch, names = self.batch, self.possible_agents
        farm, episode = self._episode
        common: dict[str, Any] = {
            "farm": farm,
            "episode": episode,
            "aoi": float(batch.aoi[0].mean()),
            "vdf": float(batch.vdf[0].mean()),
        }
        if batch.truncated[0]:
            common["summary"] = batch.summary(0)
        energy, utility, parts = batch.energy[0].tolist(), batch.utility[0].tolist(), batch.parts[0].tolist()
        links = self._links()
        return {
            name: {
                **common,
                "energy": energy[index],
                "utility": utility[index],
                "reward_parts": dict(zip(REWARD_PARTS, parts[index], strict=True)),
                "assignment": links[index][0],
                "link_quality": links[index][1],
            }
            for index, name in enumerate(names)
        }

    def _links(self) -> list[tuple[Any, Any]]:
        """Return each agent's link partner, None without a relay, and link quality, dB; lists for relays."""
        batch, names = self.batch, self.possible_agents
        relays = batch.team.groups[0].count
        assignment = batch.assignment[0].tolist()
        quality = batch.link_quality[0].tolist()
        served: list[tuple[list[str], list[float]]] = [([], []) for _ in range(relays)]
        for index, (relay, decibels) in enumerate(zip(assignment, quality, strict=True)):
            if relay >= 0:
                served[relay][0].append(names[relays + index])
                served[relay][1].append(decibels)
        partners = [names[relay] if relay >= 0 else None for relay in assignment]
        return [*served, *zip(partners, quality, strict=True)]

    def _drawn(self) -> Renderer:
        if self._renderer is None:
            self._renderer = Renderer(self.batch, 0)
        return self._renderer

    def _show(self) -> None:
        """Record the state for trails, and draw it if the mode is "human"."""
        if self.render_mode is not None:
            self._drawn().observe()
            if self.render_mode == "human":
                self._drawn().render("human")
