"""Farm files on disk: their format, their size, and errors of reading and writing."""

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from eia_sec.common.config import FarmConfig
from eia_sec.common.errors import ConfigError
from eia_sec.rollout.farm_files.csv_text import format_csv, parse_csv
from eia_sec.rollout.farm_files.geojson import format_geojson, parse_geojson
from eia_sec.rollout.farm_files.projection import TangentPlane
from eia_sec.rollout.farm_files.survey import GivenFarm, Pair, settle
from eia_sec.rollout.sim.layout import make_layout

MAX_BYTES: Final = 8 * 1024 * 1024
"""Largest farm file that is read; 10,000 sensors take 0.3 MB as CSV and 1.5 MB as GeoJSON."""
GEOJSON: Final = (".geojson", ".json")
CSV: Final = (".csv",)


def read_farm(path: Path) -> GivenFarm:
    """Return the farm that a file holds.

    Args:
        path: a file that ends in .csv, .geojson or .json.

    Raises:
        ConfigError: the file cannot be read or holds no farm; the message names the file and, where there is one,
            the line.
    """
    kind = _format_of(path)
    name = str(path)
    text = _read(path)
    return settle(parse_geojson(text, name) if kind == GEOJSON else parse_csv(text, name))


def write_farm(path: Path, farm: FarmConfig, seed: int, corner: tuple[float, float] = (0.0, 0.0)) -> None:
    """Write the farm of a seed; positions are exact to 1 mm.

    Args:
        path: a file that ends in .csv, .geojson or .json.
        farm: the configuration.
        seed: the farm's seed.
        corner: longitude and latitude of the field's south-west corner, degrees; GeoJSON only.

    Raises:
        ConfigError: the file cannot be written, another ending, a corner that is no place, or no-fly zones or areas
            in CSV.
    """
    kind = _format_of(path)
    layout, world = make_layout(farm, seed), farm.world
    cycles = [world.sensor_cycles[sensor] for sensor in layout.sensor_type.tolist()]
    if kind == CSV and layout.zones:
        raise ConfigError(f"the farm file {path} cannot hold no-fly zones; one that ends in .geojson can.")
    if kind == CSV and farm.stress.areas:
        raise ConfigError(f"the farm file {path} cannot hold areas with a growth; one that ends in .geojson can.")
    if kind == CSV:
        text = format_csv([(x, y) for x, y in layout.sensor_xy.tolist()], cycles, (world.field_x, world.field_y))
    else:
        size = world.field_x, world.field_y
        places = [layout.sensor_xy, *layout.zones, *(np.array(area) for _, area in farm.stress.areas)]
        points, corners, polygons = _on_earth(places, size, corner)
        zones, outlines = polygons[: len(layout.zones)], polygons[len(layout.zones) :]
        areas = zip((growth for growth, _ in farm.stress.areas), outlines, strict=True)
        text = format_geojson(points, cycles, corners, zones, areas)
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"the farm file {path} cannot be written: {error.strerror}.") from error


def _on_earth(
    places: Sequence[NDArray[np.float64]], field: tuple[float, float], corner: tuple[float, float]
) -> tuple[list[Pair], list[Pair], list[list[Pair]]]:
    """Return longitude and latitude of the first array of places, of the field's corners, and of the other arrays."""
    if not (abs(corner[0]) <= 180.0 and abs(corner[1]) <= 89.0):
        raise ConfigError(f"no farm lies at longitude {corner[0]:g} and latitude {corner[1]:g}.")
    size = np.array(field)
    middle = TangentPlane(*corner).to_degrees(size[None] / 2.0)[0]
    plane = TangentPlane(float(middle[0]), float(middle[1]))
    corners = np.array([(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)]) * size
    sensors, *zones = ([*map(_pair, _degrees(plane, xy - size / 2.0))] for xy in places)
    return sensors, [*map(_pair, _degrees(plane, corners - size / 2.0))], zones


def _degrees(plane: TangentPlane, metres: NDArray[np.float64]) -> NDArray[np.float64]:
    degrees = plane.to_degrees(metres)
    degrees[:, 0] = (degrees[:, 0] + 180.0) % 360.0 - 180.0
    return degrees


def _pair(place: NDArray[np.float64]) -> Pair:
    return float(place[0]), float(place[1])


def _format_of(path: Path) -> tuple[str, ...]:
    for endings in (CSV, GEOJSON):
        if path.suffix.lower() in endings:
            return endings
    raise ConfigError(f"the farm file {path} must end in {', '.join((*CSV, *GEOJSON))}.")


def _read(path: Path) -> str:
    try:
        # Only a plain file: a pipe or a device could go on for ever.
        if path.exists() and not path.is_file():
            raise ConfigError(f"the farm file {path} is no plain file.")
        with path.open("rb") as source:
            content = source.read(MAX_BYTES + 1)
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else str(error)
        raise ConfigError(f"the farm file {path} cannot be read: {reason}.") from error
    if len(content) > MAX_BYTES:
        raise ConfigError(f"the farm file {path} is larger than {MAX_BYTES // 1024**2} MiB.")
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        raise ConfigError(f"{path}, line {line}: the text is not UTF-8.") from error
