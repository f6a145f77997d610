"""One environment as a picture, drawn by matplotlib without a display.

The static background (axes, legends, colour bars) is drawn once. Every frame restores it, copies the plots' colours
into its pixels and draws the moving artists on top. That is several times faster than drawing the whole figure. This
module loads matplotlib, so import it only when you need a picture.
"""

from typing import Any, Final

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.text import Text
from numpy.typing import NDArray

from eia_sec.common.farm import COLLECTION, MONITORING
from eia_sec.rollout.rendering.farm_map import INK, SMALL, FarmMap, make_legend, make_scales
from eia_sec.rollout.rendering.palette import COLOURS, END_MARKERS, LABELS, TYPES
from eia_sec.rollout.rendering.scene import Scene

Numbers = NDArray[np.float64]
Indices = NDArray[np.int64]

DPI: Final = 100
SIZE: Final = (10.4, 7.2)
"""Inches. They give even numbers of pixels, which video codecs need."""
MAP: Final = (0.055, 0.075, 0.612, 0.884)
"""Left, bottom, width and height of the map, as fractions of the figure."""
PANEL: Final = 0.705
"""Left edge of everything beside the map."""


class FarmPicture:
    """Draws scenes of one environment. The farm may change from scene to scene.

    Args:
        scene: the first scene.
    """

    def __init__(self, scene: Scene) -> None:
        self._figure = Figure(figsize=SIZE, dpi=DPI)
        self._canvas = _make_canvas(self._figure)
        self._map = FarmMap(self._figure.add_axes(MAP), scene)
        self._headline, self._readings = _make_readings(self._figure)
        self._course = _make_course(self._figure, scene)
        make_scales(self._figure, scene, (PANEL, 0.985 - PANEL), (0.385, 0.305))
        make_legend(self._figure, scene, (PANEL - 0.008, 0.272))
        self._moving: tuple[Any, ...] = (
            *self._map.artists,
            self._headline,
            *self._readings.values(),
            *self._course,
        )
        for artist in self._moving:
            artist.set_animated(True)
        self._canvas.draw()
        self._background = self._canvas.copy_from_bbox(self._figure.bbox)
        self._pixels: NDArray[np.uint8] = np.asarray(self._canvas.buffer_rgba())

    def draw(self, scene: Scene) -> NDArray[np.uint8]:
        """Return a scene as an RGB image, [H, W, 3] uint8."""
        self._update(scene)
        self._canvas.restore_region(self._background)
        self._map.draw_plots(self._pixels, scene)
        for artist in self._moving:
            self._figure.draw_artist(artist)
        return self._pixels[..., :3].copy()

    def pixel(self, x: float, y: float) -> tuple[int, int]:
        """Return the picture's pixel row and column at field position (x, y), m."""
        return self._map.pixel(x, y)

    def _update(self, scene: Scene) -> None:
        """Update every moving artist from the scene."""
        self._map.update(scene)
        self._headline.set_text(scene.headline)
        for name, reading in self._readings.items():
            reading.set_text(_reading(scene, name))
        for line, values in zip(self._course, scene.course.T, strict=True):
            line.set_data(np.arange(len(values)), values)


def _make_canvas(figure: Figure) -> Any:
    """Return a canvas that needs no display. Its methods are untyped."""
    return FigureCanvasAgg(figure)


def _make_readings(figure: Figure) -> tuple[Text, dict[str, Text]]:
    """Make the headline and the table of rewards. The table's rows double as the legend of the UAV markers."""
    headline = figure.text(PANEL, 0.94, "", fontsize=12, weight="bold", color=INK)
    figure.text(0.985, 0.895, "reward", ha="right", **SMALL)
    readings = {}
    for row, name in enumerate((*TYPES, "mean")):
        y = 0.865 - 0.032 * row
        if name in TYPES:
            figure.add_artist(
                Line2D(
                    [PANEL + 0.012],
                    [y + 0.007],
                    marker=END_MARKERS[name],
                    color=COLOURS[name],
                    markersize=10,
                    markeredgecolor="white",
                    linestyle="",
                )
            )
        weight = "bold" if name == "mean" else "normal"
        figure.text(PANEL + 0.032, y, LABELS[name] + (" UAVs" if name in TYPES else ""), weight=weight, fontsize=9)
        readings[name] = figure.text(0.985, y, "", ha="right", weight=weight, fontsize=9)
    for row, name in enumerate(("aoi", "vdf")):
        readings[name] = figure.text(PANEL + 0.14 * row, 0.7, "", fontsize=9)
    return headline, readings


def _reading(scene: Scene, name: str) -> str:
    if name == "aoi":
        return f"mean AoI {scene.aoi.mean():.2f}"
    if name == "vdf":
        return f"mean VDF {scene.vdf.mean():.2f}"
    return f"{scene.reward[name]:.1f}".replace("-", "\N{MINUS SIGN}")


def _make_course(figure: Figure, scene: Scene) -> list[Line2D]:
    """Make the small chart of mean AoI and mean VDF over the episode."""
    world = scene.config.world
    axes = figure.add_axes((PANEL + 0.022, 0.5, 0.985 - PANEL - 0.022, 0.175))
    axes.set(xlim=(0, world.steps), ylim=(0, max(world.aoi_max, world.vdf_max)))
    axes.tick_params(labelsize=7, colors=INK, length=2)
    axes.grid(True, color="0.9")
    axes.spines[["top", "right"]].set_visible(False)
    axes.set_xlabel("step", labelpad=1, **SMALL)
    (aoi,) = axes.plot([], [], color=COLOURS[COLLECTION], linestyle="-.", linewidth=1.6, label="AoI")
    (vdf,) = axes.plot([], [], color=COLOURS[MONITORING], linewidth=1.6, label="VDF")
    axes.legend(handles=[aoi, vdf], loc="upper right", ncols=2, fontsize=8, frameon=False, borderaxespad=0.1)
    return [aoi, vdf]
