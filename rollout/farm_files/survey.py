"""From the contents of a farm file to sensors on a field: projected, moved to the corner, rounded to a millimetre."""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final, Literal, NoReturn

import numpy as np
from numpy.typing import NDArray

from eia_sec.common.config import FarmConfig, ZoneConfig
from eia_sec.common.config.farm.polygons import Polygon
from eia_sec.common.config.farm.sites import MAX_SENSORS
from eia_sec.common.config.farm.stress import Areas
from eia_sec.common.config.farm.zones import Zones
from eia_sec.common.errors import ConfigError
from eia_sec.rollout.farm_files.projection import TangentPlane

Array = NDArray[np.float64]
Pair = tuple[float, float]
Area = tuple[int, Sequence[Pair]]
"""The growth of an area, and its corners."""
Frame = Literal["farm", "planar", "geographic"]
"""x, y from the field's south-west corner; easting, northing in any metric grid; longitude, latitude in degrees."""
Mark = Literal["type", "cycle", ""]
"""What a file says about each sensor: its type, its update cycle in s, or nothing."""

MARKS: Final = {"type": (0, 255), "cycle": (1, 1_000_000)}
"""Least and largest value of each mark."""
MARGIN: Final = 10.0
"""Margin around the sensors if a file does not give the field's size, m."""
STEP: Final = 10.0
"""A field's size that the file does not give is rounded up to a multiple of this, m."""
MAX_EXTENT: Final = 20_000.0
"""Largest width and depth of a field from a file, m. A wrong column or unit usually exceeds it."""
TOLERANCE: Final = 0.002
"""Rounding may put a sensor this far outside its field, m. The sensor is moved to the edge."""
MAX_PLOTS: Final = 256
"""Most plots along one axis."""


@dataclass(frozen=True)
class Survey:
    """The contents of a farm file.

    Attributes:
        name: the file.
        frame: coordinate frame of the points.
        points: one for each sensor.
        where: location of each sensor in the file, for example "line 17".
        mark: meaning of the marks.
        marks: one for each sensor, or none at all.
        field: width and depth of the field where the file gives them, m; farm frame only.
        boundary: corners of the field where the file gives them; geographic frame only.
        zones: corners of each no-fly zone; geographic frame only.
        areas: areas in which counters rise faster; geographic frame only.
    """

    name: str
    frame: Frame
    points: Sequence[Pair]
    where: Sequence[str]
    mark: Mark = ""
    marks: tuple[int, ...] = ()
    field: Pair | None = None
    boundary: Sequence[Pair] = ()
    zones: Sequence[Sequence[Pair]] = ()
    areas: Sequence[Area] = ()

    def refuse(self, sensor: int, sentence: str) -> NoReturn:
        """Raise ConfigError with the file and the sensor's location in it."""
        raise ConfigError(f"{self.name}, {self.where[sensor]}: {sentence}")


@dataclass(frozen=True)
class GivenFarm:
    """Sensors on a field.

    Attributes:
        survey: the contents of the file.
        xy: place of each sensor, in the file's order, m.
        field_x: width, m.
        field_y: depth, m.
        zones: corners of each no-fly zone, m.
        areas: growth and corners of each area in which counters rise faster, m.
    """

    survey: Survey
    xy: tuple[Pair, ...]
    field_x: float
    field_y: float
    zones: Zones = ()
    areas: Areas = ()

    def on(self, farm: FarmConfig) -> FarmConfig:
        """Return a farm with these sensors on this field. Its plots are at most as large as the farm's.

        There are at most 256 along an axis; on a field that is too long for that they are larger.
        No-fly zones of the file replace those of the configuration, and so do its areas.

        Raises:
            ConfigError: a sensor's type is none of the farm's, or the farm cannot have these sensors.
        """
        survey, world = self.survey, farm.world
        cycles, marks = world.sensor_cycles, survey.marks
        if survey.mark == "cycle":
            cycles = tuple(sorted(set(marks)))
            marks = tuple(cycles.index(mark) for mark in marks)
        for index, mark in enumerate(marks):
            if mark >= len(cycles):
                survey.refuse(index, f"there is no type {mark}; the types are 0 to {len(cycles) - 1}.")
        sites = zip(self.xy, marks, strict=True) if marks else ((place, None) for place in self.xy)
        try:
            world = replace(
                world,
                field_x=self.field_x,
                field_y=self.field_y,
                plots_x=_plots(self.field_x, world.field_x / world.plots_x),
                plots_y=_plots(self.field_y, world.field_y / world.plots_y),
                sensors=len(self.xy),
                sensor_cycles=cycles,
                sites=tuple(place if mark is None else (*place, float(mark)) for place, mark in sites),
            )
            zones = ZoneConfig(self.zones, farm.zones.random) if self.zones else farm.zones
            stress = replace(farm.stress, areas=self.areas) if self.areas else farm.stress
            return replace(farm, world=world, zones=zones, stress=stress)
        except ConfigError as error:
            raise ConfigError(f"{survey.name} does not fit the configuration: {error}") from error


def quote(text: str) -> str:
    """Return a text from a file for a message, shortened and without control characters."""
    return ascii(text if len(text) <= 40 else text[:37] + "...")


def settle(survey: Survey) -> GivenFarm:
    """Place the contents of a file on a field.

    Raises:
        ConfigError: there are no sensors or too many, or a point is invalid, far off, outside the field or a duplicate.
    """
    if not 1 <= len(survey.points) <= MAX_SENSORS:
        raise ConfigError(f"{survey.name} holds {len(survey.points)} sensors; a farm has 1 to {MAX_SENSORS}.")
    points = np.array(survey.points, np.float64)
    polygons: tuple[Polygon, ...] = ()
    if survey.frame == "geographic":
        xy, field, polygons = _from_degrees(survey, points)
    elif survey.frame == "planar":
        _check_extent(survey, points)
        xy, field = _frame(points)
    else:
        xy, field = _from_corner(survey, points)
    return _checked(survey, xy, field, polygons)


def _from_corner(survey: Survey, points: Array) -> tuple[Array, Pair]:
    """Return points in the farm's own frame, and the field: as given, or up to the farthest sensor."""
    below = np.flatnonzero((points < 0.0).any(axis=1))
    if len(below):
        survey.refuse(
            int(below[0]),
            "x and y begin at 0 in the field's south-west corner; name the columns easting and northing "
            "where they do not.",
        )
    if survey.field is not None:
        return points, survey.field
    _check_extent(survey, np.concatenate([points, np.zeros((1, 2))]))
    return points, _round_up(points.max(axis=0) + MARGIN)


def _from_degrees(survey: Survey, points: Array) -> tuple[Array, Pair, tuple[Polygon, ...]]:
    """Return points in metres from the south-west corner, the field, and the no-fly zones, then the areas."""
    wrong = np.flatnonzero((np.abs(points) > (180.0, 90.0)).any(axis=1))
    if len(wrong):
        survey.refuse(int(wrong[0]), _out_of_range(survey.points[int(wrong[0])]))
    for corner in survey.boundary:
        if abs(corner[0]) > 180.0 or abs(corner[1]) > 90.0:
            raise ConfigError(f"{survey.name}: in the field's boundary, {_out_of_range(corner)}")
    polygons = [*survey.zones, *(corners for _, corners in survey.areas)]
    around = [corner for polygon in polygons for corner in polygon]
    both = np.concatenate([points, np.array([*survey.boundary, *around], np.float64).reshape(-1, 2)])
    last = len(points) + len(survey.boundary)
    # A farm across the antimeridian: longitudes are counted from the first sensor's.
    both[:, 0] = points[0, 0] + (both[:, 0] - points[0, 0] + 180.0) % 360.0 - 180.0
    outline = both[len(points) : last] if survey.boundary else both[:last]
    middle = (outline.min(axis=0) + outline.max(axis=0)) / 2.0
    metres = TangentPlane(float(middle[0]), float(middle[1])).to_metres(both)
    # The far side of the Earth projects onto the same plane, so the height below the plane is checked too.
    _check_extent(survey, metres)
    metres = metres[:, :2]
    if survey.boundary:
        low, high = metres[len(points) : last].min(axis=0), metres[len(points) : last].max(axis=0)
        field = round(float(high[0] - low[0]), 3), round(float(high[1] - low[1]), 3)
    else:
        low = metres[:last].min(axis=0) - MARGIN
        field = _frame(metres[:last])[1]
    ends = np.cumsum([last, *map(len, polygons)])
    moved = [(np.round(metres[a:b] - low, 3) + 0.0).tolist() for a, b in itertools.pairwise(ends.tolist())]
    return metres[: len(points)] - low, field, tuple(tuple((x, y) for x, y in corners) for corners in moved)


def _out_of_range(pair: Pair) -> str:
    return f"longitude {pair[0]:g}, latitude {pair[1]:g} is no place: at most 180 and 90 degrees."


def _frame(points: Array) -> tuple[Array, Pair]:
    """Move points to a field with a margin around them; return them and the field."""
    low = points.min(axis=0) - MARGIN
    return points - low, _round_up(points.max(axis=0) + MARGIN - low)


def _round_up(size: Array) -> Pair:
    return STEP * math.ceil(round(float(size[0]), 3) / STEP), STEP * math.ceil(round(float(size[1]), 3) / STEP)


def _check_extent(survey: Survey, points: Array) -> None:
    extent = float((points.max(axis=0) - points.min(axis=0)).max())
    if not extent <= MAX_EXTENT:
        raise ConfigError(
            f"{survey.name} spans {extent / 1000.0:.4g} km; a farm spans at most {MAX_EXTENT / 1000.0:g} km."
        )


def _checked(survey: Survey, xy: Array, field: Pair, polygons: tuple[Polygon, ...]) -> GivenFarm:
    """Check that all positions are distinct and inside the field; return the farm with them rounded to 1 mm."""
    if not (0.0 < field[0] <= MAX_EXTENT and 0.0 < field[1] <= MAX_EXTENT):
        raise ConfigError(
            f"{survey.name}: a field of {field[0]:g} m x {field[1]:g} m is none: above 0, at most {MAX_EXTENT:g} m."
        )
    outside = np.flatnonzero(((xy < -TOLERANCE) | (xy > np.array(field) + TOLERANCE)).any(axis=1))
    if len(outside):
        survey.refuse(int(outside[0]), f"the sensor lies outside the field of {field[0]:g} m x {field[1]:g} m.")
    seen: dict[Pair, int] = {}
    rounded = np.clip(np.round(xy, 3) + 0.0, 0.0, field).tolist()
    for index, (x, y) in enumerate(rounded):
        if (x, y) in seen:
            survey.refuse(index, f"the sensor stands where that of {survey.where[seen[x, y]]} does.")
        seen[x, y] = index
    zones, outlines = polygons[: len(survey.zones)], polygons[len(survey.zones) :]
    areas = tuple((growth, corners) for (growth, _), corners in zip(survey.areas, outlines, strict=True))
    return GivenFarm(survey, tuple(seen), float(field[0]), float(field[1]), zones, areas)


def _plots(size: float, plot: float) -> int:
    return max(1, min(MAX_PLOTS, math.ceil(size / plot - 1e-9)))
