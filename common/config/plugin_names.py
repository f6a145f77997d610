"""The names of a run's plug-ins, and which of them this process was told to load."""

from typing import Final

from eia_sec.common.errors import ConfigError

LOADED: Final[list[str]] = []
"""Plug-ins that this process has loaded, see `eia_sec.common.plugins`."""


class PluginNames(tuple[str, ...]):
    """Names of plug-ins."""

    __slots__ = ()


NO_PLUGINS: Final = PluginNames()


def require_loaded(names: object) -> None:
    """Refuse a configuration whose plug-ins this process was not told to load.

    A plug-in runs its code, and a configuration may be somebody else's.

    Raises:
        ConfigError: a plug-in is not loaded.
    """
    for name in names if isinstance(names, list | tuple) else ():
        if name not in LOADED:
            shown = str(name)[:80]
            raise ConfigError(f"this run uses the plug-in {shown}; add --plugin {shown} to run its code.")
