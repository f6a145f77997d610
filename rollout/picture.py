"""One environment as a picture, drawn by matplotlib without a display.

What never changes (axes, legends, colour bars) is drawn once; every frame restores it, copies the plots' colours into
its pixels and draws the moving artists on top, which is several times faster than drawing the whole figure. Import
this module only when a picture is wanted.
"""

from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.collections import EllipseCollection, LineCollection, PathCollection
from matplotlib.colors import LinearSegmentedColormap, Normalize, to_rgba
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.path import Path
from matplotlib.text import Text
from matplotlib.textpath import TextPath
from numpy.typing import NDArray

from common.team import COLLECTION, COMMUNICATION, MONITORING, farm_team
from rollout.palette import AGE_MAP, COLOURS, END_MARKERS, LABELS, SENSOR_MARKERS, SOIL_STOPS, TYPES, shade
from rollout.scene import TRAIL_STEPS, Scene, camera_radius, radio_radius

Numbers = NDArray[np.float64]
Indices = NDArray[np.int64]

DPI: Final = 100
SIZE: Final = (10.4, 7.2)
"""Inches; even numbers of pixels, as video codecs want them."""
MAP: Final = (0.055, 0.075, 0.612, 0.884)
"""Left, bottom, width and height of the map, as shares of the figure."""
PANEL: Final = 0.705
"""Left edge of everything beside the map."""
SOIL: Final = LinearSegmentedColormap.from_list("soil", SOIL_STOPS)
INK: Final = "0.2"
SMALL: Final[dict[str, Any]] = {"fontsize": 8, "color": INK}
PIECE_STEPS: Final = 4
"""Steps of a trail that share one opacity."""
FULL: Final = 0.85
"""Opacity of a trail's newest end."""


class FarmPicture:
    """Draws scenes of one environment, whose farm may change from scene to scene.

    Args:
        scene: the first.
    """

    def __init__(self, scene: Scene) -> None:
        world = scene.config.world
        self._figure = Figure(figsize=SIZE, dpi=DPI)
        self._canvas = _make_canvas(self._figure)
        self._map = self._figure.add_axes(MAP)
        margin = 0.02 * max(world.field_x, world.field_y)
        self._map.set(xlim=(-margin, world.field_x + margin), ylim=(-margin, world.field_y + margin))
        self._map.set(aspect="equal", anchor="W")
        self._map.tick_params(labelsize=8, colors=INK)
        self._map.set_xlabel("x, m", **SMALL)
        self._map.set_ylabel("y, m", labelpad=1, **SMALL)
        self._circles = self._make_circles(scene)
        self._links = LineCollection([], colors="0.15", linewidths=1.1, linestyles=(0, (1.0, 1.6)), zorder=3)
        self._trails = LineCollection([], linewidths=2.0, capstyle="butt", joinstyle="round", zorder=3)
        self._map.add_collection(self._links)
        self._map.add_collection(self._trails)
        self._sensors = _make_sensors(self._map, scene)
        self._uavs, self._numbers = _make_uavs(self._map, scene)
        self._headline, self._readings = _make_readings(self._figure)
        self._course = _make_course(self._figure, scene)
        _make_scales(self._figure, scene)
        _make_legend(self._figure, scene)
        self._moving: tuple[Any, ...] = (
            *self._circles,
            self._links,
            self._trails,
            *self._sensors,
            *self._uavs,
            *self._numbers,
            self._headline,
            *self._readings.values(),
            *self._course,
        )
        for artist in self._moving:
            artist.set_animated(True)
        self._canvas.draw()
        self._background = self._canvas.copy_from_bbox(self._figure.bbox)
        self._pixels: NDArray[np.uint8] = np.asarray(self._canvas.buffer_rgba())
        self._plots = self._make_plots(scene)

    def draw(self, scene: Scene) -> NDArray[np.uint8]:
        """Return a scene as [H, W, 3] red, green and blue."""
        self._update(scene)
        self._canvas.restore_region(self._background)
        self._draw_plots(scene)
        for artist in self._moving:
            self._figure.draw_artist(artist)
        return self._pixels[..., :3].copy()

    def pixel(self, x: float, y: float) -> tuple[int, int]:
        """Return row and column of a place of the field in the picture."""
        right, up = self._map.transData.transform((x, y))
        return int(self._figure.bbox.height - 1 - int(up)), int(right)

    def _make_plots(self, scene: Scene) -> tuple[slice, slice, Indices, Indices]:
        """Return the map's rows and columns of pixels, and which plot each of them shows."""
        world = scene.config.world
        bottom, left = self.pixel(0.0, 0.0)
        top, right = self.pixel(world.field_x, world.field_y)
        rows, columns = slice(top, bottom + 1), slice(left, right + 1)
        height, width = rows.stop - rows.start, columns.stop - columns.start
        across = np.arange(width) * world.plots_x // width
        up = (np.arange(height) * world.plots_y // height)[::-1]
        return rows, columns, across, up

    def _draw_plots(self, scene: Scene) -> None:
        """Copy the plots' colours into the picture's pixels."""
        rows, columns, across, up = self._plots
        colours = np.full((*scene.vdf.shape, 4), 255, np.uint8)
        colours[..., :3] = shade(SOIL_STOPS, scene.vdf / scene.config.world.vdf_max)
        packed = colours.view(np.uint32)[..., 0].T
        self._pixels.view(np.uint32)[rows, columns, 0] = packed.take(up, axis=0).take(across, axis=1)

    def _make_circles(self, scene: Scene) -> list[EllipseCollection]:
        """Make the reach of cameras and of sensors' radios around the UAVs."""
        circles = []
        for name, radius in ((MONITORING, camera_radius(scene.config)), (COLLECTION, radio_radius(scene.config))):
            circle = EllipseCollection(
                2.0 * radius,
                2.0 * radius,
                0.0,
                units="xy",
                offsets=np.zeros((1, 2)),
                offset_transform=self._map.transData,
                facecolors=[to_rgba(COLOURS[name], 0.14)],
                edgecolors=[to_rgba(COLOURS[name], 0.9)],
                linewidths=0.9,
                zorder=2,
            )
            self._map.add_collection(circle)
            circles.append(circle)
        return circles

    def _update(self, scene: Scene) -> None:
        """Give every moving artist its present data."""
        slices = dict(zip(TYPES, farm_team(scene.config).agent_slices(), strict=True))
        for circle, name in zip(self._circles, (MONITORING, COLLECTION), strict=True):
            circle.set_offsets(scene.position[slices[name]])
        relays = slices[COMMUNICATION].stop
        self._links.set_segments([*np.stack([scene.position[scene.assignment], scene.position[relays:]], axis=1)])
        segments, colours = _trails(scene, slices)
        self._trails.set_segments(segments)
        self._trails.set_color(colours)
        for kind, sensors in enumerate(self._sensors):
            chosen = scene.layout.sensor_type == kind
            sensors.set_offsets(scene.layout.sensor_xy[chosen])
            sensors.set_array(scene.aoi[chosen])
        for uavs, name in zip(self._uavs, TYPES, strict=True):
            uavs.set_offsets(scene.position[slices[name]])
        for index, numbers in enumerate(self._numbers):
            wearers = [part.start + index for part in slices.values() if part.start + index < part.stop]
            numbers.set_offsets(scene.position[wearers])
        self._headline.set_text(scene.headline)
        for name, reading in self._readings.items():
            reading.set_text(_reading(scene, name))
        for line, values in zip(self._course, scene.course.T, strict=True):
            line.set_data(np.arange(len(values)), values)


def _make_canvas(figure: Figure) -> Any:
    """Return a canvas without a display; its methods are not typed."""
    return FigureCanvasAgg(figure)


def _trails(scene: Scene, slices: dict[str, slice]) -> tuple[list[Numbers], list[tuple[float, float, float, float]]]:
    """Return the trails' pieces, [k, 2] each, and their colours, which fade with age."""
    pieces: list[Numbers] = []
    colours: list[tuple[float, float, float, float]] = []
    last = len(scene.trail) - 1
    for name, part in slices.items():
        for newest in range(last, 0, -PIECE_STEPS):
            piece = scene.trail[max(0, newest - PIECE_STEPS) : newest + 1, part]
            faded = to_rgba(COLOURS[name], FULL * (1.0 - (last - newest) / TRAIL_STEPS))
            pieces += list(piece.swapaxes(0, 1))
            colours += [faded] * piece.shape[1]
    return pieces, colours


def _make_sensors(axes: Axes, scene: Scene) -> list[PathCollection]:
    world = scene.config.world
    return [
        axes.scatter(
            [],
            [],
            c=[],
            cmap=AGE_MAP,
            norm=Normalize(0.0, world.aoi_max),
            marker=SENSOR_MARKERS[kind % len(SENSOR_MARKERS)],
            s=17,
            linewidths=0.3,
            edgecolors="0.35",
            zorder=2.5,
        )
        for kind in range(len(world.sensor_cycles))
    ]


def _make_uavs(axes: Axes, scene: Scene) -> tuple[list[PathCollection], list[PathCollection]]:
    """Make a marker for each type, and for each number the sign of it inside the markers."""
    uavs = [
        axes.scatter(
            [], [], color=COLOURS[name], marker=END_MARKERS[name], s=230, linewidths=1.2, edgecolors="white", zorder=5
        )
        for name in TYPES
    ]
    most = max(group.count for group in farm_team(scene.config).groups)
    numbers = [
        axes.scatter([], [], color="white", marker=_digits(index), s=38 if index < 10 else 70, linewidths=0.3, zorder=6)
        for index in range(most)
    ]
    return uavs, numbers


def _digits(number: int) -> Path:
    """Return a number's outline as polygons, which are drawn faster than the curves of a font."""
    outline = TextPath((0.0, 0.0), str(number))
    centre = outline.get_extents().get_points().mean(axis=0)
    return Path.make_compound_path(*(Path(polygon - centre) for polygon in outline.to_polygons()))


def _make_readings(figure: Figure) -> tuple[Text, dict[str, Text]]:
    """Make the headline and the table of rewards, whose rows are the key to the UAVs' markers."""
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


def _make_scales(figure: Figure, scene: Scene) -> None:
    """Draw the colour bars of AoI and VDF."""
    world = scene.config.world
    bars = (
        (0.385, AGE_MAP, world.aoi_max, "AoI of a sensor"),
        (0.305, SOIL, world.vdf_max, "VDF of a plot"),
    )
    for bottom, colours, most, label in bars:
        axes = figure.add_axes((PANEL, bottom, 0.985 - PANEL, 0.018))
        mappable = ScalarMappable(Normalize(0.0, most), colours)
        bar = figure.colorbar(mappable, cax=axes, orientation="horizontal")
        bar.outline.set_linewidth(0.4)
        axes.tick_params(labelsize=7, colors=INK, length=2, pad=1)
        axes.set_title(label, loc="left", pad=2, **SMALL)


def _make_legend(figure: Figure, scene: Scene) -> None:
    """Draw what the map's other signs mean."""
    handles = [
        Line2D([], [], color="0.15", linestyle=(0, (1.0, 1.6)), label="relay and whom it serves"),
        Line2D([], [], color="0.4", linewidth=2.0, label=f"path of the last {TRAIL_STEPS} steps"),
        _ring(MONITORING, f"camera, {camera_radius(scene.config):.0f} m"),
        _ring(COLLECTION, f"half of all packets arrive, {radio_radius(scene.config):.0f} m"),
    ]
    for kind, cycle in enumerate(scene.config.world.sensor_cycles):
        marker = SENSOR_MARKERS[kind % len(SENSOR_MARKERS)]
        handles.append(
            Line2D([], [], color="0.45", marker=marker, markersize=5, linestyle="", label=f"sensor, every {cycle} s")
        )
    figure.legend(
        handles=handles,
        loc="upper left",
        bbox_to_anchor=(PANEL - 0.008, 0.272),
        fontsize=8,
        frameon=False,
        labelcolor=INK,
        borderaxespad=0.0,
        handlelength=1.8,
    )


def _ring(name: str, label: str) -> Line2D:
    return Line2D(
        [],
        [],
        marker="o",
        markersize=9,
        linestyle="",
        label=label,
        markerfacecolor=to_rgba(COLOURS[name], 0.14),
        markeredgecolor=COLOURS[name],
    )
