"""No-fly zones, areas of stress, charging stations and the wind in matplotlib pictures."""

import math
from typing import Any, Final

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import PathCollection, PolyCollection
from matplotlib.colors import to_rgba
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import NDArray

from eia_sec.common.config import FarmConfig
from eia_sec.rollout.rendering.palette import STRESS, ZONE
from eia_sec.rollout.rendering.scene import wind_text
from eia_sec.rollout.sim.layout import Layout
from eia_sec.rollout.sim.stations import station_places

Array = NDArray[np.float64]

CALM: Final = 0.05
"""Wind speed below which none is shown, m/s; it would read as 0.0."""
LONGEST: Final = 0.48
"""Length of the longest arrow, inches: as long in a picture of many pixels as in one of few."""
SHORTEST: Final = 0.24
"""Length of the shortest arrow, inches: its direction can still be seen."""
INK: Final = "0.1"
STATION: Final = "H"
"""Matplotlib's marker of a charging station, a hexagon."""


def make_zones(axes: Axes) -> PolyCollection:
    """Return the artist of the no-fly zones, none yet."""
    zones = PolyCollection([], facecolors=[to_rgba(ZONE, 0.16)], edgecolors=ZONE, linewidths=1.4, hatch="///", zorder=2)
    axes.add_collection(zones)
    return zones


def make_areas(axes: Axes, config: FarmConfig) -> PolyCollection:
    """Return the artist of the areas in which counters rise faster."""
    outlines = [np.array(corners) for _, corners in config.stress.faster]
    areas = PolyCollection(outlines, facecolors="none", edgecolors=to_rgba(STRESS, 0.85), linewidths=1.8, zorder=2)
    axes.add_collection(areas)
    return areas


def make_stations(axes: Axes, config: FarmConfig) -> PathCollection:
    """Return the artist of the charging stations, which stay."""
    x, y = station_places(config).T
    return axes.scatter(x, y, marker=STATION, s=320, facecolors="none", edgecolors=INK, linewidths=1.4, zorder=2.2)


def draw_outlines(axes: Axes, config: FarmConfig, layout: Layout) -> None:
    """Draw what a farm has of no-fly zones, areas in which counters rise faster, and stations; with labels."""
    if layout.zones:
        zones = make_zones(axes)
        zones.set_verts([*layout.zones])
        zones.set_label("no-fly zone")
    if config.stress.faster:
        make_areas(axes, config).set_label("area of faster growth")
    if config.battery.some:
        make_stations(axes, config).set_label("charging station")


def station_handle(label: str) -> Line2D:
    """Return the symbol of a charging station for a legend."""
    handle = Line2D([], [], marker=STATION, markersize=9, linestyle="", label=label)
    handle.set(markerfacecolor="none", markeredgecolor=INK, markeredgewidth=1.4)
    return handle


def area_handle() -> Patch:
    """Return the symbol of an area in which counters rise faster, for a legend."""
    return Patch(facecolor="none", edgecolor=STRESS, linewidth=1.8, label="area of faster growth")


def zone_handle() -> Patch:
    """Return the symbol of a no-fly zone for a legend."""
    return Patch(facecolor=to_rgba(ZONE, 0.16), edgecolor=ZONE, hatch="///", label="no-fly zone")


def outline_handles(config: FarmConfig) -> list[Artist]:
    """Return the symbols of what `draw_outlines` draws, for a legend."""
    handles: list[Artist] = [station_handle("charging station")] if config.battery.some else []
    handles += [area_handle()] if config.stress.faster else []
    handles += [zone_handle()] if config.zones.some else []
    return handles


class WindArrow:
    """The wind as an arrow beside its speed, in a map's upper left corner.

    Args:
        axes: the map.
        top: wind speed of the longest arrow, m/s.

    Attributes:
        artists: what is drawn.
    """

    def __init__(self, axes: Axes, top: float) -> None:
        self._top = top
        self._arrow = axes.quiver(
            [0.055],
            [0.945],
            [0.0],
            [0.0],
            transform=axes.transAxes,
            units="inches",
            scale_units="inches",
            scale=1.0,
            width=0.04,
            pivot="middle",
            color=INK,
            edgecolor="white",
            linewidth=0.8,
            zorder=7,
        )
        self._text = axes.text(
            0.105,
            0.945,
            "",
            transform=axes.transAxes,
            fontsize=9,
            color=INK,
            va="center",
            bbox={"boxstyle": "round,pad=0.2", "facecolor": "white", "edgecolor": "none", "alpha": 0.8},
            zorder=7,
        )
        self.artists: tuple[Any, ...] = self._arrow, self._text

    def update(self, wind: Array) -> None:
        """Show a wind, [2] m/s."""
        speed = math.hypot(*wind)
        for artist in self.artists:
            artist.set_visible(speed >= CALM)
        length = SHORTEST + (LONGEST - SHORTEST) * min(speed / self._top, 1.0)
        along = wind * (length / speed if speed else 0.0)
        self._arrow.set_UVC([along[0]], [along[1]])
        self._text.set_text(wind_text(wind))
