"""The farm's map in a matplotlib picture: plots, sensors, reach, trails, links and UAVs.

Every animated picture of a farm contains one or more of these maps; the caller adds the rest of the figure.
"""

from typing import Any, Final

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import EllipseCollection, LineCollection, PathCollection
from matplotlib.colors import LinearSegmentedColormap, Normalize, to_rgba
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.path import Path
from matplotlib.textpath import TextPath
from numpy.typing import NDArray

from eia_sec.common.farm import COLLECTION, COMMUNICATION, MONITORING, farm_team
from eia_sec.rollout.rendering.airspace import (
    WindArrow,
    area_handle,
    make_areas,
    make_stations,
    make_zones,
    station_handle,
    zone_handle,
)
from eia_sec.rollout.rendering.chain import ChainLines, chain_handles
from eia_sec.rollout.rendering.palette import (
    AGE_MAP,
    COLOURS,
    END_MARKERS,
    LINK_DOWN,
    SENSOR_MARKERS,
    SOIL_STOPS,
    STRESS,
    TYPES,
    shade,
)
from eia_sec.rollout.rendering.scene import TRAIL_STEPS, Scene, camera_radius, radio_radius

Numbers = NDArray[np.float64]
Indices = NDArray[np.int64]

SOIL: Final = LinearSegmentedColormap.from_list("soil", SOIL_STOPS)
INK: Final = "0.2"
SMALL: Final[dict[str, Any]] = {"fontsize": 8, "color": INK}
PIECE_STEPS: Final = 4
"""Steps of a trail that share one opacity."""
FULL: Final = 0.85
"""Opacity of a trail's newest end."""
FAINT: Final = 0.3
"""Opacity of what is gone, or is not known."""
UP: Final = "0.15"
"""Colour of links that are up."""
DOTTED: Final = (0, (1.0, 1.6))
_WIDE, _FAR = 0.5, 1.0
BROAD_PLUS: Final = Path(
    [
        *((_FAR, -_WIDE), (_FAR, _WIDE), (_WIDE, _WIDE), (_WIDE, _FAR), (-_WIDE, _FAR), (-_WIDE, _WIDE)),
        *((-_FAR, _WIDE), (-_FAR, -_WIDE), (-_WIDE, -_WIDE), (-_WIDE, -_FAR), (_WIDE, -_FAR), (_WIDE, -_WIDE)),
        (_FAR, -_WIDE),
    ],
    closed=True,
)
"""A relay's marker, with arms that a number fits into."""


class FarmMap:
    """Draws scenes of one environment into axes. The farm may change from scene to scene.

    Args:
        axes: the axes to draw into.
        scene: the first scene.

    Attributes:
        artists: the moving artists; draw them over the plots in this order.
    """

    def __init__(self, axes: Axes, scene: Scene) -> None:
        world = scene.config.world
        self._map = axes
        margin = 0.02 * max(world.field_x, world.field_y)
        axes.set(xlim=(-margin, world.field_x + margin), ylim=(-margin, world.field_y + margin))
        axes.set(aspect="equal", anchor="W")
        axes.tick_params(labelsize=8, colors=INK)
        axes.set_xlabel("x, m", **SMALL)
        axes.set_ylabel("y, m", labelpad=1, **SMALL)
        self._zones, self._areas = make_zones(axes), make_areas(axes, scene.config)
        self._wind = WindArrow(axes, max(world.speed_x_max, world.speed_y_max))
        self._circles = self._make_circles(scene)
        self._links = LineCollection([], linewidths=1.1, linestyles=DOTTED, zorder=3)
        self._chain = ChainLines(axes, scene.config)
        self._stress = _make_ellipses(axes, scene.config.stress.radius, "none", STRESS, 1.8)
        self._batteries = _make_batteries(axes) if scene.config.battery.some else []
        stations = [make_stations(axes, scene.config)] if scene.config.battery.some else []
        self._trails = LineCollection([], linewidths=2.0, capstyle="butt", joinstyle="round", zorder=3)
        axes.add_collection(self._links)
        axes.add_collection(self._trails)
        self._sensors = _make_sensors(axes, scene)
        self._uavs, self._numbers = _make_uavs(axes, scene)
        self._plots: tuple[slice, slice, Indices, Indices] | None = None
        self.artists: tuple[Any, ...] = (
            self._zones,
            *([self._areas] if scene.config.stress.faster else []),
            *self._circles,
            *stations,
            *([self._stress] if scene.config.stress.patches else []),
            *self._chain.artists,
            self._links,
            self._trails,
            *self._sensors,
            *self._uavs,
            *self._numbers,
            *self._batteries,
            *self._wind.artists,
        )

    def pixel(self, x: float, y: float) -> tuple[int, int]:
        """Return the picture's pixel row and column at field position (x, y), m."""
        right, up = self._map.transData.transform((x, y))
        return int(self._map.figure.bbox.height - 1 - int(up)), int(right)

    def update(self, scene: Scene) -> None:
        """Update every moving artist from the scene."""
        self._zones.set_verts([*scene.layout.zones])
        self._wind.update(scene.wind)
        self._chain.update(scene)
        slices = dict(zip(TYPES, farm_team(scene.config).agent_slices(), strict=True))
        for circle, name in zip(self._circles, (MONITORING, COLLECTION), strict=True):
            circle.set_offsets(scene.position[slices[name]][~scene.gone[slices[name]]])
        relays = slices[COMMUNICATION].stop
        linked = scene.assignment >= 0
        ends = [scene.position[scene.assignment[linked]], scene.position[relays:][linked]]
        self._links.set_segments([*np.stack(ends, axis=1)])
        self._links.set_color([UP if up else LINK_DOWN for up in scene.linked[linked]])
        self._stress.set_offsets(scene.stress)
        self._stress.set_edgecolor([to_rgba(STRESS, FULL if known else FAINT) for known in scene.known])
        for bars, share in zip(self._batteries, (np.ones_like(scene.charge), scene.charge), strict=False):
            bars.set_segments(_bars(scene, share))
        segments, colours = _trails(scene, slices)
        self._trails.set_segments(segments)
        self._trails.set_color(colours)
        for kind, sensors in enumerate(self._sensors):
            chosen = scene.layout.sensor_type == kind
            sensors.set_offsets(scene.layout.sensor_xy[chosen])
            sensors.set_array(scene.aoi[chosen])
        for uavs, name in zip(self._uavs, TYPES, strict=True):
            uavs.set_offsets(scene.position[slices[name]])
            uavs.set_alpha([FAINT if gone else 1.0 for gone in scene.gone[slices[name]]])
        for index, numbers in enumerate(self._numbers):
            wearers = [part.start + index for part in slices.values() if part.start + index < part.stop]
            numbers.set_offsets(scene.position[wearers])

    def _make_plots(self, scene: Scene) -> tuple[slice, slice, Indices, Indices]:
        """Return the map's pixel rows and columns, and the plot that each of them shows."""
        world = scene.config.world
        bottom, left = self.pixel(0.0, 0.0)
        top, right = self.pixel(world.field_x, world.field_y)
        rows, columns = slice(top, bottom + 1), slice(left, right + 1)
        height, width = rows.stop - rows.start, columns.stop - columns.start
        across = np.arange(width) * world.plots_x // width
        up = (np.arange(height) * world.plots_y // height)[::-1]
        return rows, columns, across, up

    def draw_plots(self, pixels: NDArray[np.uint8], scene: Scene) -> None:
        """Copy the plots' colours into the pixels [H, W, 4]. Draw the figure first: its layout must be final."""
        self._plots = self._plots or self._make_plots(scene)
        rows, columns, across, up = self._plots
        colours = np.full((*scene.vdf.shape, 4), 255, np.uint8)
        colours[..., :3] = shade(SOIL_STOPS, scene.vdf / scene.config.world.vdf_max)
        packed = colours.view(np.uint32)[..., 0].T
        pixels.view(np.uint32)[rows, columns, 0] = packed.take(up, axis=0).take(across, axis=1)

    def _make_circles(self, scene: Scene) -> list[EllipseCollection]:
        """Make the circles that show how far cameras and sensor radios reach."""
        circles = []
        for name, radius in ((MONITORING, camera_radius(scene.config)), (COLLECTION, radio_radius(scene.config))):
            circle = _make_ellipses(self._map, radius, to_rgba(COLOURS[name], 0.14), to_rgba(COLOURS[name], 0.9), 0.9)
            circles.append(circle)
        return circles


def _make_ellipses(axes: Axes, radius: float, face: Any, edge: Any, width: float) -> EllipseCollection:
    """Make circles of one radius in m, and add them to the axes."""
    circles = EllipseCollection(
        2.0 * radius,
        2.0 * radius,
        0.0,
        units="xy",
        offsets=np.zeros((0, 2)),
        offset_transform=axes.transData,
        facecolors=[face],
        edgecolors=[edge],
        linewidths=width,
        zorder=2,
    )
    axes.add_collection(circles)
    return circles


def _make_batteries(axes: Axes) -> list[LineCollection]:
    """Make the bars for the capacity and the charge of each UAV."""
    bars = [LineCollection([], colors=colour, linewidths=3.0, capstyle="butt", zorder=7) for colour in ("white", INK)]
    for bar in bars:
        axes.add_collection(bar)
    return bars


def _bars(scene: Scene, share: Numbers) -> list[Numbers]:
    """Return a bar under each UAV that is not gone, [2, 2] m; a share of 1 is as wide as a UAV's marker."""
    world, left = scene.config.world, ~scene.gone
    width, below = 0.036 * world.field_x, 0.028 * world.field_y
    start = scene.position[left] - (0.5 * width, below)
    end = start + np.stack([width * share[left], np.zeros(int(left.sum()))], axis=1)
    return [*np.stack([start, end], axis=1)]


def _trails(scene: Scene, slices: dict[str, slice]) -> tuple[list[Numbers], list[tuple[float, float, float, float]]]:
    """Return the pieces of the trails, [k, 2] each, and their colours. Older pieces are fainter."""
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
    """Make a marker for each type, and the digits drawn inside the markers for each UAV number."""
    uavs = [
        axes.scatter(
            [],
            [],
            color=COLOURS[name],
            marker=BROAD_PLUS if name == COMMUNICATION else END_MARKERS[name],
            s=320 if name == COMMUNICATION else 230,
            linewidths=1.2,
            edgecolors="white",
            zorder=5,
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
    """Return a number's outline as polygons, which draw faster than a font's curves."""
    outline = TextPath((0.0, 0.0), str(number))
    centre = outline.get_extents().get_points().mean(axis=0)
    return Path.make_compound_path(*(Path(polygon - centre) for polygon in outline.to_polygons()))


def make_scales(figure: Figure, scene: Scene, across: tuple[float, float], bottoms: tuple[float, float]) -> None:
    """Draw the colour bars of AoI and VDF.

    Args:
        figure: the figure to draw into.
        scene: a scene of the farm.
        across: left edge and width of both bars, as fractions of the figure.
        bottoms: lower edge of each bar, as fractions of the figure.
    """
    world = scene.config.world
    bars = (
        (bottoms[0], AGE_MAP, world.aoi_max, "AoI of a sensor, units"),
        (bottoms[1], SOIL, world.vdf_max, "VDF of a plot, units"),
    )
    for bottom, colours, most, label in bars:
        axes = figure.add_axes((across[0], bottom, across[1], 0.018))
        mappable = ScalarMappable(Normalize(0.0, most), colours)
        bar = figure.colorbar(mappable, cax=axes, orientation="horizontal")
        bar.outline.set_linewidth(0.4)
        axes.tick_params(labelsize=7, colors=INK, length=2, pad=1)
        axes.set_title(label, loc="left", pad=2, **SMALL)


def make_legend(figure: Figure, scene: Scene, corner: tuple[float, float]) -> None:
    """Draw the legend of the map's other symbols, with its upper left corner at `corner` of the figure."""
    handles: list[Artist] = [
        Line2D([], [], color=UP, linestyle=DOTTED, label="relay and whom it serves"),
        Line2D([], [], color="0.4", linewidth=2.0, label=f"path of the last {TRAIL_STEPS} steps"),
        _ring(MONITORING, f"camera, {camera_radius(scene.config):.0f} m"),
        _ring(COLLECTION, f"half of all packets arrive, {radio_radius(scene.config):.0f} m"),
    ]
    handles += _events(scene)
    for kind, cycle in enumerate(scene.config.world.sensor_cycles):
        marker = SENSOR_MARKERS[kind % len(SENSOR_MARKERS)]
        handles.append(
            Line2D([], [], color="0.45", marker=marker, markersize=5, linestyle="", label=f"sensor, every {cycle} s")
        )
    figure.legend(
        handles=handles,
        loc="upper left",
        bbox_to_anchor=corner,
        fontsize=8,
        frameon=False,
        labelcolor=INK,
        borderaxespad=0.0,
        handlelength=1.8,
    )


def _events(scene: Scene) -> list[Artist]:
    """Return the symbols of what not every farm has: links that are down, chains, stations, stress, no-fly zones."""
    handles: list[Artist] = []
    if scene.config.relay.require_link:
        down = "link out of range, or without hops" if scene.config.relay.chained else "link out of range"
        handles.append(Line2D([], [], color=LINK_DOWN, linestyle=DOTTED, label=down))
    handles += chain_handles(scene.config)
    if scene.config.battery.some:
        handles.append(station_handle("charging station; bar: charge"))
    if scene.config.stress.faster:
        handles.append(area_handle())
    if scene.config.stress.patches:
        patch = Line2D([], [], marker="o", markersize=9, linestyle="", label="patch of stress; faint: not known")
        patch.set(markerfacecolor="none", markeredgecolor=STRESS, markeredgewidth=1.8)
        handles.append(patch)
    if scene.config.zones.some:
        handles.append(zone_handle())
    return handles


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
