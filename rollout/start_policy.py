"""The policy that a run's actors begin as (`algorithm.start_policy`), in place of fresh ones."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from eia_sec.common.actors import TeamActors, actor_outputs, acts_alike, can_fly, parameter_count
from eia_sec.common.config import OnPolicyConfig, RunConfig
from eia_sec.common.config.files import read_saved
from eia_sec.common.config.presets import preset
from eia_sec.common.errors import ConfigError, PolicyError
from eia_sec.common.farm import farm_environment, farm_of
from eia_sec.common.policy_file import load_policy
from eia_sec.common.team import Float32, GroupSpec, TeamSpec
from eia_sec.rollout.shipped_policies import SHIPPED, is_file, policy_path, preset_of

MISFIT: Final = (
    "Observations, actions or networks differ, or it is a policy of single agents, which begins only agents that are "
    "separate from the beginning (--algorithm.shared-until 0). Leave the option empty to begin with fresh actors, "
    "or name other types in it."
)
StartParameters = tuple[Float32 | None, ...]
"""For each type the parameters that its actors begin with, [n_v or 1, P_v], or None where they begin fresh."""
Names = Mapping[str, tuple[str, ...]]
"""The names of each type's observations."""
CONFIG: Final = "config.toml"
"""File in a run directory, beside its policy, that says what the policy observes."""
ALL: Final = "all"
"""Key of `algorithm.start_policy` that stands for every type which the policy fits."""


@dataclass(frozen=True)
class _Source:
    """A policy to begin as.

    Attributes:
        actors: its actors.
        observed: what they observe, as far as that is known.
    """

    actors: TeamActors
    observed: Names


def start_parameters(config: RunConfig, team: TeamSpec) -> StartParameters:
    """Return what the actors of each type begin with; nothing at all if all begin fresh.

    A type begins as the policy's if it has the same actions, width and memory, and observes the same. A type that the
    option names may observe more; the weights of inputs that the policy does not have are 0. What policies that ship
    observe is known, and that of one in a run directory; of other files only the number of inputs is compared.

    Raises:
        PolicyError: there is no such policy, its file cannot be used, or it fits no type, or not one that is named.
    """
    wanted = _wanted(config, team)
    sources = {name: _source(name) for name in set(wanted.values())}
    own, named = _observed(config), ALL not in _named(config)
    found: list[Float32 | None] = []
    for group in team.groups:
        source = sources.get(wanted.get(group.name, ""))
        names = own.get(group.name)
        flat = None if source is None else _begun(config.on_policy, group, names, source, more=named)
        if named and source is not None and flat is None:
            raise PolicyError(
                f"algorithm.start_policy: {group.name} agents of this run do not fit {wanted[group.name]!r}. {MISFIT}"
            )
        found.append(flat)
    if wanted and all(flat is None for flat in found):
        raise PolicyError(f"algorithm.start_policy {_named(config)[ALL]!r} fits no type of this run. {MISFIT}")
    return tuple(found) if wanted else ()


def start_sentence(config: RunConfig, team: TeamSpec, start: StartParameters) -> str:
    """Return which types begin as which policy and which begin fresh, for people."""
    wanted = _wanted(config, team)
    begun: dict[str, list[str]] = {}
    for group, flat in zip(team.groups, start, strict=True):
        begun.setdefault("" if flat is None else wanted[group.name], []).append(group.name)
    fresh = begun.pop("", [])
    parts = [f"begins as {name}: {', '.join(types)}" for name, types in begun.items()]
    return "; ".join([*parts, *([f"fresh actors: {', '.join(fresh)}"] if fresh else [])])


def _wanted(config: RunConfig, team: TeamSpec) -> dict[str, str]:
    """Return the name of the policy that each type is to begin as, of those that are not to begin fresh."""
    named = {kind: name for kind, name in _named(config).items() if name}
    types = team.types
    if set(named) == {ALL}:
        return dict.fromkeys(types, named[ALL])
    if unknown := [kind for kind in named if kind not in types]:
        raise PolicyError(
            f"algorithm.start_policy names {unknown[0]!r}, but the types are {', '.join(types)}; {ALL} stands alone."
        )
    return named


def _named(config: RunConfig) -> Mapping[str, str]:
    return config.on_policy.start_policy if config.learns_on_policy else {}


def _source(name: str) -> _Source:
    path = policy_path(name)
    if not is_file(path):
        raise PolicyError(f"algorithm.start_policy {name!r} is neither a policy that ships nor a readable file.")
    return _Source(load_policy(path)[0], _observed(_origin(name)))


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


def _begun(
    config: OnPolicyConfig, group: GroupSpec, names: tuple[str, ...] | None, source: _Source, *, more: bool
) -> Float32 | None:
    """Return what a type begins with; None if the policy has nothing that fits.

    Args:
        config: the run's algorithm.
        group: the type.
        names: of its observations, or None if they are not known.
        source: the policy.
        more: whether the type may observe more than the policy.
    """
    actors, rows = source.actors, 1 if config.shared else group.count
    outputs = actor_outputs(group, "gaussian")
    if actors.module != config.module or actors.memory != config.memory:
        return None
    if config.module is None and actors.hidden != config.hidden:
        return None
    for other, flat in zip(actors.team.groups, actors.flat, strict=True):
        if not acts_alike(other, group, flat) or len(flat) not in (1, rows):
            continue
        inputs = _inputs(names, source.observed.get(group.name), group.observation_size, other.observation_size)
        if inputs is None or not (more or len(inputs) == group.observation_size):
            continue
        if config.module is not None:
            if can_fly(other, group, flat):
                return np.broadcast_to(flat, (rows, flat.shape[1])).copy()
            continue
        if flat.shape[1] != parameter_count(len(inputs), config.hidden, outputs, config.memory):
            continue
        widened = with_inputs(flat, inputs, group.observation_size, config.hidden)
        return np.broadcast_to(widened, (rows, widened.shape[1])).copy()
    return None


def _inputs(
    names: tuple[str, ...] | None, others: tuple[str, ...] | None, size: int, other_size: int
) -> list[int] | None:
    """Return which of a type's inputs each input of a policy is; None if the type lacks one, or it is not known."""
    if names is None or others is None:
        return list(range(size)) if size == other_size else None
    return [names.index(name) for name in others] if set(others) <= set(names) else None


def with_inputs(flat: Float32, inputs: Sequence[int], size: int, hidden: int) -> Float32:
    """Return actors with more inputs, whose weights are 0: they act as before.

    Args:
        flat: [n, P] parameters of networks with as many inputs as `inputs` has.
        inputs: which of the new inputs each of theirs is.
        size: the new number of inputs.
        hidden: width h of the first layer.

    Returns:
        [n, P + (size - len(inputs)) h]; the first layer's weights come first, one row for each input.
    """
    own = len(inputs) * hidden
    weights = np.zeros((len(flat), size, hidden), np.float32)
    weights[:, inputs] = flat[:, :own].reshape(len(flat), len(inputs), hidden)
    return np.concatenate([weights.reshape(len(flat), -1), flat[:, own:]], axis=1)
