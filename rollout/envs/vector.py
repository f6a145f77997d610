"""Many farms as one Gymnasium vector environment, without copies.

It is `FarmBatch` with Gymnasium's interface. Two things differ from a single-agent vector environment: observations and
actions are dictionaries keyed by type of agent, and rewards have a column for each agent, [E, n].
"""

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
from gymnasium.spaces import Dict
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from eia_sec.common.config import FarmConfig
from eia_sec.common.config.presets import preset
from eia_sec.common.errors import ConfigError, SimulationError
from eia_sec.common.team import Float32, TeamSpec
from eia_sec.rollout.envs.episodes import TRAINING_FARMS, EpisodeStream, whole
from eia_sec.rollout.envs.spaces import action_box, observation_box
from eia_sec.rollout.heuristics.farms import make_farms
from eia_sec.rollout.rendering.render import FRAMES_PER_SECOND, RENDER_MODES, Renderer, require_mode

Observations = dict[str, Float32]
Mask = NDArray[np.bool_]

INFO_ARRAYS: Final = ("aoi", "vdf", "position", "assignment", "link_quality", "service", "energy", "utility", "parts")
"""Arrays of FarmBatch that every info holds as read-only views."""


class FarmVectorEnv(VectorEnv[Observations, Float32 | Mapping[str, Float32], NDArray[Any]]):
    """E farms that one compiled call steps.

    `reset` and `step` return views of the simulator's own arrays, which the next call changes; copy what you want to
    keep. You may write to observations and rewards, because the simulator never reads them; the arrays in infos are
    read-only. Environment e with seed s + e has the same episodes as `parallel_env` with that seed.

    Args:
        num_envs: E.
        config: the farm; by default that of the preset study.
        farms: seeds of the farms to draw episodes from.
        autoreset_mode: what happens when an episode ends, as Gymnasium defines it. SAME_STEP: the next episode begins
            in the same call; the last observation is `infos["final_obs"][e]`, and the last info `infos["final_info"]`.
            NEXT_STEP: it begins in the next call, which ignores the action and returns reward 0. DISABLED: the caller
            resets with options={"reset_mask": [E] bool}.
        render_mode: "rgb_array", "ansi", "human", or none.
        rendered: the environments that `render` shows.

    Attributes:
        batch: the simulator.
        num_envs: E.
        single_observation_space: by type, [n_v, o_v] float32.
        observation_space: by type, [E, n_v, o_v] float32.
        single_action_space: by type, [n_v, 2] float32.
        action_space: by type, [E, n_v, 2] float32; `step` also takes one row [E, A] float32, which it does not copy.
        render_mode: as given.

    Raises:
        ConfigError: there is no farm, the farm is impossible, or the mode or an environment to render does not exist.
        SimulationError: there is no environment.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 - Gymnasium declares it so; every instance gets its own
        "render_modes": list(RENDER_MODES),
        "render_fps": FRAMES_PER_SECOND,
        "autoreset_mode": AutoresetMode.SAME_STEP,
    }

    def __init__(
        self,
        num_envs: int = 1,
        config: FarmConfig | None = None,
        *,
        farms: Sequence[int] = TRAINING_FARMS,
        autoreset_mode: AutoresetMode | str = AutoresetMode.SAME_STEP,
        render_mode: str | None = None,
        rendered: Sequence[int] = (0,),
    ) -> None:
        require_mode(render_mode)
        self.batch = make_farms(config or preset("study").farm, num_envs)
        self.num_envs = num_envs
        self._mode = _autoreset(autoreset_mode)
        self.metadata = {**type(self).metadata, "autoreset_mode": self._mode}
        self.render_mode = render_mode
        if not all(0 <= index < num_envs for index in rendered):
            raise ConfigError(f"cannot render environments {list(rendered)}; there are only 0 to {num_envs - 1}.")
        self._renderers = [Renderer(self.batch, index) for index in rendered] if render_mode else []
        self._streams = [EpisodeStream(farms) for _ in range(num_envs)]
        self._episodes = [(-1, -1)] * num_envs
        self._due: Mask = np.zeros(num_envs, np.bool_)
        self._make_spaces(self.batch.team)
        self._actions: Float32 = np.zeros((num_envs, self.batch.team.environment_action_size), np.float32)
        self._look()

    def _look(self) -> None:
        """Make the views of the batch that every step returns."""
        self._views = _by_type(self.batch.team, self.batch.observation)
        self._infos = {name: _read_only(getattr(self.batch, name)) for name in INFO_ARRAYS}

    def __getstate__(self) -> dict[str, Any]:
        """Leave views out: a copy of one would show the original's numbers of this moment for ever."""
        return {name: value for name, value in self.__dict__.items() if name not in ("_views", "_infos")}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Take a copy's state, and look at its own batch."""
        self.__dict__ |= state
        self._look()

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: Mapping[str, Any] | None = None,
    ) -> tuple[Observations, dict[str, Any]]:
        """Begin an episode in every environment, or in those of a mask.

        Args:
            seed: environment e restarts its stream of episodes with seed + e, or with entry e of a list. Without a seed
                the streams continue.
            options: "reset_mask", [E] bool: the environments to reset; "farm" and "episode": one seed for all of
                them, or a list of E seeds. Other keys are ignored.

        Returns:
            observations and infos.

        Raises:
            SimulationError: a seed, an option or the mask is malformed.
            ConfigError: the sensors do not fit into the field.
        """
        seeds = self._seeds(seed)
        chosen = dict(options or {})
        mask = self._mask(chosen.pop("reset_mask", None))
        for index in np.flatnonzero(mask).tolist():
            start = seeds[index]
            if start is not None:
                self._streams[index].begin(start)
            self._begin(index, {name: self._entry(name, chosen.get(name), index) for name in ("farm", "episode")})
        self._due[mask] = False
        self._show()
        return dict(self._views), dict(self._infos)

    def step(
        self, actions: Float32 | Mapping[str, Float32]
    ) -> tuple[Observations, Float32, Mask, Mask, dict[str, Any]]:
        """Step every environment.

        Args:
            actions: by type, [E, n_v, 2], or a row [E, A] float32.

        Returns:
            observations, rewards [E, n], terminations [E] (never), truncations [E] and infos.

        Raises:
            SimulationError: an environment was never reset or its episode has ended, or the actions have the wrong
                shape or are not finite.
            ConfigError: an environment begins anew, and the sensors do not fit into the field.
        """
        row = self._row(actions)
        if self._due.any():
            return self._step_due(row)
        self.batch.step(row)
        ended = self.batch.truncated
        return self._result(ended)

    def render(self) -> tuple[Any, ...] | None:
        """Render the environments of `rendered`.

        Returns:
            an image [H, W, 3] uint8 or a text for each of them; None for "human" or without a mode.
        """
        if self.render_mode is None:
            return None
        frames = tuple(renderer.render(self.render_mode) for renderer in self._renderers)
        return None if self.render_mode == "human" else frames

    def close_extras(self, **_: Any) -> None:
        """Release pictures and windows."""
        for renderer in self._renderers:
            renderer.close()

    def _make_spaces(self, team: TeamSpec) -> None:
        config = self.batch.config
        single = {group.name: observation_box(config, group.name, (group.count,)) for group in team.groups}
        actions = {group.name: action_box(group.count, group.environment_action_size) for group in team.groups}
        # Pairs, because Gymnasium would sort a dictionary by name.
        self.single_observation_space = Dict([*single.items()])
        self.single_action_space = Dict([*actions.items()])
        self.observation_space = Dict([(name, batch_space(box, self.num_envs)) for name, box in single.items()])
        self.action_space = Dict([(name, batch_space(box, self.num_envs)) for name, box in actions.items()])

    def _result(self, ended: Mask) -> tuple[Observations, Float32, Mask, Mask, dict[str, Any]]:
        """Return the step's results. In SAME_STEP mode, begin the next episodes first."""
        infos: dict[str, Any] = dict(self._infos)
        rewards = self.batch.reward
        if ended.any():
            summaries = {"summary": _objects(ended, self.batch.summary), "_summary": ended}
            if self._mode is AutoresetMode.SAME_STEP:
                rewards = rewards.copy()
                infos |= self._finals(ended, summaries)
                for index in np.flatnonzero(ended).tolist():
                    self._begin(index)
            else:
                infos |= summaries
                self._due = ended.copy()
        self._show()
        return dict(self._views), rewards, np.zeros(self.num_envs, np.bool_), ended, infos

    def _finals(self, ended: Mask, summaries: dict[str, Any]) -> dict[str, Any]:
        """Return copies of the final observations and infos of ended environments, in Gymnasium's form."""
        last = _by_type(self.batch.team, self.batch.observation.copy())
        info = {name: array.copy() for name, array in self._infos.items()} | summaries
        return {
            "final_obs": _objects(ended, lambda index: {name: rows[index] for name, rows in last.items()}),
            "_final_obs": ended,
            "final_info": info,
            "_final_info": ended,
        }

    def _step_due(self, row: Float32) -> tuple[Observations, Float32, Mask, Mask, dict[str, Any]]:
        """Begin the episodes that are due and step the other environments (NEXT_STEP)."""
        due = self._due
        if self._mode is AutoresetMode.DISABLED:
            raise SimulationError(f"environments {np.flatnonzero(due).tolist()} have ended; reset them by reset_mask.")
        if row.shape != self._actions.shape or row.dtype != np.float32 or not np.isfinite(row).all():
            raise SimulationError(f"actions must be finite float32 numbers of shape {list(self._actions.shape)}.")
        indices = np.flatnonzero(due).tolist()
        for index in indices:
            self._begin(index)
        self._due = np.zeros(self.num_envs, np.bool_)
        if due.all():
            return self._result(self.batch.truncated)
        # The batch steps all environments or none, so the new episodes step too and then start again.
        still = np.where(due[:, None], np.float32(0.0), row)
        self.batch.step(still)
        for index in indices:
            self.batch.reset(index, *self._episodes[index])
        return self._result(self.batch.truncated)

    def _begin(self, index: int, options: Mapping[str, Any] | None = None) -> None:
        self._episodes[index] = self._streams[index].next(options)
        self.batch.reset(index, *self._episodes[index])

    def _row(self, actions: Float32 | Mapping[str, Float32]) -> Float32:
        """Return the actions as one row. A row is returned as it is, without a copy."""
        if not isinstance(actions, Mapping):
            return actions
        team = self.batch.team
        if set(actions) != {group.name for group in team.groups}:
            raise SimulationError(f"actions are given for {', '.join(map(str, actions))} only, not for every type.")
        for group, part in zip(team.groups, team.split_actions(self._actions), strict=True):
            if np.shape(actions[group.name]) != part.shape:
                raise SimulationError(
                    f"the actions of type {group.name} have shape {list(np.shape(actions[group.name]))}, "
                    f"not {list(part.shape)}."
                )
            part[...] = actions[group.name]
        return self._actions

    def _seeds(self, seed: int | Sequence[int | None] | None) -> Sequence[int | None]:
        if seed is None:
            return [None] * self.num_envs
        if not isinstance(seed, Sequence):
            super().reset(seed=whole("a seed", seed))
            return [seed + index for index in range(self.num_envs)]
        if len(seed) != self.num_envs:
            raise SimulationError(f"got {len(seed)} seeds for {self.num_envs} environments.")
        return [None if start is None else whole("a seed", start) for start in seed]

    def _mask(self, mask: Any) -> Mask:
        if mask is None:
            return np.ones(self.num_envs, np.bool_)
        if not isinstance(mask, np.ndarray) or mask.dtype != np.bool_ or mask.shape != (self.num_envs,):
            raise SimulationError(f"options['reset_mask'] is not a bool array of shape [{self.num_envs}].")
        return mask

    def _entry(self, name: str, value: Any, index: int) -> Any:
        """Return an environment's value of an option that holds one value for all or one for each."""
        if value is None or np.ndim(value) == 0:
            return value
        if np.shape(value) != (self.num_envs,):
            raise SimulationError(f"options[{name!r}] is neither one seed nor {self.num_envs}.")
        return value[index]

    def _show(self) -> None:
        """Record the state for trails, and draw it if the mode is "human"."""
        for renderer in self._renderers:
            renderer.observe()
            if self.render_mode == "human":
                renderer.render("human")


def _autoreset(mode: AutoresetMode | str) -> AutoresetMode:
    try:
        return AutoresetMode(mode)
    except ValueError as error:
        names = ", ".join(known.value for known in AutoresetMode)
        raise ConfigError(f"unknown autoreset mode {mode!r}; choose from {names}.") from error


def _by_type(team: TeamSpec, rows: Float32) -> Observations:
    """Return views [E, n_v, o_v] of rows [E, O]."""
    return {group.name: view for group, view in zip(team.groups, team.split_observations(rows), strict=True)}


def _read_only(array: NDArray[Any]) -> NDArray[Any]:
    view = array.view()
    view.setflags(write=False)
    return view


def _objects(mask: Mask, value: Any) -> NDArray[np.object_]:
    """Return an array that holds value(e) where the mask is true, and None elsewhere."""
    objects: NDArray[np.object_] = np.full(len(mask), None, dtype=object)
    for index in np.flatnonzero(mask).tolist():
        objects[index] = value(index)
    return objects
