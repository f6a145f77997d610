"""The options by which a command line names the code that a run may execute: `--plugin` and `--env`.

A configuration names both, and does not suffice: it may be somebody else's.
"""

from eia_sec.common.config import RunConfig


def plugin_options(config: RunConfig) -> list[str]:
    """Return the words that name a run's plug-ins."""
    return [word for name in config.plugins for word in ("--plugin", name)]


def env_options(config: RunConfig) -> list[str]:
    """Return the words that name a run's environment; none where it is one of this package."""
    return ["--env", config.env.name] if config.env.is_third_party else []


def code_options(config: RunConfig) -> list[str]:
    """Return both."""
    return [*plugin_options(config), *env_options(config)]
