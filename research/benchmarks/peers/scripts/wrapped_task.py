"""A PettingZoo environment as BenchMARL's task, for the scripts that run with what requirements/benchmarl.txt says."""

from collections.abc import Callable
from typing import Any

from torchrl.envs import EnvBase

from research.benchmarks.peers.scripts.plain_task import PlainTask


class WrappedTask(PlainTask):
    """An environment in TorchRL's wrapper, whose agents are grouped by their names and see observations alone.

    Args:
        name: the task's name.
        make: returns the wrapped environment for a seed.
        steps: length of an episode.
        discrete: whether its actions are discrete.
    """

    def __init__(self, name: str, make: Callable[[int | None], EnvBase], steps: int, *, discrete: bool = False) -> None:
        super().__init__(name, {})
        self._make, self._steps, self._discrete = make, steps, discrete

    def supports_continuous_actions(self) -> bool:
        """Return whether actions are continuous."""
        return not self._discrete

    def supports_discrete_actions(self) -> bool:
        """Return whether actions are discrete."""
        return self._discrete

    def get_env_fun(self, num_envs: int, continuous_actions: bool, seed: int | None, device: Any) -> Callable[[], Any]:
        """Return a function that makes the environment."""
        return lambda: self._make(seed)

    def max_steps(self, env: EnvBase) -> int:
        """Return the length of an episode."""
        return self._steps

    def group_map(self, env: EnvBase) -> dict[str, list[str]]:
        """Return the names of the agents of each group."""
        return dict(env.group_map)

    def observation_spec(self, env: EnvBase) -> Any:
        """Return what the agents see, and nothing else."""
        spec = env.observation_spec.clone()
        for group in self.group_map(env):
            for key in [key for key in spec[group].keys() if key != "observation"]:  # noqa: SIM118 - specs need keys()
                del spec[group, key]
        for key in [key for key in spec.keys() if key not in self.group_map(env)]:  # noqa: SIM118 - specs need keys()
            del spec[key]
        return spec

    def state_spec(self, env: EnvBase) -> None:
        """Return nothing: critics see all observations."""
        return

    def action_spec(self, env: EnvBase) -> Any:
        """Return the agents' actions."""
        return env.full_action_spec

    @staticmethod
    def env_name() -> str:
        """Return the name in BenchMARL's output."""
        return "pettingzoo"
