"""What decides the actions of a whole batch of farms, and every such policy that has a name.

The loop that calls a policy is:

    for index in range(environments):
        farms.reset(index, farm_seed, episode_seed)
        policy.reset(farms, index)
    while not farms.truncated.all():
        farms.step(policy.act(farms))
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any, Final, Protocol, TypeVar

import numpy as np

from common.actors import TeamActors
from common.config import FarmConfig, RunConfig
from common.errors import PolicyError
from common.farm import farm_of, farm_team
from common.policy_file import load_policy
from common.team import Float32, GroupSpec, TeamSpec
from rollout.envs.base import Environments
from rollout.heuristics import greedy, horizon, hungarian, lawnmower, tour
from rollout.heuristics.composite import CompositePolicy, GroupPolicyFactory
from rollout.heuristics.random import RandomPolicy
from rollout.heuristics.relays import CentroidRelays, SearchRelays
from rollout.heuristics.static import StaticPolicy
from rollout.sim.batch import FarmBatch

TRAINED: Final = Path(__file__).parent / "trained" / "default.safetensors"
"""The policy that ships with this package."""


World_contra = TypeVar("World_contra", contravariant=True)


class BatchPolicy(Protocol[World_contra]):
    """Decides for all agents of all environments of a batch."""

    def reset(self, world: World_contra, index: int, /) -> None:
        """Prepare for the episode that environment `index` has just begun."""

    def act(self, world: World_contra, /) -> Float32:
        """Return the actions [E, A] in [-1, 1] for the present state of all environments."""


Policy = BatchPolicy[FarmBatch]
"""A policy for farms."""


class ActorPolicy:
    """Actors without noise.

    Args:
        actors: the actors.
    """

    def __init__(self, actors: TeamActors) -> None:
        self._actors = actors

    def reset(self, environments: Environments, index: int) -> None:
        """Take up the environments' action adapters; raise PolicyError unless the actors fit their team."""
        self._actors = fitted(self._actors, environments.team)

    def act(self, environments: Environments) -> Float32:
        """Return what the actors command.

        One environment is computed at a time: a matrix product sums in another order for another number of rows, and
        an episode must not depend on which others are flown beside it.
        """
        return np.concatenate([self._actors.environment_actions(row[None]) for row in environments.observation])


def fitted(actors: TeamActors, team: TeamSpec) -> TeamActors:
    """Return the actors as those of a team, with the team's action adapters: a field may have another size.

    Raises:
        PolicyError: they are for other types, counts, observations or actions, or for another kind of control.
    """
    if actors.team == team:
        return actors
    if [_interface(group) for group in actors.team.groups] != [_interface(group) for group in team.groups]:
        raise PolicyError(f"the policy is for {_describe(actors.team)}; here are {_describe(team)}.")
    return TeamActors(team, actors.hidden, actors.flat, actors.head)


def _interface(group: GroupSpec) -> tuple[Any, ...]:
    """Return what a group must share with another one to be flown by its actors; adapters' numbers may differ."""
    kinds = tuple(adapter.kind for adapter in group.adapters)
    return group.name, group.count, group.observation_size, group.action_size, kinds


def trained_policy(path: Path, config: FarmConfig) -> Policy:
    """Return the policy of a file.

    Raises:
        PolicyError: the file cannot be used, or its policy is for another team than the farm's.
    """
    actors, _ = load_policy(path)
    return ActorPolicy(fitted(actors, farm_team(config)))


def _shipped(config: FarmConfig) -> Policy:
    if not TRAINED.exists():
        raise PolicyError("no trained policy is part of this installation; train one, or name another policy.")
    return trained_policy(TRAINED, config)


TASKS: Final[dict[str, tuple[GroupPolicyFactory, GroupPolicyFactory]]] = {
    "lawnmower": (lawnmower.monitors, lawnmower.collectors),
    "greedy": (greedy.monitors, greedy.collectors),
    "tour": (tour.monitors, tour.collectors),
    "hungarian": (hungarian.monitors, hungarian.collectors),
    "horizon": (horizon.monitors, horizon.collectors),
}
"""Heuristics of the monitors and of the collectors."""

RELAYS: Final[dict[str, GroupPolicyFactory]] = {"search": SearchRelays, "centroid": CentroidRelays}
"""Heuristics of the relays; the first one flies where none is named."""


def _crews(task: str, relays: str = next(iter(RELAYS))) -> Callable[[FarmConfig], Policy]:
    return lambda config: CompositePolicy(config, RELAYS[relays], *TASKS[task])


POLICIES: Final[dict[str, Callable[[FarmConfig], Policy]]] = {
    "static": lambda _: StaticPolicy(),
    "random": lambda _: RandomPolicy(),
    **{task: _crews(task) for task in TASKS},
    "trained": _shipped,
}
"""Every policy that has a name, made for a farm's configuration. TASK+RELAYS, as in greedy+centroid, names others."""

REFERENCES: Final = ("lawnmower", "greedy", "static", "random")
"""What a run's report compares with; heuristics that plan ahead take minutes, and `eia-sec evaluate` flies them."""

HEURISTICS: Final = tuple(name for name in POLICIES if name != "trained")
"""The policies that learn nothing."""


def policy_of(name: str, config: FarmConfig) -> Policy:
    """Return the policy of a name, of TASK+RELAYS, or of the file at that path.

    Raises:
        PolicyError: there is neither, or what there is cannot be used.
    """
    if name in POLICIES:
        return POLICIES[name](config)
    task, _, relays = name.partition("+")
    if task in TASKS and relays in RELAYS:
        return _crews(task, relays)(config)
    if Path(name).is_file():
        return trained_policy(Path(name), config)
    raise PolicyError(
        f"there is no policy {name!r}: give one of {', '.join(POLICIES)}, TASK+{'|'.join(RELAYS)}, or a policy file."
    )


def run_policy(name: str, config: RunConfig) -> BatchPolicy[Any]:
    """Return a policy for a run's environment: on the farm as `policy_of`, elsewhere random or a policy file.

    Raises:
        PolicyError: there is none of that name, or it cannot be used.
    """
    if (farm := farm_of(config)) is not None:
        return policy_of(name, farm)
    if name == "random":
        return RandomPolicy()
    if not Path(name).is_file():
        raise PolicyError(f"outside the farm there is no policy {name!r}: give random, or a policy file.")
    return ActorPolicy(load_policy(Path(name))[0])


def reference_policies(config: RunConfig) -> tuple[str, ...]:
    """Return the names of the policies that a run's report compares with the trained one."""
    return ("random",) if farm_of(config) is None else REFERENCES


def _describe(team: TeamSpec) -> str:
    """Return a team in words: how many of each type, how many numbers each of them observes, and its adapters."""
    told = []
    for group in team.groups:
        kinds = ", ".join(adapter.kind for adapter in group.adapters)
        how = f" ({kinds})" if kinds else ""
        told.append(f"{group.count} {group.name} agents with {group.observation_size} inputs{how}")
    return ", ".join(told)
