"""A population of learners: when its rounds are due, and what a round means for one member.

Round r is due when every member that takes part has finished r times `population.interval` of its run. All members keep
the number of the newest round that they took part in, so a coordinator that is restarted goes on with the next one.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final

from eia_sec.common.config import RunConfig
from eia_sec.common.config.population import MOST_MEMBERS
from eia_sec.common.errors import ConfigError, SchemaError
from eia_sec.common.imitation import MOST_STEPS
from eia_sec.common.names import is_name
from eia_sec.common.team import Float32, TeamSpec

MOST_ROUNDS: Final = 1000
ROUNDING: Final = 1e-9


def round_due(config: RunConfig, progress: float) -> int:
    """Return the newest round that is due at a finished share of the run; 0 for none, and none at the run's end."""
    interval = config.population.interval
    rounds = math.ceil(1.0 / interval - ROUNDING) - 1
    return min(rounds, math.floor(progress / interval + ROUNDING)) if config.population.members else 0


def hyperparameters_of(config: RunConfig) -> dict[str, float]:
    """Return the present values of the hyperparameters in which members differ."""
    return {name: float(getattr(config.algorithm, name)) for name in config.population.hyperparameters}


def checked_hyperparameters(config: RunConfig, found: Mapping[str, Any]) -> dict[str, float]:
    """Return hyperparameters that came from elsewhere; raise SchemaError unless the configuration allows them."""
    ranges = config.population.hyperparameters
    if set(found) != set(ranges):
        given = ", ".join(map(str, found))[:200]
        raise SchemaError(f"the hyperparameters are {', '.join(ranges) or 'none'}, not {given or 'none'}.")
    for name, (low, high) in ranges.items():
        value = found[name]
        if type(value) is not float or not low <= value <= high:
            raise SchemaError(f"{name} {str(value)[:40]} is not between {low:g} and {high:g}.")
    try:
        config.algorithm.with_live(found)
    except ConfigError as error:
        raise SchemaError(str(error)) from error
    return dict(found)


@dataclass(frozen=True)
class Exploit:
    """What a round means for one member; the term is that of Jaderberg et al. (2017).

    Attributes:
        round: its number, from 1.
        rate: share by which actors move to those of `flat`; 0 where the member imitates nobody.
        scores: of each member that took part, by its run's name.
        sources: for each type, the member whose team it imitates, or empty for none.
        flat: for each type, the actors to imitate, [n_v, P_v] or [1, P_v]; [0, 0] for none.
        hyperparameters: those with which the member goes on.
        evaluation_steps: environment steps of the member's evaluation.
    """

    round: int
    rate: float
    scores: Mapping[str, float]
    sources: tuple[str, ...]
    flat: tuple[Float32, ...] = field(repr=False)
    hyperparameters: Mapping[str, float]
    evaluation_steps: int = 0

    @property
    def imitates(self) -> bool:
        """Whether any type imitates another member's."""
        return any(self.sources)

    def check(self, team: TeamSpec, config: RunConfig) -> None:
        """Raise SchemaError unless it fits the team and the configuration; parameters' numbers are not looked at."""
        if not 1 <= self.round <= MOST_ROUNDS or not 0 <= self.evaluation_steps <= MOST_STEPS:
            raise SchemaError(f"round {self.round} with an evaluation of {self.evaluation_steps} steps is impossible.")
        if self.rate != (config.population.rate if self.imitates else 0.0):
            raise SchemaError(f"round {self.round} has the rate {self.rate:g}, not {config.population.rate:g}.")
        if len(self.sources) != len(team.groups) or len(self.flat) != len(team.groups):
            raise SchemaError("the round is for another number of types.")
        if len(self.scores) > MOST_MEMBERS or not all(isinstance(name, str) and is_name(name) for name in self.scores):
            raise SchemaError("the round's members are too many, or have no names.")
        if not set(self.sources) <= {*self.scores, ""}:
            raise SchemaError("the round names a member that was not scored.")
        if not all(type(score) is float and math.isfinite(score) for score in self.scores.values()):
            raise SchemaError("a score is no number.")
        for group, source, flat in zip(team.groups, self.sources, self.flat, strict=True):
            if flat.ndim != 2 or len(flat) not in ((1, group.count) if source else (0,)):
                raise SchemaError(f"the round's parameters do not fit {group.count} {group.name} agents.")
        checked_hyperparameters(config, self.hyperparameters)
