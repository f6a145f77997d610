"""One environment as coloured text for terminals. Each character shows two pixels, one above the other."""

import io
from typing import Final

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.style import Style
from rich.text import Text

from eia_sec.common.config import FarmConfig, WorldConfig
from eia_sec.common.config.farm.polygons import inside, inside_any
from eia_sec.common.farm import COMMUNICATION, LETTERS, farm_team
from eia_sec.rollout.rendering.palette import AGE_STOPS, COLOURS, LABELS, SOIL_STOPS, STRESS, TYPES, ZONE, rgb, shade
from eia_sec.rollout.rendering.scene import Scene, hop_lines, wind_text
from eia_sec.rollout.sim.stations import base_place, station_places

Pixels = NDArray[np.uint8]

ALARM, STATION = "#EE6677", "#555555"
"""Colours of a UAV whose charge is low, and of a charging station and the base station."""
LOW: Final = 0.2
"""Share of the capacity below which a charge is low."""
Numbers = NDArray[np.float64]

WIDTH: Final = 72
"""Width of the map in characters, unless the terminal is narrower."""
LEAST_WIDTH: Final = 16
"""Least width of the map in characters, however small the terminal is."""
EXTRA_LINES: Final = 5
"""Lines of text around the map."""
WAITING: Final = 0.5
"""Least AoI of a sensor that is shown; not all sensors fit."""
LINK: Final = (70, 70, 70)
BLOCK: Final = "\N{UPPER HALF BLOCK}"
SCALE_CELLS: Final = 12


def terminal_text(scene: Scene, width: int = WIDTH) -> Text:
    """Return a scene as text.

    Args:
        scene: the scene to show.
        width: characters along x.
    """
    pixels = _pixels(scene, width)
    signs = _signs(scene, len(pixels) // 2, width)
    text = Text(no_wrap=True)
    text.append(f"{scene.headline}   mean AoI {scene.aoi.mean():.2f}   mean VDF {scene.vdf.mean():.2f}", "bold")
    text.append(f"   {wind_text(scene.wind)}\n" if scene.wind.any() else "\n", "bold")
    for row in range(len(pixels) // 2):
        for column in range(width):
            upper, lower = pixels[2 * row, column], pixels[2 * row + 1, column]
            sign = signs.get((row, column))
            text.append(*sign if sign else (BLOCK, Style(color=_css(upper), bgcolor=_css(lower))))
        text.append("\n")
    _append_rewards(text, scene)
    _append_keys(text, scene.config)
    return text


def coloured(text: Text) -> str:
    """Return a text with 24-bit colour escape sequences."""
    console = Console(
        file=io.StringIO(), force_terminal=True, color_system="truecolor", width=10_000, legacy_windows=False
    )
    with console.capture() as capture:
        console.print(text, end="", soft_wrap=True)
    return capture.get()


def fitting_width(columns: int, lines: int, world: WorldConfig) -> int:
    """Return the map's width in characters that fits into a terminal and keeps the map's shape."""
    return max(LEAST_WIDTH, min(WIDTH, columns, int(2 * (lines - EXTRA_LINES) * world.field_x / world.field_y)))


def _pixels(scene: Scene, width: int) -> Pixels:
    """Return plots, links and sensors as [H, width, 3]; row 0 is the field's far edge."""
    world = scene.config.world
    size = (width, 2 * max(1, round(width * world.field_y / world.field_x / 2)))
    column, row = ((np.arange(count) * plots) // count for count, plots in zip(size, scene.vdf.shape, strict=True))
    canvas = shade(SOIL_STOPS, scene.vdf[np.ix_(column, row)] / world.vdf_max)
    if scene.layout.zones or scene.config.stress.faster:
        share = np.stack(np.meshgrid(*((np.arange(count) + 0.5) / count for count in size), indexing="ij"), axis=-1)
        points = share * (world.field_x, world.field_y)
        canvas[inside_any(points, scene.layout.zones)] = rgb(ZONE)
        for _, corners in scene.config.stress.faster:
            canvas[_border(inside(points, np.array(corners)))] = rgb(STRESS)
    relays = world.communication_uavs
    for served, relay in enumerate(scene.assignment):
        if relay < 0:
            continue
        _draw_line(canvas, _places(world, scene.position[[relay, relays + served]], size), LINK, 2)
    for hop in hop_lines(scene.config, scene.position, scene.joined) if scene.config.relay.chained else ():
        _draw_line(canvas, _places(world, hop, size), rgb(COLOURS[COMMUNICATION]), 1)
    waiting = scene.aoi >= WAITING
    at = _places(world, scene.layout.sensor_xy[waiting], size)
    canvas[at[:, 0], at[:, 1]] = shade(AGE_STOPS, scene.aoi[waiting] / world.aoi_max)
    return canvas.swapaxes(0, 1)[::-1]


def _draw_line(canvas: Pixels, ends: NDArray[np.int64], colour: "Pixels | tuple[int, int, int]", every: int) -> None:
    """Draw each so many pixels of a line between two ends [2, 2] on a canvas [width, H, 3]."""
    way = np.linspace(ends[0], ends[1], int(np.abs(ends[1] - ends[0]).max()) + 1)[::every]
    canvas[tuple(np.rint(way).astype(np.int64).T)] = colour


def _border(within: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return which pixels of a region [width, H] have a neighbour outside of it; outside the picture is outside."""
    around = np.pad(within, 1)
    inner = around[:-2, 1:-1] & around[2:, 1:-1] & around[1:-1, :-2] & around[1:-1, 2:]
    border: NDArray[np.bool_] = within & ~inner
    return border


def _places(world: WorldConfig, xy: Numbers, size: tuple[int, int]) -> NDArray[np.int64]:
    """Return the pixels of positions [k, 2], counted from the field's origin."""
    share = xy / (world.field_x, world.field_y)
    places: NDArray[np.int64] = np.minimum((share * size).astype(np.int64), np.array(size) - 1)
    return places


def _signs(scene: Scene, rows: int, width: int) -> dict[tuple[int, int], tuple[str, Style]]:
    """Return the characters that replace pixels, by (row, column): each UAV's letter and number, stations' H and B.

    A UAV whose charge is low is red.
    """
    world, low = scene.config.world, np.zeros(len(scene.position), np.bool_)
    signs: dict[tuple[int, int], tuple[str, Style]] = {}
    if scene.config.battery.some:
        low = scene.charge < LOW
        for column, row in _places(world, station_places(scene.config), (width, rows)).tolist():
            signs[rows - 1 - row, column] = ("H", _badge(STATION))
    if scene.config.relay.chained:
        column, row = _places(world, base_place(scene.config), (width, rows)).tolist()
        signs[rows - 1 - row, column] = ("B", _badge(STATION))
    names = [
        f"{LETTERS[group.name]}{index}" for group in farm_team(scene.config).groups for index in range(group.count)
    ]
    colours = [COLOURS[group.name] for group in farm_team(scene.config).groups for _ in range(group.count)]
    at = _places(world, scene.position, (width, rows))
    for name, colour, empty, (column, row) in zip(names, colours, low.tolist(), at.tolist(), strict=True):
        first = min(column, width - len(name))
        for place, letter in enumerate(name):
            signs[rows - 1 - row, first + place] = (letter, _badge(ALARM if empty else colour))
    return signs


def _append_rewards(text: Text, scene: Scene) -> None:
    text.append("reward  ")
    for name in TYPES:
        text.append(f" {LETTERS[name]} ", _badge(COLOURS[name]))
        text.append(f" {scene.reward[name]:.1f}   ")
    text.append(f"all {scene.reward['mean']:.1f}\n")


def _append_keys(text: Text, config: FarmConfig) -> None:
    world = config.world
    for name in TYPES:
        text.append(f" {LETTERS[name]} ", _badge(COLOURS[name]))
        text.append(f" {LABELS[name]}   ")
    text.append(BLOCK, Style(color=_css(LINK)))
    text.append(" relay link")
    if config.relay.chained:
        text.append("   ")
        text.append(BLOCK, Style(color=COLOURS[COMMUNICATION], bgcolor=COLOURS[COMMUNICATION]))
        text.append(" hop to the base station ")
        text.append("B", _badge(STATION))
    marks = ((config.zones.some, ZONE, "no-fly zone"), (config.stress.faster, STRESS, "area of faster growth"))
    for some, colour, label in marks:
        if some:
            text.append("   ")
            text.append(BLOCK, Style(color=colour, bgcolor=colour))
            text.append(f" {label}")
    text.append("\n")
    _append_scale(text, "plot, VDF 0 ", SOIL_STOPS, 0.0, world.vdf_max)
    _append_scale(text, "   sensor, AoI 1 ", AGE_STOPS, 1.0 / world.aoi_max, world.aoi_max)
    text.append("\n")


def _append_scale(text: Text, label: str, stops: tuple[str, ...], least: float, most: int) -> None:
    text.append(label)
    for colour in shade(stops, np.linspace(least, 1.0, SCALE_CELLS)):
        text.append(" ", Style(bgcolor=_css(colour)))
    text.append(f" {most}")


def _badge(colour: str) -> Style:
    return Style(color="#ffffff", bgcolor=_css(rgb(colour)), bold=True)


def _css(colour: "Pixels | tuple[int, int, int]") -> str:
    red, green, blue = (int(channel) for channel in colour)
    return f"#{red:02x}{green:02x}{blue:02x}"
