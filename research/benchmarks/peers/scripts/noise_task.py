"""A BenchMARL task that costs nothing: batched environments which answer every action with noise.

Only for `run_benchmarl`; it fills replay buffers through BenchMARL's own collection, in rows of the wanted sizes.
"""

from collections.abc import Callable
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.data import Bounded, Categorical, Composite, Unbounded
from torchrl.envs import EnvBase

from research.benchmarks.peers.scripts.plain_task import PlainTask

Groups = list[tuple[str, int, int, int]]


class NoiseEnv(EnvBase):
    """Environments whose observations and rewards are noise, and whose episodes never end.

    Args:
        groups: name, agents, observation size and action size of each group.
        environments: batch size.
        state: whether there is a global state: all observations in a row.
    """

    def __init__(self, groups: Groups, environments: int, state: bool) -> None:
        super().__init__(device="cpu", batch_size=[environments])
        self.groups, shape = groups, (environments,)
        seen = {
            name: Composite({"observation": Unbounded((*shape, count, size))}, shape=(*shape, count))
            for name, count, size, _ in groups
        }
        self.state_size = sum(count * size for _, count, size, _ in groups) if state else 0
        whole = {"state": Unbounded((*shape, self.state_size))} if state else {}
        self.observation_spec = Composite({**seen, **whole}, shape=shape)
        self.action_spec = Composite(
            {
                name: Composite({"action": Bounded(-1, 1, (*shape, count, size))}, shape=(*shape, count))
                for name, count, _, size in groups
            },
            shape=shape,
        )
        self.reward_spec = Composite(
            {
                name: Composite({"reward": Unbounded((*shape, count, 1))}, shape=(*shape, count))
                for name, count, _, _ in groups
            },
            shape=shape,
        )
        self.done_spec = Composite(
            {key: Categorical(2, (*shape, 1), dtype=torch.bool) for key in ("done", "terminated")}, shape=shape
        )

    def _reset(self, tensordict: TensorDictBase | None, **_: Any) -> TensorDictBase:
        return self._noise(rewarded=False)

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        return self._noise(rewarded=True)

    def _noise(self, rewarded: bool) -> TensorDict:
        batch = self.batch_size
        result = TensorDict({}, batch_size=batch)
        for name, count, size, _ in self.groups:
            values = {"observation": torch.rand(*batch, count, size) * 2 - 1}
            if rewarded:
                values["reward"] = torch.randn(*batch, count, 1)
            result[name] = TensorDict(values, batch_size=[*batch, count])
        if self.state_size:
            result["state"] = torch.cat([result[name, "observation"].flatten(1) for name, *_ in self.groups], dim=1)
        for key in ("done", "terminated"):
            result[key] = torch.zeros(*batch, 1, dtype=torch.bool)
        return result

    def _set_seed(self, seed: int | None) -> None:
        torch.manual_seed(seed or 0)


class NoiseTask(PlainTask):
    """The task; its configuration holds `groups` and `state`, see NoiseEnv."""

    def get_env_fun(self, num_envs: int, continuous_actions: bool, seed: int | None, device: Any) -> Callable[[], Any]:
        """Return a function that makes the environments."""
        groups, state = self.config["groups"], self.config["state"]
        return lambda: NoiseEnv(groups, num_envs, state)

    def max_steps(self, env: EnvBase) -> int:
        """Return the length of an evaluation, which never happens."""
        return 100

    def group_map(self, env: EnvBase) -> dict[str, list[str]]:
        """Return the names of the agents of each group."""
        return {name: [f"{name}_{i}" for i in range(count)] for name, count, _, _ in self.config["groups"]}

    def observation_spec(self, env: EnvBase) -> Composite:
        """Return the groups' observations."""
        spec = env.observation_spec_unbatched.clone()
        if "state" in spec.keys():  # noqa: SIM118 - a spec's `in` without keys() is not defined
            del spec["state"]
        return spec

    def state_spec(self, env: EnvBase) -> Composite | None:
        """Return the global state, if there is one."""
        return Composite({"state": env.observation_spec_unbatched["state"].clone()}) if self.config["state"] else None

    def action_spec(self, env: EnvBase) -> Composite:
        """Return the groups' actions."""
        return env.full_action_spec_unbatched

    @staticmethod
    def env_name() -> str:
        """Return the name in BenchMARL's output."""
        return "noise"
