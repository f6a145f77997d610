"""AgileRL: what MADDPG and MATD3 reach on simple_spread. Runs in the environment of requirements/agilerl.txt.

One environment, one update every few steps, AgileRL's own replay and networks. Agents are
renamed, because AgileRL treats those whose names differ in a number after "_" only as one group.
"""

import argparse
import random
import time
from typing import Any

import numpy as np
import torch
from agilerl.algorithms import MADDPG, MATD3
from agilerl.components.data import MultiAgentTransition
from agilerl.components.replay_buffer import ReplayBuffer
from mpe2 import simple_spread_v3
from tensordict import TensorDict

from research.benchmarks.peers.clock import hand_over
from research.benchmarks.peers.spread import EPISODE_STEPS, curve, spread_options

ALGORITHMS = {"maddpg": MADDPG, "matd3": MATD3}
Values = dict[str, np.ndarray]


def make(options: argparse.Namespace, env: Any) -> Any:
    """Return the algorithm; everything that is not named here are AgileRL's defaults."""
    layer = {"hidden_size": [options.width], "layer_norm": False}
    return ALGORITHMS[options.algorithm](
        [env.observation_space(name) for name in env.possible_agents],
        [env.action_space(name) for name in env.possible_agents],
        agent_ids=renamed(env.possible_agents),
        net_config={"encoder_config": layer, "head_config": dict(layer), "latent_dim": options.width},
        batch_size=options.batch,
        lr_actor=options.rate,
        lr_critic=options.rate,
        gamma=options.discount,
        tau=options.target_rate,
        learn_step=options.every,
        O_U_noise=False,
        expl_noise=options.noise,
    )


def renamed(names: list[str]) -> list[str]:
    """Return names without an underscore before the number."""
    return [name.replace("_", "") for name in names]


def inner(values: dict[str, Any]) -> Values:
    """Return values under AgileRL's names, as float32."""
    return {name.replace("_", ""): np.asarray(value, np.float32) for name, value in values.items()}


def act(agent: Any, env: Any, seen: dict[str, Any], training: bool) -> tuple[dict[str, Any], Values]:
    """Return the actions for the environment, and those that go to the replay."""
    agent.set_training_mode(training)
    actions, raw = agent.get_action(obs={name: value[None] for name, value in inner(seen).items()})
    for_env = {
        name: np.clip(np.asarray(actions[name.replace("_", "")], np.float32).reshape(-1), 0.0, 1.0)
        for name in env.agents
    }
    return for_env, {name: np.asarray(value, np.float32).reshape(-1) for name, value in raw.items()}


def remember(memory: ReplayBuffer, seen: Values, raw: Values, rewards: Values, then: Values, done: Values) -> None:
    """Put one step into the replay."""
    row = MultiAgentTransition(
        obs={name: torch.as_tensor(value)[None] for name, value in seen.items()},
        action={name: torch.as_tensor(value)[None] for name, value in raw.items()},
        reward={name: torch.as_tensor(value).reshape(1, 1) for name, value in rewards.items()},
        next_obs={name: torch.as_tensor(value)[None] for name, value in then.items()},
        done={name: torch.as_tensor(value).reshape(1, 1) for name, value in done.items()},
    )
    memory.add(TensorDict(row.to_dict(), batch_size=[1]))


def train(options: argparse.Namespace, env: Any, agent: Any) -> list[float]:
    """Train; return the reward of each episode, mean over agents."""
    memory = ReplayBuffer(options.capacity)
    rewards_of, seen, total = [], env.reset(seed=options.seed)[0], 0.0
    for step in range(1, options.steps + 1):
        actions, raw = act(agent, env, seen, training=True)
        if step <= options.warmup:
            raw = {name: np.random.uniform(-1.0, 1.0, value.shape).astype(np.float32) for name, value in raw.items()}
            actions = {name: (raw[name.replace("_", "")] + 1.0) / 2.0 for name in actions}
        then, rewards, terminated, _, _ = env.step(actions)
        remember(memory, inner(seen), raw, inner(rewards), inner(then), inner(terminated))
        total += float(np.mean(list(rewards.values())))
        seen = then
        if not env.agents:
            rewards_of.append(total)
            seen, total = env.reset()[0], 0.0
        if step > options.warmup and step % options.every == 0:
            agent.set_training_mode(True)
            agent.learn(memory.sample(options.batch))
    return rewards_of


def evaluate(options: argparse.Namespace, env: Any, agent: Any) -> float:
    """Return the reward of an episode without noise, mean over agents and scenarios."""
    totals = []
    for seed in options.scenarios:
        seen, total = env.reset(seed=seed)[0], 0.0
        while env.agents:
            seen, rewards, *_ = env.step(act(agent, env, seen, training=False)[0])
            total += float(np.mean(list(rewards.values())))
        totals.append(total)
    return float(np.mean(totals))


def main() -> None:
    """Train, evaluate and print."""
    options = spread_options("AgileRL", tuple(ALGORITHMS)).parse_args()
    torch.set_num_threads(1)
    torch.manual_seed(options.seed)
    np.random.seed(options.seed)
    random.seed(options.seed)
    env = simple_spread_v3.parallel_env(continuous_actions=True, max_cycles=EPISODE_STEPS)
    env.reset(seed=options.seed)
    agent = make(options, env)
    started = time.perf_counter()
    episodes = train(options, env, agent)
    seconds = time.perf_counter() - started
    hand_over(
        [{"reward": evaluate(options, env, agent), "seconds": seconds, "curve": curve(episodes)}],
        "agilerl",
        "torch",
        "mpe2",
    )


if __name__ == "__main__":
    main()
