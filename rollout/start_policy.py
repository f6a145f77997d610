"""The policy that a run's actors begin as (`algorithm.start_policy`), in place of fresh ones."""

from pathlib import Path
from typing import Final

import numpy as np

from common.actors import TeamActors, actor_outputs, can_fly, parameter_count
from common.config import OnPolicyConfig, RunConfig
from common.config.presets import preset, read_saved
from common.errors import ConfigError, PolicyError
from common.farm import farm_environment, farm_of
from common.policy_file import load_policy
from common.team import Float32, GroupSpec, TeamSpec
from rollout.policies import SHIPPED, policy_path, preset_of

StartParameters = tuple[Float32 | None, ...]
"""For each type the parameters that its actors begin with, [n_v or 1, P_v], or None where they begin fresh."""
Names = dict[str, tuple[str, ...]]
"""The names of each type's observations."""
CONFIG: Final = "config.toml"
"""File in a run directory, beside its policy, that says what the policy observes."""


def start_parameters(config: RunConfig, team: TeamSpec) -> StartParameters:
    """Return what the actors of each type begin with; nothing at all if all begin fresh.

    A type begins as the policy's if it has as many inputs, the same actions, width and memory, and observes the same.
    What policies that ship observe is known, and that of one in a run directory; of other files it is not.

    Raises:
        PolicyError: there is no such policy, its file cannot be used, or it fits no type.
    """
    name = config.on_policy.start_policy if config.learns_on_policy else ""
    if not name:
        return ()
    actors, _ = load_policy(_file(name))
    own, other = _observed(config), _observed(_origin(name))
    differing = {kind for kind in own.keys() & other.keys() if own[kind] != other[kind]}
    found = tuple(None if group.name in differing else _begun(config.on_policy, group, actors) for group in team.groups)
    if all(flat is None for flat in found):
        raise PolicyError(
            f"algorithm.start_policy {name!r} fits no type of this run: observations, actions or networks differ. "
            'Leave it empty ("") to begin with fresh actors.'
        )
    return found


def start_sentence(config: RunConfig, team: TeamSpec, start: StartParameters) -> str:
    """Return which types begin as the policy and which begin fresh, for people."""
    pairs = list(zip(team.groups, start, strict=True))
    begun, fresh = ([group.name for group, flat in pairs if (flat is None) is new] for new in (False, True))
    rest = f"; fresh actors: {', '.join(fresh)}" if fresh else ""
    return f"begins as {config.on_policy.start_policy}: {', '.join(begun)}{rest}"


def _file(name: str) -> Path:
    path = policy_path(name)
    try:
        is_file = path.is_file()
    except OSError:  # a name that is too long, or a folder that cannot be searched
        is_file = False
    if not is_file:
        raise PolicyError(f"algorithm.start_policy {name!r} is neither a policy that ships nor a readable file.")
    return path


def _origin(name: str) -> RunConfig | None:
    """Return the configuration under which a policy was trained; None if that is not known."""
    if name in SHIPPED:
        return preset(preset_of(name))
    try:
        return read_saved(Path(name).parent / CONFIG)
    except (ConfigError, OSError):
        return None


def _observed(config: RunConfig | None) -> Names:
    """Return what the types of a farm observe; nothing if that is not known, as in other environments."""
    farm = None if config is None else farm_of(config)
    names = {} if farm is None else farm_environment(farm).tensor_names
    return {kind: tuple(tensors.observation) for kind, tensors in names.items()}


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
