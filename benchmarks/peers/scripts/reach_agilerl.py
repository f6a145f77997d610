"""AgileRL: when its IPPO flies the farm well enough. Runs in the environment of requirements/agilerl.txt.

Several farms step side by side in this process and its actors decide for all of them at once, which is quicker for
AgileRL than its own vector of processes on two cores. AgileRL groups agents whose names differ in a number after "_"
only, so the UAVs of a type share an actor and a critic.
"""

import argparse
import random
from collections import defaultdict
from typing import Any

import numpy as np
import torch
from agilerl.algorithms import IPPO

from benchmarks.peers.clock import hand_over
from benchmarks.peers.flights import Course, FarmOfChoices, farm_options
from common.team import Float32
from rollout.sim.batch import FarmBatch

Values = dict[str, np.ndarray]
FIELDS = ("states", "actions", "log_probs", "rewards", "dones", "values")


def make(options: argparse.Namespace, env: FarmOfChoices) -> Any:
    """Return the algorithm; everything that is not named here are AgileRL's defaults.

    Its minibatches count the samples of all agents of a group.
    """
    layer = {"hidden_size": [options.width], "layer_norm": False}
    agents = len(env.possible_agents) // len(env.batch.team.groups)
    return IPPO(
        [env.observation_space(name) for name in env.possible_agents],
        [env.action_space(name) for name in env.possible_agents],
        agent_ids=list(env.possible_agents),
        net_config={"encoder_config": layer, "head_config": dict(layer), "latent_dim": options.width},
        batch_size=options.minibatch * agents,
        lr=options.rate,
        learn_step=options.iteration,
        gamma=options.discount,
        gae_lambda=options.gae_lambda,
        clip_coef=options.clip,
        ent_coef=options.entropy,
        max_grad_norm=options.gradient_clip,
        update_epochs=options.epochs,
    )


def stacked(each: list[dict[str, Any]]) -> Values:
    """Return the values of all farms, [farms, ...] float32."""
    return {name: np.stack([np.asarray(values[name], np.float32) for values in each]) for name in each[0]}


class Learnt:
    """AgileRL's actors, as `rollout.evaluation` flies a policy: each takes its likeliest option."""

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
    names = envs[0].possible_agents
    kept: dict[str, dict[str, list[Any]]] = {field: defaultdict(list) for field in FIELDS}
    done = {name: np.zeros(len(envs)) for name in names}
    for _ in range(steps):
        action, log_prob, _, value = agent.get_action(obs=seen)
        after = [env.step({name: action[name][k] for name in names}) for k, env in enumerate(envs)]
        rewards = stacked([step[1] for step in after])
        for name in names:
            row = seen[name], action[name], log_prob[name], rewards[name], done[name], value[name]
            for field, number in zip(FIELDS, row, strict=True):
                kept[field][name].append(number)
        ended = np.array([float(not env.agents) for env in envs])
        done = {name: ended for name in names}
        seen = stacked([step[0] if env.agents else env.reset()[0] for env, step in zip(envs, after, strict=True)])
    return (*(dict(kept[field]) for field in FIELDS), seen, done), seen


def train(options: argparse.Namespace, envs: list[FarmOfChoices], agent: Any) -> Course:
    """Train until what is wanted is reached or the time is up."""
    course, learnt = Course(options), Learnt(agent)
    seen = stacked([env.reset(seed=options.seed * len(envs) + k)[0] for k, env in enumerate(envs)])
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
