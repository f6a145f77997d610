"""What others tell of themselves, made safe to add up and to draw: a view must not end over one odd figure."""

import math
from collections.abc import Mapping
from typing import Any, Final

from common.errors import SchemaError
from common.text import printable

LARGEST: Final = 1e15
"""Numbers beyond it are none that a view shows."""
MOST_TEXT: Final = 400
"""Most characters of a text."""
MOST_PARTS: Final = 16_384
"""Most numbers, texts, maps and lists of one report."""
DEEPEST: Final = 6
"""Maps and lists inside one another."""
NUMBERS: Final = frozenset(
    (
        *("decisions", "elapsed", "environment_steps", "episodes", "episodes_total", "event", "lag_versions", "queue"),
        *("spooled", "updates", "version", "waiting_seconds", "produced", "accepted", "rejected", "in_flight"),
    )
)
"""Figures of a process itself that are added up, subtracted or drawn."""


def metrics(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return a process's figures: whole and finite numbers, texts that print, and lists and maps of them.

    Numbers that are not finite, which a training that diverges tells, and whatever is none of these are left out of
    maps, and None in lists.

    Raises:
        SchemaError: a figure that has to be a number is none, or there are too many.
    """
    if _parts(values, MOST_PARTS) < 0:
        raise SchemaError(f"there are more than {MOST_PARTS} figures.")
    found = {str(name): part for name, value in values.items() if (part := _metric(value, 0)) is not None}
    for name in NUMBERS & values.keys():
        if type(values[name]) not in (int, float):
            raise SchemaError(f"{name} is {type(values[name]).__name__}, not a number.")
    return found


def plain(text: str) -> str:
    """Return a text without what a terminal would obey."""
    return printable(text[:MOST_TEXT])


def _parts(value: Any, room: int) -> int:
    """Return how much of the room is left when all parts are counted; below 0 as soon as there is none."""
    room -= 1
    inner = value.values() if isinstance(value, Mapping) else value if isinstance(value, list) else ()
    for part in inner:
        if room < 0:
            return room
        room = _parts(part, room)
    return room


def _metric(value: Any, depth: int) -> Any:
    if isinstance(value, str):
        return plain(value)
    if isinstance(value, int | float):
        return value if math.isfinite(value) and abs(value) <= LARGEST else None
    if depth < DEEPEST and isinstance(value, list):
        return [_metric(part, depth + 1) for part in value]
    if depth < DEEPEST and isinstance(value, dict):
        parts = {plain(str(name)): _metric(part, depth + 1) for name, part in value.items()}
        return {name: part for name, part in parts.items() if part is not None}
    return None
