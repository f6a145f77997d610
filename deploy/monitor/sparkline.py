"""A series of numbers as one line of bars that fills its width."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from rich.console import Console, ConsoleOptions, RenderResult
from rich.measure import Measurement
from rich.text import Text

_BARS: Final = "▁▂▃▄▅▆▇█"
_ASCII_BARS: Final = "_.-=+*#@"
LEAST_BARS: Final = 6
"""Bars without which a scale says little."""


def buckets(values: Sequence[float], width: int) -> list[float]:
    """Return the means of at most `width` equal consecutive parts of a series; a shorter series comes back as it is."""
    count = min(width, len(values))
    edges = [round(index * len(values) / count) for index in range(count + 1)] if count else []
    return [sum(values[a:b]) / (b - a) for a, b in itertools.pairwise(edges)]


def bars(values: Sequence[float], width: int, *, ascii_only: bool = False) -> str:
    """Return a series as bars between its own smallest and largest bucket; a flat series lies in the middle."""
    heights = buckets(values, width)
    if not heights:
        return ""
    symbols = _ASCII_BARS if ascii_only else _BARS
    low, high = min(heights), max(heights)
    if high == low:
        return symbols[len(symbols) // 2 - 1] * len(heights)
    return "".join(symbols[round((height - low) / (high - low) * (len(symbols) - 1))] for height in heights)


@dataclass(frozen=True)
class Sparkline:
    """A rich renderable of a series, and the values of its lowest and its highest bar where there is room.

    Attributes:
        values: the series, oldest first.
        style: rich style of the bars.
        widest: most cells that it takes.
        digits: decimals of the two values.
    """

    values: tuple[float, ...]
    style: str = ""
    widest: int = 40
    digits: int = 0

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        width = min(options.max_width, self.widest)
        heights, low, high = buckets(self.values, width), "", ""
        if len(heights) > 1:
            # Fewer bars are means of more values, so the ends are those of the bars that are drawn.
            room = width - max(len(f"{value:,.{self.digits}f}") for value in (min(heights), max(heights))) * 2 - 3
            if room >= LEAST_BARS:
                heights = buckets(self.values, room)
                low, high = (f"{value:,.{self.digits}f}" for value in (min(heights), max(heights)))
                width = room
        drawn = bars(self.values, width, ascii_only=options.ascii_only)
        scale = f" {low}..{high}" if low else ""
        yield Text.assemble((drawn, self.style), (scale, "dim"), no_wrap=True)

    def __rich_measure__(self, console: Console, options: ConsoleOptions) -> Measurement:
        return Measurement(min(4, options.max_width), min(self.widest, options.max_width))
