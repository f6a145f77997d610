"""A policy that acts for agents by their names, as PettingZoo's environments want it."""

from collections.abc import Iterator, Mapping
from contextlib import closing
from functools import cached_property
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from eia_sec.common.actors import TeamActors
from eia_sec.common.config import EnvConfig
from eia_sec.common.errors import ContractError, PolicyError
from eia_sec.common.policy_file import save_policy
from eia_sec.common.team import Float32, GroupSpec, TeamSpec

Observations = Mapping[Any, Any]
Infos = Mapping[Any, Mapping[str, Any]]


class _Interface(Protocol):
    """How observations by agent become a row, and a row of actions becomes actions by agent."""

    def row(self, observations: Observations, infos: Infos) -> Float32:
        """Return the row [1, O] of some agents' observations; others observe what absent agents do."""

    def actions(self, row: Float32, agents: Observations) -> dict[Any, Any]:
        """Return the actions of some agents in a row [1, A]."""


class Policy:
    """Trained actors without noise, which act for agents by their names.

    Actors with memory remember an episode's observations; call `reset` when another episode begins.

    Args:
        actors: the actors.
        environment: the environment that says how observations become numbers; without it, or for the farm,
            observations are vectors [o] and actions vectors [a] or indices of options.

    Attributes:
        actors: the actors.
    """

    def __init__(self, actors: TeamActors, environment: EnvConfig | None = None) -> None:
        self.actors = actors
        self._environment = environment
        self._state = actors.initial_state(1)

    def act(self, observations: Observations, infos: Infos | None = None) -> dict[Any, Any]:
        """Return the likeliest action of each agent that observes something.

        Args:
            observations: what each living agent sees, by its name, as the environment returns it.
            infos: by the same names; only needed where they hold action masks.

        Returns:
            an action in each agent's action space, by the same names.

        Raises:
            PolicyError: an agent or an observation is not one of the policy's team.
        """
        row = self._interface.row(observations, infos or {})
        return self._interface.actions(self.actors.environment_actions(row, self._state), observations)

    def reset(self) -> None:
        """Forget what was observed: another episode begins."""
        self._state = self.actors.initial_state(1)

    def save(self, path: str | Path) -> None:
        """Write the actors as a policy file; raise PolicyError if that is impossible."""
        save_policy(Path(path), self.actors, {})

    @cached_property
    def _interface(self) -> _Interface:
        environment, team = self._environment, self.actors.team
        if environment is None or not environment.is_third_party:
            return _Vectors(team)
        return _PettingZoo(environment, team)


class _Vectors:
    """Agents that see vectors, with the names that the team gives them."""

    def __init__(self, team: TeamSpec) -> None:
        self._team = team
        self._groups = dict(zip(team.agent_names, _each(team), strict=True))

    def row(self, observations: Observations, infos: Infos) -> Float32:
        """See `_Interface`."""
        _require_known(observations, self._groups)
        parts = [np.zeros(group.observation_size, np.float32) for group in self._groups.values()]
        for part, (name, group) in zip(parts, self._groups.items(), strict=True):
            if name not in observations:
                continue
            seen = np.asarray(observations[name], np.float32)
            wanted = group.image if group.image and not group.masked else part.shape
            if seen.shape != wanted:
                raise PolicyError(
                    f"the observation of agent {name} has the shape {list(seen.shape)}, and {group.name} agents of "
                    f"this policy see {list(wanted)}."
                )
            part[:] = seen.reshape(-1)
        return np.concatenate(parts)[None]

    def actions(self, row: Float32, agents: Observations) -> dict[Any, Any]:
        """See `_Interface`."""
        parts = self._team.split_environment_actions(row)
        each = [action for part in parts for action in part[0]]
        found = dict(zip(self._groups.items(), each, strict=False))
        return {name: _plain(group, action) for (name, group), action in found.items() if name in agents}


class _PettingZoo:
    """The agents of a PettingZoo environment, which is made once to learn its spaces."""

    def __init__(self, config: EnvConfig, team: TeamSpec) -> None:
        from eia_sec.rollout.envs.pettingzoo_actions import RowActions  # noqa: PLC0415  (pettingzoo loads only for its users)
        from eia_sec.rollout.envs.pettingzoo_observations import RowObservations  # noqa: PLC0415  (likewise)
        from eia_sec.rollout.envs.pettingzoo_spec import describe, make_parallel  # noqa: PLC0415  (likewise)
        from eia_sec.rollout.envs.vectorised import VectorisedBatch, vectorised_class  # noqa: PLC0415  (likewise)

        boxes = not any(group.choices for group in team.groups)
        if vectorised_class(config.name) is not None:
            with closing(VectorisedBatch(config, 1, threads=1)) as batch:
                agents = batch.agents
        else:
            with closing(make_parallel(config, boxes=boxes)) as made:
                agents = describe(made, config.types)
        if agents.team != team:
            raise PolicyError(f"the policy is for another team than {config.name} has.")
        self._rows, self._actions = RowObservations(agents.views), RowActions(agents.actions)

    def row(self, observations: Observations, infos: Infos) -> Float32:
        """See `_Interface`."""
        _require_known(observations, self._rows.views)
        try:
            return self._rows.row(observations, infos)[None].copy()
        except ContractError as error:
            raise PolicyError(f"the policy was given {error}") from None

    def actions(self, row: Float32, agents: Observations) -> dict[Any, Any]:
        """See `_Interface`."""
        return self._actions.by_agent(self._actions.in_range(row)[0], agents)


def _each(team: TeamSpec) -> Iterator[GroupSpec]:
    return (group for group in team.groups for _ in range(group.count))


def _plain(group: GroupSpec, action: Float32) -> Any:
    """Return an action [a]; the index of a single choice that no adapter translates as a whole number."""
    return int(action[0]) if len(group.choices) == 1 and not group.adapters else action


def _require_known(observations: Observations, known: Mapping[Any, Any]) -> None:
    odd = [name for name in observations if name not in known]
    if odd or not observations:
        raise PolicyError(
            f"the policy acts for {', '.join(map(str, list(known)[:5]))}{' ...' if len(known) > 5 else ''}, not for "
            f"{odd[0] if odd else 'nobody'}."
        )
