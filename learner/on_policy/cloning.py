"""Behaviour cloning: actors that do what demonstrations did, before a run's first step.

    L = -mean(log pi(a | o)) - w_H mean(H(pi(. | o)))          w_H is `entropy_start`

over the rows of all demonstrations, for some epochs. The deviation of a continuous action counts as at least
LEAST_DEVIATION, and the square of what its logarithm lacks is added: else actors that are sure of what they saw would
explore nothing afterwards.
"""

import math
from typing import Any, Final

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from eia_sec.common.actors import TeamActors
from eia_sec.common.config import RunConfig
from eia_sec.common.errors import ConfigError
from eia_sec.common.seeds import stream
from eia_sec.common.team import Float32, TeamSpec
from eia_sec.learner.networks.adam import Adam
from eia_sec.learner.on_policy.distributions import evaluate
from eia_sec.learner.on_policy.experience import split, split_actions
from eia_sec.learner.on_policy.normalisation import Scales
from eia_sec.learner.on_policy.policies import Policies
from eia_sec.learner.on_policy.updates import ADAM_EPSILON

EPOCHS: Final = 20
"""Passes over the demonstrations."""
MINIBATCH: Final = 256
"""Steps of all agents in a minibatch."""
UPDATES: Final = 3000
"""Fewest updates, in more epochs where demonstrations are few."""
LEAST_DEVIATION: Final = 0.3
"""Least standard deviation of a continuous action before its tanh."""


def cloned(config: RunConfig, team: TeamSpec, observation: NDArray[Any], action: Float32) -> tuple[TeamActors, float]:
    """Return actors that do what demonstrations did.

    Args:
        config: the run that they begin.
        team: the layout of the team.
        observation: [R, O].
        action: [R, A].

    Returns:
        the actors, and the mean probability, per agent, that they give the actions; of continuous actions the density.

    Raises:
        ConfigError: the actors have memory, which rows without order cannot teach.
    """
    algorithm = config.on_policy
    if algorithm.memory != "none":
        raise ConfigError("demonstrations are cloned by actors without memory; leave algorithm.memory at none.")
    policies, scales = Policies(algorithm, team, config.seed), Scales(team, "cpu")
    seen, done = torch.from_numpy(np.array(observation)), torch.from_numpy(np.array(action))
    if algorithm.normalise_observations:
        for own, scale in zip(split(team, seen), scales.observations, strict=True):
            scale.add(own.flatten(0, 1))
        policies.scales = scales
    adam = Adam([(policies.parameters(), algorithm.actor_rate)], epsilon=ADAM_EPSILON)
    random, count = stream(config.seed, "cloning"), max(1, len(seen) // MINIBATCH)
    for _ in range(max(EPOCHS, math.ceil(UPDATES / count))):
        for rows in np.array_split(random.permutation(len(seen)), count):
            adam.zero_grad()
            places = torch.from_numpy(rows)
            _loss(policies, team, seen[places], done[places], algorithm.entropy_start)[0].backward()
            adam.step()
    with torch.no_grad():
        parts = zip(seen.split(MINIBATCH), done.split(MINIBATCH), strict=True)
        sure = [_loss(policies, team, *part, 0.0)[1] for part in parts]
    return policies.actors(), float(torch.cat(sure).mean())


def _loss(policies: Policies, team: TeamSpec, seen: Tensor, done: Tensor, weight: float) -> tuple[Tensor, Tensor]:
    """Return L of some rows, and the probabilities [R, agents] of their actions."""
    if policies.scales is not None and not team.in_bytes:
        shift, scale = policies.scales.of_team()
        seen = (seen - shift) / scale
    losses, sure = [], []
    parts = zip(team.groups, policies.stacks, split(team, seen), split_actions(team, done), strict=True)
    for group, stack, own, action in parts:
        outputs = stack(own)
        if not group.choices:
            mean, log_std = outputs.split(group.action_size, dim=-1)
            least = math.log(LEAST_DEVIATION)
            losses.append((least - log_std).clamp(min=0.0).square().mean())
            outputs = torch.cat([mean, log_std.clamp(min=least)], dim=-1)
        found = evaluate(group, own, outputs, action)
        losses.append(-found.log_probability.mean() - weight * found.entropy.mean())
        sure.append(found.log_probability.detach().exp())
    return torch.stack(losses).sum(), torch.cat(sure, dim=1)
