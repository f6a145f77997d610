"""JaxMARL environments as one compiled batch: `--env jaxmarl:MPE_simple_spread_v3` (Rutherford et al. 2024)."""

import os
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from eia_sec.common.errors import ConfigError
from eia_sec.rollout.envs.vectorised import ByAgent, Vectorised


class JaxMarlEnvironment(Vectorised):
    """A JaxMARL environment, mapped over the batch and compiled once.

    Each environment has random numbers of its own, from its episode's seed. JaxMARL does not tell time limits from
    terminal states, and MPE's environments end a step late. So an episode is truncated after `max_steps`, where an
    environment has them.

    Args:
        environments: E.
        threads: threads of the compiled code.
        name: as `jaxmarl.make` takes it.
        arguments: likewise; `action_type="Continuous"` asks MPE's for boxes.
    """

    def __init__(self, environments: int, threads: int, name: str, **arguments: Any) -> None:
        _limit_threads(threads)
        import jax  # noqa: PLC0415  (reads the number of threads once, when its first array is made)
        import jaxmarl  # noqa: PLC0415  (likewise)

        if name not in jaxmarl.registered_envs:
            raise ConfigError(f"JaxMARL has no environment {name!r}; it has {', '.join(jaxmarl.registered_envs)}.")
        env = jaxmarl.make(name, **arguments)
        self.possible_agents = list(env.agents)
        self._spaces = {
            agent: (_space(env.observation_space(agent)), _space(env.action_space(agent))) for agent in env.agents
        }
        self._most = int(getattr(env, "max_steps", 0))
        self._time = np.zeros(environments, np.int64)
        agents = self.possible_agents

        def begin(seed: Any) -> Any:
            key, first = jax.random.split(jax.random.PRNGKey(seed))
            seen, state = env.reset(first)
            return key, state, {agent: seen[agent] for agent in agents}

        def step(key: Any, state: Any, actions: Any) -> Any:
            key, now = jax.random.split(key)
            seen, state, rewards, dones, _ = env.step_env(now, state, actions)
            rewards = {agent: rewards[agent] for agent in agents}
            return (key, state, {agent: seen[agent] for agent in agents}), rewards, dones["__all__"]

        def put(batch: Any, index: Any, one: Any) -> Any:
            return jax.tree.map(lambda whole, part: whole.at[index].set(part), batch, one)

        self._begin, self._put, self._step = jax.jit(begin), jax.jit(put), jax.jit(jax.vmap(step))
        self._batch = jax.tree.map(lambda part: np.stack([part] * environments), self._begin(0))

    def observation_space(self, agent: Any) -> spaces.Space[Any]:
        """Return an agent's observation space."""
        return self._spaces[agent][0]

    def action_space(self, agent: Any) -> spaces.Space[Any]:
        """Return an agent's action space."""
        return self._spaces[agent][1]

    def reset(self, index: int, seed: int) -> None:
        """Begin an episode in one environment."""
        self._batch = self._put(self._batch, index, self._begin(seed))
        self._time[index] = 0

    def observe(self) -> ByAgent:
        """Return what the agents see now, [E, ...] each."""
        return {agent: np.asarray(seen) for agent, seen in self._batch[2].items()}

    def step(self, actions: ByAgent) -> tuple[ByAgent, NDArray[np.bool_], NDArray[np.bool_]]:
        """Step all environments; see `Vectorised.step`."""
        key, state, _ = self._batch
        self._batch, rewards, done = self._step(key, state, dict(actions))
        self._time += 1
        late = self._time >= self._most if self._most else np.zeros(len(self._time), np.bool_)
        return {agent: np.asarray(reward) for agent, reward in rewards.items()}, np.asarray(done) & ~late, late


def _limit_threads(threads: int) -> None:
    """Say how many threads JAX may use, before it is imported; XLA takes the size of its pool from NPROC."""
    os.environ["NPROC"] = str(threads)
    os.environ.setdefault("JAX_PLATFORMS", "cpu")


def _space(space: Any) -> spaces.Space[Any]:
    """Return one of JaxMARL's spaces as one of Gymnasium's; what has no counterpart here is refused by the batch."""
    kind = type(space).__name__
    if kind == "Box":
        low, high = (np.broadcast_to(np.asarray(end, np.float32), space.shape) for end in (space.low, space.high))
        return spaces.Box(low, high, space.shape, np.float32)
    if kind == "MultiDiscrete":
        return spaces.MultiDiscrete(np.asarray(space.num_categories))
    return spaces.Discrete(int(space.n)) if kind == "Discrete" else spaces.Text(1)
