"""The policy that a run's actors begin as (`algorithm.start_policy`), in place of fresh ones."""

from pathlib import Path

import numpy as np

from common.actors import TeamActors, actor_outputs, can_fly, parameter_count
from common.config import OnPolicyConfig, RunConfig
from common.errors import PolicyError
from common.policy_file import load_policy
from common.team import Float32, GroupSpec, TeamSpec
from rollout.policies import SHIPPED, shipped_file

StartParameters = tuple[Float32 | None, ...]
"""For each type the parameters that its actors begin with, [n_v or 1, P_v], or None where they begin fresh."""


def start_parameters(config: RunConfig, team: TeamSpec) -> StartParameters:
    """Return what the actors of each type begin with.

    A type begins as the policy's if it sees, chooses and computes the same: observations, actions, width and memory.

    Raises:
        PolicyError: there is no such policy, its file cannot be used, or it fits no type.
    """
    name = config.on_policy.start_policy if config.learns_on_policy else ""
    if not name:
        return (None,) * len(team.groups)
    if name not in SHIPPED and not Path(name).is_file():
        raise PolicyError(f"algorithm.start_policy {name!r} is neither a policy that ships nor a policy file.")
    actors, _ = load_policy(shipped_file(name) if name in SHIPPED else Path(name))
    found = tuple(_begun(config.on_policy, group, actors) for group in team.groups)
    if all(flat is None for flat in found):
        raise PolicyError(
            f"algorithm.start_policy {name!r} fits no type of this run: observations, actions or networks differ."
        )
    return found


def _begun(config: OnPolicyConfig, group: GroupSpec, actors: TeamActors) -> Float32 | None:
    """Return what a type begins with; None if the policy has nothing that fits."""
    if (actors.hidden, actors.memory) != (config.hidden, config.memory):
        return None
    rows = 1 if config.parameters == "shared" else group.count
    numbers = parameter_count(group.observation_size, config.hidden, actor_outputs(group, "gaussian"), config.memory)
    for other, flat in zip(actors.team.groups, actors.flat, strict=True):
        if flat.shape in ((rows, numbers), (1, numbers)) and can_fly(other, group, flat):
            return np.broadcast_to(flat, (rows, numbers)).copy()
    return None
