"""Policies, which select the actions of all agents in a batch of environments.

A policy is called in this loop:

    for index in range(environments):
        farms.reset(index, farm_seed, episode_seed)
        policy.reset(farms, index)
    while not farms.ended.any():
        farms.step(policy.act(farms))
"""

import re
from dataclasses import replace
from pathlib import Path
from typing import Any, Final, Protocol, TypeVar

import numpy as np

from eia_sec.common import plugins
from eia_sec.common.actors import TeamActors, can_fly
from eia_sec.common.config import FarmConfig, RunConfig
from eia_sec.common.errors import PolicyError
from eia_sec.common.farm import farm_of, farm_team
from eia_sec.common.policy_file import load_policy
from eia_sec.common.seeds import stream
from eia_sec.common.spelling import did_you_mean
from eia_sec.common.team import Float32, TeamSpec, described
from eia_sec.rollout.envs.base import Environments
from eia_sec.rollout.heuristics.random import RandomPolicy
from eia_sec.rollout.heuristics.registry import HEURISTICS, RELAYS, heuristic
from eia_sec.rollout.shipped_policies import SHIPPED, is_file, shipped_file
from eia_sec.rollout.sim.batch import FarmBatch

World_contra = TypeVar("World_contra", contravariant=True)


class BatchPolicy(Protocol[World_contra]):
    """Selects the actions of all agents in all environments of a batch."""

    def reset(self, world: World_contra, index: int, /) -> None:
        """Prepare for the episode that environment `index` has just begun."""

    def act(self, world: World_contra, /) -> Float32:
        """Return the environment's actions [E, A] for the current state of all environments."""


Policy = BatchPolicy[FarmBatch]
"""A policy for farms."""


class ActorPolicy:
    """Actors without noise.

    Args:
        actors: the actors.
    """

    def __init__(self, actors: TeamActors) -> None:
        self._actors = actors
        self._state: Float32 | None = None

    def reset(self, environments: Environments, index: int) -> None:
        """Adopt the environments' action adapters and forget the environment's earlier observations.

        Raises:
            PolicyError: the actors do not fit the environments' team.
        """
        self._actors = fitted(self._actors, environments.team)
        if self._state is None or len(self._state) != len(environments.time):
            self._state = self._actors.initial_state(len(environments.time))
        if self._state is not None:
            self._state[index] = 0.0

    def act(self, environments: Environments) -> Float32:
        """Return the actors' actions.

        Environments are computed one at a time, because an episode must not depend on the rest of its batch: the number
        of rows changes the order in which a matrix product sums.
        """
        state, rows = self._state, environments.observation
        each = [None] * len(rows) if state is None else [state[index : index + 1] for index in range(len(rows))]
        own = zip(range(len(rows)), rows, each, strict=True)
        return np.concatenate([self._actions(index, row[None], memory) for index, row, memory in own])

    def _actions(self, index: int, row: Float32, state: Float32 | None) -> Float32:
        """Return the actions [1, A] of environment `index` for its row [1, O]."""
        return self._actors.environment_actions(row, state)


class SampledPolicy(ActorPolicy):
    """Actors that draw their actions, as they do while they learn on policy.

    An episode's draws depend only on its scenario and episode seeds, not on its batch.

    Args:
        actors: actors with a distribution, see `TeamActors.draws`.
    """

    def __init__(self, actors: TeamActors) -> None:
        super().__init__(actors)
        self._streams: dict[int, np.random.Generator] = {}

    def reset(self, environments: Environments, index: int) -> None:
        """Start the random stream of one environment's episode; otherwise as `ActorPolicy`."""
        super().reset(environments, index)
        episode = environments.summary(index)
        self._streams[index] = stream("sampled policy", episode.farm, episode.episode)

    def _actions(self, index: int, row: Float32, state: Float32 | None) -> Float32:
        shape, own = (1, self._actors.team.action_size), self._streams[index]
        normal, uniform = own.standard_normal(shape, np.float32), own.random(shape, np.float32)
        return self._actors.team.adapt(row, self._actors.sample(row, normal, uniform, state)[0])


def fitted(actors: TeamActors, team: TeamSpec) -> TeamActors:
    """Return the actors for a team, with the team's action adapters. The team's field may have another size.

    An actor that all agents of a type share flies any number of them.

    Raises:
        PolicyError: the actors are for other types, counts, observations or actions, or for another kind of control.
    """
    if actors.team == team:
        return actors
    pairs = zip(actors.team.groups, team.groups, actors.flat, strict=False)
    if len(actors.flat) != len(team.groups) or not all(can_fly(own, other, flat) for own, other, flat in pairs):
        raise PolicyError(f"the policy is for {described(actors.team)}, but this environment has {described(team)}.")
    return replace(actors, team=team)


def trained_policy(path: Path, config: FarmConfig) -> Policy:
    """Return the policy of a file.

    Raises:
        PolicyError: the file cannot be used, or its policy is for another team than the farm's.
    """
    actors, _ = load_policy(path)
    return ActorPolicy(fitted(actors, farm_team(config)))


POLICIES: Final = (*HEURISTICS, *SHIPPED)
"""The names of all policies; `eia_sec.rollout.heuristics.registry` lists the heuristics."""

PLACE: Final = re.compile(r"(?!trained:)[A-Za-z_][\w.]*:[A-Za-z_][\w.]*")
"""module:name of a class; naming it runs its code, as with `--env`."""

REFERENCES: Final = ("lawnmower", "greedy", "static", "random")
"""Policies that a run's report compares with. Heuristics that plan ahead take minutes, so they are left out."""


def policy_of(name: str, config: FarmConfig) -> Policy:
    """Return the policy with this name, the combination TASK+RELAYS, or the policy in the file at this path.

    Raises:
        PolicyError: the policy does not exist or cannot be used.
    """
    if name in SHIPPED:
        return trained_policy(shipped_file(name), config)
    found: Policy | None = heuristic(name, config)
    if found is not None:
        return found
    if is_file(Path(name)):
        return trained_policy(Path(name), config)
    raise PolicyError(
        f"there is no policy {name!r}{did_you_mean(name, POLICIES) or '.'} Give one of {', '.join(POLICIES)}, "
        f"TASK+{'|'.join(RELAYS)}, or a policy file."
    )


def run_policy(name: str, config: RunConfig) -> BatchPolicy[Any]:
    """Return a policy for a run's environment.

    Args:
        name: of a plug-in's heuristic, module:name of one, as for `policy_of`, random, or a file.
        config: the run.

    Raises:
        PluginError: a heuristic cannot be made, or a plug-in's has the name of a policy of this package.
        PolicyError: the policy does not exist or cannot be used.
    """
    plugins.require_heuristics_beside(POLICIES)
    found: BatchPolicy[Any] | None = plugins.heuristic(name)
    if found is None and PLACE.fullmatch(name) and not is_file(Path(name)):
        found = plugins.heuristic_at(name)
    if found is not None:
        return found
    if (farm := farm_of(config)) is not None:
        return policy_of(name, farm)
    if name == "random":
        return RandomPolicy()
    if not is_file(Path(name)):
        meant = did_you_mean(name, plugins.heuristics()) or "."
        raise PolicyError(
            f"outside the farm there is no policy {name!r}{meant} Give random, a policy file, a heuristic of a plug-in "
            "(--plugin NAME), or module:name of one."
        )
    return ActorPolicy(load_policy(Path(name))[0])


def reference_policies(config: RunConfig) -> tuple[str, ...]:
    """Return the names of the policies that a run's report compares with the trained one."""
    return ("random",) if farm_of(config) is None else REFERENCES
