"""AgileRL: when its MADDPG flies the farm well enough. Runs in the environment of requirements/agilerl.txt.

Several farms step side by side in this process and its actors decide for all of them at once, which is quicker for
AgileRL than its own vector of processes on two cores. Agents are renamed, because AgileRL treats those whose names
differ in a number after "_" only as one group.
"""

import argparse
import random
from typing import Any

import numpy as np
import torch
from agilerl.algorithms import MADDPG
from agilerl.components.data import MultiAgentTransition
from agilerl.components.replay_buffer import ReplayBuffer
from tensordict import TensorDict

from benchmarks.peers.clock import hand_over
from benchmarks.peers.flights import Course, SteeredFarm, farm_options
from common.team import Float32
from rollout.sim.batch import FarmBatch

Values = dict[str, np.ndarray]


def make(options: argparse.Namespace, env: SteeredFarm) -> Any:
    """Return the algorithm; everything that is not named here are AgileRL's defaults."""
    layer = {"hidden_size": [options.width], "layer_norm": False}
    return MADDPG(
        [env.observation_space(name) for name in env.possible_agents],
        [env.action_space(name) for name in env.possible_agents],
        agent_ids=[inner(name) for name in env.possible_agents],
        net_config={"encoder_config": layer, "head_config": dict(layer), "latent_dim": options.width},
        batch_size=options.batch,
        lr_actor=options.actor_rate,
        lr_critic=options.critic_rate,
        gamma=options.discount,
        tau=options.target_rate,
        O_U_noise=False,
        expl_noise=options.noise,
        vect_noise_dim=options.environments,
    )


def inner(name: str) -> str:
    """Return a name without an underscore before the number."""
    return name.replace("_", "")


def stacked(each: list[dict[str, Any]]) -> Values:
    """Return the values of all farms under AgileRL's names, [farms, ...] float32."""
    return {inner(name): np.stack([np.asarray(values[name], np.float32) for values in each]) for name in each[0]}


class Learnt:
    """AgileRL's actors without noise, as `rollout.evaluation` flies a policy."""

    def __init__(self, agent: Any, names: list[str]) -> None:
        self._agent, self._names = agent, names

    def reset(self, world: FarmBatch, index: int) -> None:
        """Nothing to begin."""

    def act(self, world: FarmBatch) -> Float32:
        """Return everybody's actions [farms, A]."""
        parts = [
            agent for group in world.team.split_observations(world.observation) for agent in np.moveaxis(group, -2, 0)
        ]
        self._agent.set_training_mode(False)
        actions, _ = self._agent.get_action(obs=dict(zip(self._names, map(np.ascontiguousarray, parts), strict=True)))
        self._agent.set_training_mode(True)
        row = np.concatenate([np.asarray(actions[name], np.float32) for name in self._names], axis=-1)
        return world.team.adapt(world.observation, np.clip(row, -1.0, 1.0))


def remember(memory: ReplayBuffer, seen: Values, actions: Values, rewards: Values, then: Values) -> None:
    """Put one step of all farms into the replay; the farm's episodes are cut off and never end by themselves."""
    row = MultiAgentTransition(
        obs={name: torch.as_tensor(value) for name, value in seen.items()},
        action={name: torch.as_tensor(value) for name, value in actions.items()},
        reward={name: torch.as_tensor(value)[:, None] for name, value in rewards.items()},
        next_obs={name: torch.as_tensor(value) for name, value in then.items()},
        done={name: torch.zeros(len(value), 1) for name, value in rewards.items()},
    )
    count = len(next(iter(rewards.values())))
    memory.add(TensorDict(row.to_dict(), batch_size=[count]))


def train(options: argparse.Namespace, envs: list[SteeredFarm], agent: Any) -> Course:
    """Train until what is wanted is reached or the time is up."""
    names = envs[0].possible_agents
    memory, course, learnt = ReplayBuffer(options.capacity), Course(options), Learnt(agent, [inner(n) for n in names])
    seen = stacked([env.reset(seed=options.seed * len(envs) + k)[0] for k, env in enumerate(envs)])
    steps, updates = 0, 0
    while not course.over(learnt, steps, updates):
        actions = {name: np.asarray(value, np.float32) for name, value in agent.get_action(obs=seen)[0].items()}
        if steps < options.warmup:
            actions = {n: np.random.uniform(-1.0, 1.0, v.shape).astype(np.float32) for n, v in actions.items()}
        done = [env.step({n: actions[inner(n)][k] for n in names}) for k, env in enumerate(envs)]
        then = stacked([step[0] for step in done])
        remember(memory, seen, actions, stacked([step[1] for step in done]), then)
        again = [env.reset()[0] if not env.agents else step[0] for env, step in zip(envs, done, strict=True)]
        seen = stacked(again)
        steps += len(envs)
        while steps > options.warmup and updates < (steps - options.warmup) * options.updates_per_step:
            agent.learn(memory.sample(options.batch))
            updates += 1
    return course


def main() -> None:
    """Train and print."""
    options = farm_options("AgileRL").parse_args()
    torch.set_num_threads(options.threads)
    torch.manual_seed(options.seed)
    np.random.seed(options.seed)
    random.seed(options.seed)
    envs = [SteeredFarm(options.reward_scale) for _ in range(options.environments)]
    agent = make(options, envs[0])
    agent.set_training_mode(True)
    hand_over([train(options, envs, agent).result()], "agilerl", "torch")


if __name__ == "__main__":
    main()
