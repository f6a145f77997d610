"""Environments that can be looked at: made with `render_mode="rgb_array"` where they take it."""

import inspect
import json
from collections.abc import Callable
from contextlib import ExitStack, closing
from dataclasses import replace
from typing import Any, Final

from eia_sec.common.config import EnvConfig
from eia_sec.common.errors import ContractError
from eia_sec.rollout.envs.guard import RENDER_SECONDS, Guard, calling, factory, for_watchers
from eia_sec.rollout.envs.pettingzoo_spec import Agents, describe

RENDER_MODE: Final = "render_mode"
PICTURES: Final = "rgb_array"
"""The mode in which `render()` returns a picture."""
MAKING_SECONDS: Final = 20.0
"""Time that each call may take with which an environment is made for pictures."""


def draws(environment: Guard) -> bool:
    """Return whether an environment was made to return pictures.

    Raises:
        EnvironmentFaultError: it raised something when it was asked.
    """
    with for_watchers(RENDER_SECONDS), calling(environment.name, RENDER_MODE):
        return bool(getattr(environment.wrapped, RENDER_MODE, None) == PICTURES)


def with_pictures(config: EnvConfig, attempt: Callable[[EnvConfig], Guard], like: Agents) -> Guard:
    """Return a new environment that returns pictures.

    Args:
        config: its name and arguments.
        attempt: makes it.
        like: the agents that it must have.

    Raises:
        ContractError: it takes no render_mode, does not heed it, or has other agents with it.
        ConfigError, EnvironmentFaultError, EnvironmentOutageError: it cannot be made with one, or not in time.
    """
    if config.served:
        raise ContractError(f"{config.name}: environments that others serve send no pictures.")
    if RENDER_MODE in config.keywords():
        raise ContractError(f"{config.name}: the run's arguments set {RENDER_MODE}, and not to {PICTURES}.")
    if not _takes(factory(config.name), RENDER_MODE):
        raise ContractError(f"{config.name} takes no {RENDER_MODE}.")
    keywords = {**config.keywords(), RENDER_MODE: PICTURES}
    with for_watchers(MAKING_SECONDS), ExitStack() as rejected:
        made = rejected.enter_context(closing(attempt(replace(config, arguments=json.dumps(keywords)))))
        if not draws(made):
            raise ContractError(f"{config.name} does not heed {RENDER_MODE}={PICTURES!r}.")
        found = describe(made, config.types)
        if (found.team, tuple(found.views), found.actions) != (like.team, tuple(like.views), like.actions):
            raise ContractError(f"{config.name} has other agents with {RENDER_MODE}={PICTURES!r}.")
        rejected.pop_all()
    return made


def _takes(make: Callable[..., Any], name: str) -> bool:
    """Return whether a callable takes an argument of that name, as far as can be seen."""
    try:
        parameters = inspect.signature(make).parameters.values()
    except (TypeError, ValueError):  # one without a signature, in C for instance
        return True
    return any(p.name == name or p.kind is p.VAR_KEYWORD for p in parameters)
