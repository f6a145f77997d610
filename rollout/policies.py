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
from typing import Final, Protocol

import numpy as np

from common.actors import ActorBank
from common.config import FarmConfig
from common.errors import PolicyError
from common.policy_file import load_policy
from common.team import Float32, TeamSpec, farm_team
from rollout.farms import FarmBatch
from rollout.heuristics.greedy import GreedyPolicy
from rollout.heuristics.lawnmower import LawnmowerPolicy
from rollout.heuristics.random import RandomPolicy
from rollout.heuristics.static import StaticPolicy

TRAINED: Final = Path(__file__).parent / "trained" / "default.safetensors"
"""The policy that ships with this package."""


class Policy(Protocol):
    """Decides for all agents of all environments of a batch."""

    def reset(self, farms: FarmBatch, index: int) -> None:
        """Prepare for the episode that environment `index` has just begun."""

    def act(self, farms: FarmBatch) -> Float32:
        """Return the actions [E, A] in [-1, 1] for the present state of all environments."""


class ActorPolicy:
    """Actors without noise.

    Args:
        bank: the actors.
    """

    def __init__(self, bank: ActorBank) -> None:
        self._bank = bank

    def reset(self, farms: FarmBatch, index: int) -> None:
        """Raise PolicyError unless the actors fit the farms' team."""
        require_team(self._bank, farms.team)

    def act(self, farms: FarmBatch) -> Float32:
        """Return what the actors do.

        One environment is computed at a time: a matrix product sums in another order for another number of rows, and
        an episode must not depend on which others are flown beside it.
        """
        return np.concatenate([self._bank.act(row[None]) for row in farms.observation])


def require_team(bank: ActorBank, team: TeamSpec) -> None:
    """Raise PolicyError unless the actors are for exactly this team."""
    if bank.team.digest != team.digest:
        raise PolicyError(f"the policy is for {_describe(bank.team)}, the farm has {_describe(team)}.")


def trained_policy(path: Path, config: FarmConfig) -> Policy:
    """Return the policy of a file.

    Raises:
        PolicyError: the file cannot be used, or its policy is for another team than the farm's.
    """
    bank, _ = load_policy(path)
    require_team(bank, farm_team(config))
    return ActorPolicy(bank)


def _shipped(config: FarmConfig) -> Policy:
    if not TRAINED.exists():
        raise PolicyError("no trained policy is part of this installation; train one, or name another policy.")
    return trained_policy(TRAINED, config)


POLICIES: Final[dict[str, Callable[[FarmConfig], Policy]]] = {
    "static": lambda _: StaticPolicy(),
    "random": lambda _: RandomPolicy(),
    "lawnmower": LawnmowerPolicy,
    "greedy": GreedyPolicy,
    "trained": _shipped,
}
"""Every policy that has a name, made for a farm's configuration."""

HEURISTICS: Final = tuple(name for name in POLICIES if name != "trained")
"""The policies that learn nothing."""


def policy_of(name: str, config: FarmConfig) -> Policy:
    """Return the policy of a name, or of the file at that path.

    Raises:
        PolicyError: there is neither, or what there is cannot be used.
    """
    if name in POLICIES:
        return POLICIES[name](config)
    if Path(name).is_file():
        return trained_policy(Path(name), config)
    raise PolicyError(f"there is no policy {name!r}: give one of {', '.join(POLICIES)}, or a policy file.")


def _describe(team: TeamSpec) -> str:
    """Return a team in words: how many of each type, and how many numbers each of them observes."""
    return ", ".join(f"{group.count} {group.name} UAVs with {group.observation_size} inputs" for group in team.groups)
