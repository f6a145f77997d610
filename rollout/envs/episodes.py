"""The episodes of an environment: a reproducible stream of (farm, episode) seeds."""

import operator
import secrets
from collections.abc import Mapping, Sequence
from typing import Any, Final

from eia_sec.common.config import RolloutConfig
from eia_sec.common.errors import ConfigError, SimulationError
from eia_sec.common.seeds import derive, stream

TRAINING_FARMS: Final = range(RolloutConfig.train_farms)
"""Seeds of the farms that training uses (W26)."""
SEED_BITS: Final = 62
"""Bits of a random seed."""


class EpisodeStream:
    """The sequence of episodes of one environment.

    Episode k of a stream is a pure function of (seed, k, farms). A seed restarts the stream; without a seed it starts
    at random.

    Args:
        farms: seeds of the farms to draw from.

    Raises:
        ConfigError: there is no farm.
        SimulationError: a farm's seed is not a non-negative integer.
    """

    def __init__(self, farms: Sequence[int]) -> None:
        if len(farms) == 0:
            raise ConfigError("an environment needs at least one farm.")
        self._farms = tuple(whole("a farm's seed", farm) for farm in farms)
        self._number = 0
        self._seed = secrets.randbits(SEED_BITS)

    def begin(self, seed: int) -> None:
        """Restart with a seed; raise SimulationError unless it is a non-negative integer."""
        self._seed, self._number = whole("a seed", seed), 0

    def next(self, options: Mapping[str, Any] | None = None) -> tuple[int, int]:
        """Return the seeds of the next farm and episode.

        Args:
            options: "farm" and "episode" replace the drawn seeds; the stream advances all the same.

        Raises:
            SimulationError: an option is not a non-negative integer.
        """
        parts = ("environment", self._seed, self._number)
        chosen = options or {}
        farm, episode = chosen.get("farm"), chosen.get("episode")
        if farm is None:
            farm = self._farms[int(stream(*parts, "farm").integers(len(self._farms)))]
        if episode is None:
            episode = derive(*parts, "episode")
        seeds = whole("options['farm']", farm), whole("options['episode']", episode)
        self._number += 1
        return seeds


def whole(name: str, value: Any) -> int:
    """Return a non-negative integer as a plain int; raise SimulationError for any other value."""
    try:
        number = operator.index(value)
    except TypeError:
        number = -1
    if number < 0 or isinstance(value, bool):
        raise SimulationError(f"{name} is {value!r}, not a whole number from 0 on.")
    return number
