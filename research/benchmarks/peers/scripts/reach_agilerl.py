"""AgileRL: when its IPPO flies the farm well enough. Runs in the environment of requirements/agilerl.txt.

Several farms step side by side in this process and its actors decide for all of them at once, which is quicker for
AgileRL than its own vector of processes on two cores. AgileRL sees each type as one agent in as many environments as
there are UAVs of it. Given the UAVs as a group of agents, AgileRL 2.58 learns from observations of one and rewards of
another (research/LOG.md).
"""

import argparse
import random
from collections import defaultdict
from typing import Any

import numpy as np
import torch
from agilerl.algorithms import IPPO

from eia_sec.common.team import Float32
from eia_sec.rollout.sim.batch import FarmBatch
from research.benchmarks.peers.clock import hand_over
from research.benchmarks.peers.flights import Course, FarmOfChoices, farm_options

Values = dict[str, np.ndarray]
FIELDS = ("states", "actions", "log_probs", "rewards", "dones", "values")


def make(options: argparse.Namespace, env: FarmOfChoices) -> Any:
    """Return the algorithm; everything that is not named here are AgileRL's defaults.

    Its minibatches count the samples of all UAVs of a type.
    """
    layer = {"hidden_size": [options.width], "layer_norm": False}
    groups = env.batch.team.groups
    firsts = [f"{group.name}_0" for group in groups]
    return IPPO(
        [env.observation_space(name) for name in firsts],
        [env.action_space(name) for name in firsts],
        agent_ids=[group.name for group in groups],
        net_config={"encoder_config": layer, "head_config": dict(layer), "latent_dim": options.width},
        batch_size=options.minibatch * groups[0].count,
        lr=options.rate,
        learn_step=options.iteration,
        gamma=options.discount,
        gae_lambda=options.gae_lambda,
        clip_coef=options.clip,
        ent_coef=options.entropy,
        max_grad_norm=options.gradient_clip,
        update_epochs=options.epochs,
    )


def by_type(each: list[dict[str, Any]], env: FarmOfChoices) -> Values:
    """Return what the agents of each type have in all farms, [farms * n_v, ...] float32."""
    return {
        group.name: np.stack([np.asarray(values[name], np.float32) for values in each for name in names])
        for group, names in zip(env.batch.team.groups, names_by_type(env), strict=True)
    }


def by_agent(values: Values, env: FarmOfChoices, farms: int) -> list[dict[str, Any]]:
    """Return the values of each farm's agents by their names: `by_type` undone."""
    rows = {group.name: values[group.name].reshape(farms, group.count) for group in env.batch.team.groups}
    named = list(zip(env.batch.team.groups, names_by_type(env), strict=True))
    return [
        {name: rows[group.name][farm, k] for group, names in named for k, name in enumerate(names)}
        for farm in range(farms)
    ]


def names_by_type(env: FarmOfChoices) -> list[tuple[str, ...]]:
    """Return the names of each type's agents."""
    return [env.batch.team.agent_names[part] for part in env.batch.team.agent_slices()]


class Learnt:
    """AgileRL's actors, as `eia_sec.rollout.evaluation` flies a policy: each takes its likeliest option."""

    def __init__(self, agent: Any) -> None:
        self._agent = agent

    def reset(self, world: FarmBatch, index: int) -> None:
        """Nothing to begin."""

    @torch.no_grad()
    def act(self, world: FarmBatch) -> Float32:
        """Return everybody's actions [farms, A]."""
        team = world.team
        count, parts = len(world.observation), []
        for group, own in zip(team.groups, team.split_observations(world.observation), strict=True):
            actor = self._agent.actors[group.name]
            actor(torch.from_numpy(np.ascontiguousarray(own.reshape(-1, group.observation_size))))
            logits = actor.head_net.dist.logits
            parts.append(logits.argmax(dim=-1).reshape(count, -1).numpy())
        return team.adapt(world.observation, np.concatenate(parts, axis=1).astype(np.float32))


def collect(agent: Any, envs: list[FarmOfChoices], seen: Values, steps: int) -> tuple[tuple[Any, ...], Values]:
    """Return the experience of so many steps of every farm, and what is observed after it."""
    first = envs[0]
    kept: dict[str, dict[str, list[Any]]] = {field: defaultdict(list) for field in FIELDS}
    done = {name: np.zeros(len(values)) for name, values in seen.items()}
    for _ in range(steps):
        action, log_prob, _, value = agent.get_action(obs=seen)
        chosen = by_agent(action, first, len(envs))
        after = [env.step(choice) for env, choice in zip(envs, chosen, strict=True)]
        rewards = by_type([step[1] for step in after], first)
        for name in seen:
            row = seen[name], action[name], log_prob[name], rewards[name], done[name], value[name]
            for field, number in zip(FIELDS, row, strict=True):
                kept[field][name].append(number)
        ended = np.array([float(not env.agents) for env in envs])
        done = {group.name: np.repeat(ended, group.count) for group in first.batch.team.groups}
        each = [step[0] if env.agents else env.reset()[0] for env, step in zip(envs, after, strict=True)]
        seen = by_type(each, first)
    return (*(dict(kept[field]) for field in FIELDS), seen, done), seen


def train(options: argparse.Namespace, envs: list[FarmOfChoices], agent: Any) -> Course:
    """Train until what is wanted is reached or the time is up."""
    course, learnt = Course(options), Learnt(agent)
    seen = by_type([env.reset(seed=options.seed * len(envs) + k)[0] for k, env in enumerate(envs)], envs[0])
    each = options.iteration // options.environments
    steps = updates = 0
    while not course.over(learnt, steps, updates):
        experience, seen = collect(agent, envs, seen, each)
        agent.learn(experience)
        steps += options.iteration
        updates += options.epochs * options.iteration // options.minibatch
    return course


def main() -> None:
    """Train and print."""
    options = farm_options("AgileRL").parse_args()
    torch.set_num_threads(options.threads)
    torch.manual_seed(options.seed)
    np.random.seed(options.seed)
    random.seed(options.seed)
    envs = [FarmOfChoices(options.reward_scale) for _ in range(options.environments)]
    agent = make(options, envs[0])
    agent.set_training_mode(True)
    hand_over([train(options, envs, agent).result()], "agilerl", "torch")


if __name__ == "__main__":
    main()
