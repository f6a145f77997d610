"""What a callback may do to a run, wherever it runs: stop it, and change the environment's arguments."""

import json
from abc import abstractmethod
from typing import Any

from eia_sec.common.callbacks import SHOWN, TrainingProgress
from eia_sec.common.config import RunConfig
from eia_sec.common.config.environment import MOST_ARGUMENTS
from eia_sec.common.errors import ConfigError


class SteeredProgress(TrainingProgress):
    """A run that a callback can steer.

    Args:
        config: the run.

    Attributes:
        stopped: whether a callback has stopped it.
        reason: why.
        arguments: the environment's present arguments, JSON.
    """

    def __init__(self, config: RunConfig) -> None:
        self._config = config
        self.stopped, self.reason = False, ""
        self.arguments = json.dumps(config.env.keywords())

    def stop(self, reason: str = "") -> None:
        """See `TrainingProgress`."""
        self.stopped, self.reason = True, reason[:SHOWN] or "a callback stopped it"

    def set_arguments(self, **arguments: Any) -> None:
        """See `TrainingProgress`."""
        if not self._config.env.is_third_party or self._config.env.served:
            raise ConfigError(f"{self._config.env.name} takes no arguments that change while a run trains.")
        try:
            wanted = json.dumps({**json.loads(self.arguments), **arguments})
        except (TypeError, ValueError, RecursionError) as error:
            raise ConfigError(f"the environment's arguments are no JSON: {error}.") from None
        if len(wanted) > MOST_ARGUMENTS:
            raise ConfigError(
                f"the environment's arguments are {len(wanted)} characters; at most {MOST_ARGUMENTS} fit."
            )
        if wanted != self.arguments:
            self._change(wanted)
            self.arguments = wanted

    @abstractmethod
    def _change(self, arguments: str) -> None:
        """Give the environments other arguments, a JSON object."""
