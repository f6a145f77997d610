"""Options that are maps, such as numbers by type of agent: `[algorithm.discounts]` in a file."""

from collections.abc import Iterator, Mapping
from dataclasses import fields, replace
from typing import Any, Generic, TypeVar

from eia_sec.common.config.checks import within
from eia_sec.common.errors import ConfigError
from eia_sec.common.names import is_name

S = TypeVar("S")
V = TypeVar("V")


class FrozenMap(Mapping[str, V], Generic[V]):
    """A map that cannot change, so that a frozen configuration can hold it. Its keys are sorted.

    Args:
        entries: the map.
    """

    __slots__ = ("_entries",)

    def __init__(self, entries: Mapping[str, V] | None = None) -> None:
        self._entries = dict(sorted((entries or {}).items()))

    def __getitem__(self, key: str) -> V:
        """Return the value of a key."""
        return self._entries[key]

    def __iter__(self) -> Iterator[str]:
        """Yield the keys in order."""
        return iter(self._entries)

    def __len__(self) -> int:
        """Return the number of entries."""
        return len(self._entries)

    def __hash__(self) -> int:
        """Return a number that equal maps share."""
        return hash(tuple(self._entries.items()))

    def __repr__(self) -> str:
        """Return the call that makes this map."""
        return f"FrozenMap({self._entries!r})"


def freeze(section: Any, *options: str) -> None:
    """Replace maps of a frozen dataclass by ones that cannot change, while it is made.

    Raises:
        ConfigError: one is no map, or a key cannot be a name.
    """
    for option in options:
        entries = getattr(section, option)
        if not isinstance(entries, Mapping):
            raise ConfigError(f"{option} must be a map, not {entries!r:.80}.")
        for key in entries:
            if not is_name(key):
                raise ConfigError(f"{option} names {key[:80]!r}; a name is 1 to 63 letters, digits, '.', '_' or '-'.")
        object.__setattr__(section, option, FrozenMap(entries))


def within_each(low: float, high: float, **maps: Mapping[str, float]) -> None:
    """Raise ConfigError unless every value of every map lies in the closed interval from low to high."""
    for option, entries in maps.items():
        within(low, high, **{f"{option}.{key}": value for key, value in entries.items()})


def without_entries(section: S) -> S:
    """Return a section of a configuration whose maps are empty."""
    held: Any = section
    maps = [field.name for field in fields(held) if isinstance(getattr(held, field.name), Mapping)]
    emptied: S = replace(held, **{name: FrozenMap() for name in maps}) if maps else section
    return emptied
