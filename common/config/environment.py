"""The environment of a run: one of this package, such as the farm, or any PettingZoo parallel environment."""

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

from eia_sec.common.config.checks import within
from eia_sec.common.config.maps import FrozenMap, freeze
from eia_sec.common.errors import ConfigError
from eia_sec.common.names import is_name

FARM: Final = "farm"
"""Name of the farm, which FarmConfig configures."""
ZENOH: Final = "zenoh:"
"""What the name of environments begins with that others serve."""
_SERVED: Final = re.compile(rf"{ZENOH}[A-Za-z0-9_.\-*]{{1,63}}")
MOST_EPISODE_STEPS: Final = 100_000
"""Steps after which an episode is truncated where neither the environment nor the configuration ends it."""

MOST_ARGUMENTS: Final = 8 * 1024
"""Most characters of arguments that change while a run trains."""


@dataclass(frozen=True)
class EnvConfig:
    """The environment; all options but `name` are for PettingZoo environments."""

    name: str = FARM
    """farm or another environment of this package; module:name of a PettingZoo parallel environment or of a callable
    that returns one, for instance mpe2:simple_spread_v3; vmas:SCENARIO or jaxmarl:NAME; or zenoh:NAME of environments
    that others serve, NAME with `*` for any letters."""
    arguments: str = "{}"
    """Keyword arguments of the environment as a JSON object, for instance {"N": 3}."""
    types: Mapping[str, str] = FrozenMap()
    """Types of agents by the beginning of their names; others have their name without its number."""
    steps: int = 0
    """Steps after which an episode is truncated; 0 leaves truncation to the environment."""

    step_timeout: float = 0.0
    """Seconds after which a worker whose environment has not returned from a call ends, for its supervisor to replace
    it; 0 waits for ever."""

    def __post_init__(self) -> None:
        """Refuse names and arguments that cannot be read."""
        within(0, 1_000_000, steps=self.steps)
        within(0.0, 1e6, step_timeout=self.step_timeout)
        module, colon, member = self.name.partition(":")
        parts = [*module.split("."), *member.split(".")] if colon else [self.name]
        elsewhere = self.name.startswith(ZENOH)
        if not (self.served if elsewhere else all(part.isidentifier() for part in parts)):
            raise ConfigError(f"env.name must be farm, module:name or zenoh:NAME, not {self.name!r}.")
        if self.keywords() and self.served:
            raise ConfigError("env.arguments have no effect on environments that others serve.")
        freeze(self, "types")
        if unnamed := [prefix for prefix, kind in self.types.items() if not is_name(kind)]:
            raise ConfigError(
                f"env.types gives {unnamed[0]!r} the type {self.types[unnamed[0]][:80]!r}, which is no name."
            )

    @property
    def is_third_party(self) -> bool:
        """Whether making it imports and runs code from outside this package."""
        return ":" in self.name

    @property
    def served(self) -> str:
        """The pattern of the names of environments that others serve, or empty for any other environment."""
        return self.name.removeprefix(ZENOH) if _SERVED.fullmatch(self.name) else ""

    def keywords(self) -> dict[str, Any]:
        """Return `arguments` as a map; raise ConfigError when they are no JSON object."""
        try:
            found = json.loads(self.arguments)
        except (ValueError, RecursionError) as error:
            raise ConfigError(f"env.arguments is not JSON: {error}.") from None
        if not isinstance(found, dict):
            raise ConfigError('env.arguments must be a JSON object, {"N": 3} for instance.')
        return found


def unusable_arguments(arguments: str | None) -> str:
    """Return why a text cannot be an environment's arguments while a run trains, or an empty string."""
    if arguments is None or len(arguments) > MOST_ARGUMENTS:
        return f"an environment's arguments are a JSON object of at most {MOST_ARGUMENTS} characters."
    try:
        return "" if isinstance(json.loads(arguments), dict) else "an environment's arguments are a JSON object."
    except (ValueError, RecursionError):
        return "an environment's arguments are no JSON."
