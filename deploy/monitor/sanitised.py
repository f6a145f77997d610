"""Other processes' metrics, made safe to add up and draw: one odd value must not end a view."""

import math
from collections.abc import Mapping
from typing import Any, Final

from eia_sec.common.errors import SchemaError
from eia_sec.common.text import printable

LARGEST: Final = 1e15
"""Largest number that a view shows."""
MOST_TEXT: Final = 400
"""Longest text, characters."""
MOST_PARTS: Final = 16_384
"""Most numbers, texts, maps and lists in one report."""
DEEPEST: Final = 6
"""Deepest nesting of maps and lists."""
NESTED: Final = 64
"""Deepest nesting of a report that is read at all."""
NUMBERS: Final = frozenset(
    (
        *("decisions", "elapsed", "environment_steps", "episodes", "episodes_total", "event", "lag_versions", "queue"),
        *(
            "spooled",
            "updates",
            "version",
            "waiting_seconds",
            "steps_total",
            "progress",
            "produced",
            "accepted",
            "rejected",
            "in_flight",
        ),
    )
)
"""Metrics that are added up, subtracted or drawn, and so must be numbers."""


def metrics(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return a process's metrics: finite numbers, printable texts, and lists and maps of them.

    Everything else, for example the NaN of a training that diverges, is left out of maps and None in lists.

    Raises:
        SchemaError: a metric that must be a number is not, or there are too many, or they are nested too deeply.
    """
    if _parts(values, MOST_PARTS, NESTED) < 0:
        raise SchemaError(f"a report has more than {MOST_PARTS} values, or more than {NESTED} levels.")
    found = {str(name): part for name, value in values.items() if (part := _metric(value, 0)) is not None}
    for name in NUMBERS & values.keys():
        if type(values[name]) not in (int, float):
            raise SchemaError(f"{name} is {type(values[name]).__name__}, not a number.")
    return found


def plain(text: str) -> str:
    """Return the beginning of a text, without control characters."""
    return printable(text[:MOST_TEXT])


def _parts(value: Any, room: int, levels: int) -> int:
    """Return the room left after counting all parts; negative as soon as there is none, or no level below."""
    if levels < 0:
        return -1
    room -= 1
    inner = value.values() if isinstance(value, Mapping) else value if isinstance(value, list) else ()
    for part in inner:
        if room < 0:
            return room
        room = _parts(part, room, levels - 1)
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
