"""VMAS scenarios as one batch: `--env vmas:balance` (Bettini et al. 2022)."""

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
import torch
import vmas
from gymnasium import spaces
from numpy.typing import NDArray

from eia_sec.common.errors import ConfigError
from eia_sec.rollout.envs.vectorised import ByAgent, Vectorised

KNOWN = (*vmas.scenarios, *vmas.mpe_scenarios, *vmas.debug_scenarios)


class VmasScenario(Vectorised):
    """A VMAS scenario on the CPU.

    Scenarios set no limit; episodes have 100 steps unless env.steps says so. What a scenario draws at a reset follows
    from the episode's seed. Few scenarios draw in steps, too; those draws are shared by the batch.

    Args:
        environments: E.
        threads: threads of torch.
        name: the scenario's.
        arguments: of `vmas.make_env`, and of the scenario; `continuous_actions=False` asks for Discrete actions.
    """

    steps: ClassVar[int] = 100

    def __init__(self, environments: int, threads: int, name: str, **arguments: Any) -> None:
        if name not in KNOWN:
            raise ConfigError(f"VMAS has no scenario {name!r}; it has {', '.join(KNOWN)}.")
        torch.set_num_threads(threads)
        given = {"device": "cpu", "seed": 0, "clamp_actions": True, **arguments}
        self._vmas = vmas.make_env(name, environments, **given, dict_spaces=False, terminated_truncated=True)
        self.possible_agents = [agent.name for agent in self._vmas.agents]
        both = zip(self._vmas.observation_space, self._vmas.action_space, strict=True)
        found = [(_space(seen), _space(acts)) for seen, acts in both]
        self._spaces: dict[Any, tuple[spaces.Space[Any], spaces.Space[Any]]] = dict(
            zip(self.possible_agents, found, strict=True)
        )
        self._seen: list[torch.Tensor] | None = None
        self._numbers: dict[str, NDArray[Any]] = {}

    def observation_space(self, agent: Any) -> spaces.Space[Any]:
        """Return an agent's observation space."""
        return self._spaces[agent][0]

    def action_space(self, agent: Any) -> spaces.Space[Any]:
        """Return an agent's action space."""
        return self._spaces[agent][1]

    def reset(self, index: int, seed: int) -> None:
        """Begin an episode in one environment."""
        self._vmas.seed(seed)
        self._vmas.reset_at(index, return_observations=False)
        self._seen = None

    def observe(self) -> ByAgent:
        """Return what the agents see now, [E, o] each."""
        if self._seen is None:
            (self._seen,) = self._vmas.get_from_scenario(True, False, False, False)
        return dict(zip(self.possible_agents, (part.numpy() for part in self._seen), strict=True))

    def step(self, actions: ByAgent) -> tuple[ByAgent, NDArray[np.bool_], NDArray[np.bool_]]:
        """Step all environments; see `Vectorised.step`."""
        taken = [torch.from_numpy(np.ascontiguousarray(actions[name])) for name in self.possible_agents]
        self._seen, rewards, terminated, truncated, infos = self._vmas.step(taken)
        self._numbers = _means(infos)
        earned = dict(zip(self.possible_agents, (part.numpy() for part in rewards), strict=True))
        return earned, terminated.numpy(), truncated.numpy()

    def numbers(self) -> Mapping[str, NDArray[Any]]:
        """Return the means over agents of the single numbers in the last step's infos."""
        return self._numbers


def _space(space: Any) -> spaces.Space[Any]:
    """Return one of gym's spaces as one of Gymnasium's; what has no counterpart here is refused by the batch."""
    kind = type(space).__name__
    if kind == "Box":
        return spaces.Box(space.low, space.high, space.shape, space.dtype)
    if kind == "MultiDiscrete":
        return spaces.MultiDiscrete(space.nvec)
    return spaces.Discrete(int(space.n)) if kind == "Discrete" else spaces.Text(1)


def _means(infos: list[Mapping[str, Any]]) -> dict[str, NDArray[Any]]:
    found: dict[str, list[NDArray[Any]]] = {}
    for info in infos:
        for name, value in info.items():
            if isinstance(value, torch.Tensor) and value[:1].numel() == 1:
                found.setdefault(name, []).append(value.reshape(-1).numpy())
    return {name: np.mean(np.stack(values).astype(np.float64), axis=0) for name, values in found.items()}
