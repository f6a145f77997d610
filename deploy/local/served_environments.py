"""Environments that others serve, as the commands reach them that listen for a while: train, learner and evaluate."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Final, TypeVar

from eia_sec.common.config import RunConfig
from eia_sec.common.environment import EnvironmentSpec
from eia_sec.common.errors import EnvironmentOutageError, UsageError
from eia_sec.common.log import log
from eia_sec.common.transport.bus import Bus
from eia_sec.common.transport.endpoint import Endpoint
from eia_sec.rollout.envs.base import Reach
from eia_sec.rollout.envs.registry import environment_spec

PATIENCE_SECONDS: Final = 300.0
"""Time for which a command waits for a first environment."""
SAID_SECONDS: Final = 10.0
"""Pause between two log lines about that."""
TRY_SECONDS: Final = 0.5

T = TypeVar("T")


@contextmanager
def reached(endpoint: Endpoint, holder: str, *, connect: bool = False) -> Iterator[Reach]:
    """Listen in this block where environments connect to, or connect to a router where they do.

    Args:
        endpoint: where.
        holder: under which name environments are claimed.
        connect: whether a router listens there.
    """
    with Bus.connect(endpoint, "control") if connect else Bus.listen(endpoint, "control") as bus:
        yield Reach(bus, holder)


def tried_spec(config: RunConfig, endpoint: Endpoint, *, connect: bool = False) -> EnvironmentSpec:
    """Return the description of the environments after a trial of one of them, see `environment_spec`.

    Args:
        config: the run.
        endpoint: where they connect to.
        connect: whether a router listens there; else this process does, for that time.

    Raises:
        UsageError: none is there or free after PATIENCE_SECONDS.
    """
    with reached(endpoint, "trial", connect=connect) as reach:
        return when_served(config, endpoint, lambda: environment_spec(config, trial=True, reach=reach))


def when_served(config: RunConfig, endpoint: Endpoint, attempt: Callable[[], T]) -> T:
    """Return what an attempt returns that needs an environment, once there is one; see `tried_spec` for the rest."""
    began = time.monotonic()
    said = began - SAID_SECONDS
    while True:
        try:
            return attempt()
        except EnvironmentOutageError as error:
            now = time.monotonic()
            if now - began > PATIENCE_SECONDS:
                raise UsageError(
                    f"{config.env.name}: {error}, and {PATIENCE_SECONDS:.0f} s have passed; environments connect to "
                    f"{endpoint}."
                ) from None
            if now - said >= SAID_SECONDS:
                said = now
                log(f"waiting for {config.env.name} at {endpoint}: {error}.")
        time.sleep(TRY_SECONDS)
