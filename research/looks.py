"""How the laboratory's pictures draw what they compare: one colour, line and mark for one thing in all of them."""

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.colors import to_hex
from matplotlib.figure import Figure

from eia_sec.deploy.reports.plots import LINES, MARKS, OTHER_COLOURS, TEXT, look
from research.studies.methods import TRAINED

WIDTH: Final = 7.5
"""Inches; a page of about 700 pixels then shows letters of 9 points in 12 pixels."""
LEVEL: Final[dict[str, Any]] = {"color": "0.4", "linestyle": (0, (5, 3)), "linewidth": 1.0}
"""Lines at what something else earns, or at what would be proportional."""
PROGRAM_COLOURS: Final = {
    "EIA-SEC": OTHER_COLOURS[0],
    "EIA-SEC, team": "#332288",
    "AgileRL": "#882255",
    "BenchMARL": "#999933",
    "BenchMARL, groups": "#8C510A",
    "EIA-SEC, base": "#000000",
    "VMAS": "#9970AB",
    "mpe2": "#777777",
    "NumPy reference": "#DD7788",
}
"""Of programs and their forms; but for EIA-SEC's own, no algorithm has them."""


def algorithm_look(name: str) -> dict[str, Any]:
    """Return how an algorithm is drawn, as the study `training` draws it."""
    return look([method.name for method in TRAINED].index(name.upper()))


def program_look(software: str, form: str = "") -> dict[str, Any]:
    """Return how a program is drawn, or a form of it that has a look of its own."""
    names, name = list(PROGRAM_COLOURS), f"{software}, {form}"
    place = names.index(name if name in PROGRAM_COLOURS else software)
    # Past the last line, the first one has another mark.
    turn = place // len(LINES)
    return {
        "color": PROGRAM_COLOURS[names[place]],
        "linestyle": LINES[place % len(LINES)],
        "marker": MARKS[(place + turn) % len(MARKS)],
    }


def numbered_looks(count: int) -> list[dict[str, Any]]:
    """Return how things in an order are drawn, as seeds or numbers of workers: from dark to light, on lines in turn."""
    colours = colormaps["plasma"](np.linspace(0.0, 0.85, count))
    return [{"color": to_hex(colour), "linestyle": LINES[place % len(LINES)]} for place, colour in enumerate(colours)]


def heading(figure: Figure, text: str) -> None:
    """Write above all panels what was measured, on what."""
    figure.suptitle(text, x=0.01, ha="left", **TEXT)


def legend_below(figure: Figure, panels: Sequence[Axes], columns: int) -> None:
    """Write the legend of all panels below them, each name once."""
    drawn = [axes.get_legend_handles_labels() for axes in panels]
    named = {name: handle for handles, names in drawn for handle, name in zip(handles, names, strict=True)}
    figure.legend(
        list(named.values()),
        list(named),
        loc="outside lower center",
        ncols=columns,
        handlelength=3.2,
        frameon=False,
        **TEXT,
    )
