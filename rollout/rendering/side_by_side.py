"""Two policies on the same episode, side by side in one picture."""

from typing import Any, Final

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.text import Text
from numpy.typing import NDArray

from eia_sec.rollout.rendering.farm_map import INK, SMALL, FarmMap, make_legend, make_scales
from eia_sec.rollout.rendering.palette import COLOURS, END_MARKERS, LABELS, TYPES, LineStyle
from eia_sec.rollout.rendering.scene import Scene

DPI: Final = 100
SIZE: Final = (16.0, 9.0)
"""Inches. They give even numbers of pixels, which video codecs need."""
LEFTS: Final = (0.034, 0.448)
"""Left edges of both maps, as fractions of the figure."""
SIDE: Final = (0.3825, 0.68)
"""Width and height of a map: 612 pixels each."""
BOTTOM: Final = 0.245
PANEL: Final = 0.852
"""Left edge of the legend."""
LINES: Final[tuple[tuple[str, LineStyle, float], ...]] = (("#000000", "-", 2.0), ("#8A8A8A", "--", 1.8))
"""Colour, style and width of each policy's curves."""
CHARTS: Final = (("reward", "reward per agent so far"), ("aoi", "mean AoI, units"), ("vdf", "mean VDF, units"))


class SideBySidePicture:
    """Draws scenes of two environments that fly the same episode under two policies.

    Args:
        names: names of the policies.
        scenes: the first scene of each.
    """

    def __init__(self, names: tuple[str, str], scenes: tuple[Scene, Scene]) -> None:
        self._figure = Figure(figsize=SIZE, dpi=DPI)
        self._canvas = _make_canvas(self._figure)
        self._maps = [
            FarmMap(self._figure.add_axes((left, BOTTOM, *SIDE)), scene)
            for left, scene in zip(LEFTS, scenes, strict=True)
        ]
        self._headline = self._figure.text(PANEL, 0.97, "", fontsize=11, weight="bold", color=INK)
        self._scores = [self._make_title(name, left) for name, left in zip(names, LEFTS, strict=True)]
        self._reward: NDArray[np.float64] = np.full((2, scenes[0].config.world.steps + 1), np.nan)
        self._lines = [self._make_chart(place, scenes[0]) for place in range(len(CHARTS))]
        self._make_key(names, scenes[0])
        self._moving: tuple[Any, ...] = (
            *(artist for drawn in self._maps for artist in drawn.artists),
            self._headline,
            *(score for scores in self._scores for score in scores.values()),
            self._lines[0][0].axes,  # the whole chart, because its scale grows
            *(line for lines in self._lines[1:] for line in lines),
        )
        for artist in self._moving:
            artist.set_animated(True)
        self._canvas.draw()
        self._background = self._canvas.copy_from_bbox(self._figure.bbox)
        self._pixels: NDArray[np.uint8] = np.asarray(self._canvas.buffer_rgba())

    @property
    def size(self) -> tuple[int, int]:
        """Width and height, pixels."""
        height, width = self._pixels.shape[:2]
        return width, height

    def note(self, scenes: tuple[Scene, Scene]) -> None:
        """Record a step for the charts. Call it for every step, drawn or not."""
        for which, scene in enumerate(scenes):
            self._reward[which, scene.step] = scene.reward["mean"]

    def draw(self, scenes: tuple[Scene, Scene]) -> NDArray[np.uint8]:
        """Return both scenes as one RGB image, [H, W, 3] uint8."""
        self._update(scenes)
        self._canvas.restore_region(self._background)
        for drawn, scene in zip(self._maps, scenes, strict=True):
            drawn.draw_plots(self._pixels, scene)
        for artist in self._moving:
            self._figure.draw_artist(artist)
        return self._pixels[..., :3].copy()

    def _update(self, scenes: tuple[Scene, Scene]) -> None:
        self._headline.set_text(scenes[0].headline)
        for which, scene in enumerate(scenes):
            self._maps[which].update(scene)
            for name, score in self._scores[which].items():
                score.set_text(f"{scene.reward[name]:.0f}".replace("-", "\N{MINUS SIGN}"))
            steps = np.arange(scene.step + 1)
            curves = (self._reward[which, : scene.step + 1], *scene.course.T)
            for lines, values in zip(self._lines, curves, strict=True):
                lines[which].set_data(steps, values)
        self._rescale()

    def _rescale(self) -> None:
        """Grow the reward chart's scale to fit the rewards."""
        axes = self._lines[0][0].axes
        assert axes is not None
        low, high = float(np.nanmin(self._reward)), float(np.nanmax(self._reward))
        axes.set_ylim(-_rounded(-low), max(_rounded(high), 10.0))

    def _make_title(self, name: str, left: float) -> dict[str, Text]:
        """Write a policy's name over its map, and make the texts of its rewards beside the types' markers."""
        figure, y = self._figure, 0.951
        figure.text(left, y + 0.019, name, fontsize=13, weight="bold", color=INK)
        figure.text(left, y - 0.009, "reward per agent so far", fontsize=9, color=INK)
        scores = {}
        for place, kind in enumerate(("mean", *TYPES)):
            x = left + 0.105 + 0.07 * place
            if kind in TYPES:
                figure.add_artist(
                    Line2D([x], [y - 0.003], marker=END_MARKERS[kind], color=COLOURS[kind], markersize=9, linestyle="")
                )
            else:
                figure.text(x - 0.004, y - 0.009, "all", fontsize=9, color=INK)
            weight = "bold" if kind == "mean" else "normal"
            scores[kind] = figure.text(x + 0.012, y - 0.01, "", fontsize=11, weight=weight, color=INK)
        return scores

    def _make_chart(self, place: int, scene: Scene) -> list[Line2D]:
        """Make one of the charts under the maps, with a line for each policy."""
        world, (what, label) = scene.config.world, CHARTS[place]
        axes = self._figure.add_axes((0.034 + 0.2785 * place, 0.052, 0.2395, 0.115))
        axes.set(xlim=(0, world.steps), ylim=(0, {"aoi": world.aoi_max, "vdf": world.vdf_max, "reward": 1.0}[what]))
        axes.tick_params(labelsize=8, colors=INK, length=2)
        axes.grid(True, color="0.9")
        axes.spines[["top", "right"]].set_visible(False)
        axes.set_xlabel("step", labelpad=1, **SMALL)
        axes.set_title(label, loc="left", pad=3, fontsize=9, color=INK)
        return [axes.plot([], [], color=colour, linestyle=style, linewidth=width)[0] for colour, style, width in LINES]

    def _make_key(self, names: tuple[str, str], scene: Scene) -> None:
        """Draw the legend: types, scales, symbols and the policies' lines."""
        for row, kind in enumerate(TYPES):
            y = 0.905 - 0.03 * row
            self._figure.add_artist(
                Line2D([PANEL + 0.007], [y + 0.006], marker=END_MARKERS[kind], color=COLOURS[kind], markersize=10)
            )
            self._figure.text(PANEL + 0.02, y, f"{LABELS[kind]} UAVs", fontsize=9, color=INK)
        make_scales(self._figure, scene, (PANEL, 0.985 - PANEL), (0.765, 0.685))
        make_legend(self._figure, scene, (PANEL - 0.006, 0.64))
        handles = [
            Line2D([], [], color=colour, linestyle=style, linewidth=width, label=name)
            for name, (colour, style, width) in zip(names, LINES, strict=True)
        ]
        self._figure.legend(
            handles=handles,
            loc="upper left",
            bbox_to_anchor=(PANEL - 0.006, 0.185),
            fontsize=9,
            frameon=False,
            labelcolor=INK,
            borderaxespad=0.0,
            handlelength=2.6,
        )


def _rounded(value: float) -> float:
    """Round up to 1, 2, 3, 5, 7.5 or 10 times a power of ten; return 0 unless the value is positive."""
    if value <= 0.0:
        return 0.0
    power = 10.0 ** np.floor(np.log10(value))
    return float(next(step * power for step in (1.0, 2.0, 3.0, 5.0, 7.5, 10.0, 20.0) if step * power >= value))


def _make_canvas(figure: Figure) -> Any:
    """Return a canvas that needs no display. Its methods are untyped."""
    return FigureCanvasAgg(figure)
