"""Farms as GeoJSON (RFC 7946): a FeatureCollection of Points and Polygons, WGS 84.

Points are sensors. Polygons with the property "no_fly": true are no-fly zones, and those with a "growth" are areas in
which counters rise so many times as often. At most one other Polygon is the field's boundary.
"""

import json
import math
import re
from collections.abc import Iterable, Iterator, Sequence
from typing import Any, Final, NoReturn

import numpy as np

from eia_sec.common.config.farm.polygons import MAX_CORNERS as POLYGON_CORNERS
from eia_sec.common.config.farm.polygons import crosses_itself
from eia_sec.common.config.farm.sites import MAX_SENSORS
from eia_sec.common.config.farm.stress import MAX_AREAS, MOST_GROWTH
from eia_sec.common.config.farm.zones import MAX_ZONES
from eia_sec.common.errors import ConfigError
from eia_sec.rollout.farm_files.survey import MARKS, Area, Mark, Pair, Survey, quote

MAX_CORNERS: Final = 10_000
"""Most corners of a field's boundary."""
DECIMALS: Final = 9
"""Decimals of a degree that are written: 0.1 mm."""

_SPACE: Final = re.compile(r"[ \t\n\r]*")
_WGS84: Final = ("CRS84", "EPSG:4326", "EPSG::4326")


def parse_geojson(text: str, name: str) -> Survey:
    """Parse a farm from GeoJSON text.

    Args:
        text: the file's text.
        name: the file, for error messages.

    Raises:
        ConfigError: the text is no JSON, or a feature is not that of a farm; the message names feature and line.
    """
    collection = _Collection(name)
    members: dict[str, Any] = {}
    try:
        for key, feature, line in _Document(text).read():
            if line:
                collection.add(feature, line)
            else:
                members[key] = feature
    except json.JSONDecodeError as error:
        raise ConfigError(f"{name}, line {error.lineno}: not JSON: {error.msg[:1].lower()}{error.msg[1:]}.") from error
    except (ValueError, RecursionError) as error:
        raise ConfigError(f"{name} is not JSON that can be read: {quote(str(error))}.") from error
    if members.get("type") != "FeatureCollection" or not collection.found:
        raise ConfigError(f"{name} is no GeoJSON FeatureCollection with features.")
    if "crs" in members and not any(known in json.dumps(members["crs"]) for known in _WGS84):
        raise ConfigError(f"{name} names another coordinate system; GeoJSON is longitude and latitude, WGS 84.")
    return Survey(
        name,
        "geographic",
        collection.points,
        collection.where,
        collection.mark or "",
        tuple(collection.marks),
        boundary=collection.boundary,
        zones=collection.zones,
        areas=collection.areas,
    )


class _Document:
    """A JSON object that is read member by member, and its features one by one, so that each has a line."""

    def __init__(self, text: str) -> None:
        self.text, self.at = text, 0
        self.decoder = json.JSONDecoder(parse_constant=_refuse_constant)

    def read(self) -> Iterator[tuple[str, Any, int]]:
        """Yield (name, value, 0) for each member, and ("features", feature, line) for each feature."""
        self._expect("{")
        more = not self._skip("}")
        while more:
            key = self._value()
            if not isinstance(key, str):
                raise json.JSONDecodeError("a member without a name", self.text, self.at)
            self._expect(":")
            if key == "features" and self._skip("["):
                yield from self._features()
            else:
                yield key, self._value(), 0
            more = self._skip(",")
            if not more:
                self._expect("}")
        if self._next():
            raise json.JSONDecodeError("something stands behind the end", self.text, self.at)

    def _features(self) -> Iterator[tuple[str, Any, int]]:
        line, counted = 1, 0
        more = not self._skip("]")
        while more:
            self._next()
            line, counted = line + self.text.count("\n", counted, self.at), self.at
            yield "features", self._value(), line
            more = self._skip(",")
            if not more:
                self._expect("]")

    def _next(self) -> str:
        """Advance to the next character that is no space and return it, or nothing at the end."""
        space = _SPACE.match(self.text, self.at)
        assert space is not None, "the pattern matches nothing as well"
        self.at = space.end()
        return self.text[self.at : self.at + 1]

    def _skip(self, sign: str) -> bool:
        found = self._next() == sign
        self.at += found
        return found

    def _expect(self, sign: str) -> None:
        if not self._skip(sign):
            raise json.JSONDecodeError(f"{sign} is missing", self.text, self.at)

    def _value(self) -> Any:
        self._next()
        value, self.at = self.decoder.raw_decode(self.text, self.at)
        return value


class _Collection:
    """Sensors, boundary, no-fly zones and areas of faster growth, feature by feature."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.found = 0
        self.points: list[Pair] = []
        self.where: list[str] = []
        self.mark: Mark | None = None
        self.marks: list[int] = []
        self.boundary: list[Pair] = []
        self.zones: list[list[Pair]] = []
        self.areas: list[Area] = []
        self._here = ""

    def add(self, feature: Any, line: int) -> None:
        """Parse a feature."""
        self.found += 1
        self._here = f"line {line}, feature {self.found}"
        if not isinstance(feature, dict) or feature.get("type") != "Feature":
            self._refuse("not a Feature.")
        geometry = feature.get("geometry")
        geometry = geometry if isinstance(geometry, dict) else {}
        kind = geometry.get("type")
        if kind == "Point":
            if len(self.points) == MAX_SENSORS:
                self._refuse(f"there are more than {MAX_SENSORS} sensors.")
            self.points.append(self._position(geometry.get("coordinates")))
            self.where.append(self._here)
            self._take_mark(feature.get("properties"))
        elif kind == "Polygon":
            properties = feature.get("properties")
            self._take_polygon(geometry.get("coordinates"), properties if isinstance(properties, dict) else {})
        else:
            what = f"a geometry {quote(kind)}" if isinstance(kind, str) else "no geometry"
            self._refuse(f"{what}, where a sensor is a Point and the field's boundary a Polygon.")

    def _take_mark(self, properties: Any) -> None:
        named = [mark for mark in MARKS if isinstance(properties, dict) and mark in properties]
        if len(named) > 1:
            self._refuse("the sensor has both a type and a cycle.")
        mark: Mark = "type" if "type" in named else "cycle" if named else ""
        if self.mark is None:
            self.mark = mark
        if mark != self.mark:
            self._refuse("either every sensor has a type, or every one has a cycle, or none has any.")
        if mark:
            value, (low, high) = properties[mark], MARKS[mark]
            if type(value) is not int or not low <= value <= high:
                self._refuse(f"the {mark} must be a whole number from {low} to {high}, not {_show(value)}.")
            self.marks.append(value)

    def _take_polygon(self, rings: Any, properties: dict[str, Any]) -> None:
        mark = properties.get("no_fly", False)
        if not isinstance(mark, bool):
            self._refuse(f"no_fly must be true or false, not {_show(mark)}.")
        if mark and "growth" in properties:
            self._refuse("a Polygon is a no-fly zone or has a growth, not both.")
        if mark:
            if len(self.zones) == MAX_ZONES:
                self._refuse(f"there are more than {MAX_ZONES} no-fly zones.")
            self.zones.append(self._corners(rings, "a no-fly zone"))
        elif "growth" in properties:
            self._take_area(rings, properties["growth"])
        else:
            if self.boundary:
                self._refuse('a second Polygon without "no_fly": true or a growth; a farm has one field.')
            self.boundary = self._ring(rings, "the boundary", MAX_CORNERS)
            if crosses_itself(np.array(self.boundary)):
                self._refuse("the boundary crosses itself.")

    def _take_area(self, rings: Any, growth: Any) -> None:
        if type(growth) is not int or not 1 <= growth <= MOST_GROWTH:
            self._refuse(f"the growth must be a whole number from 1 to {MOST_GROWTH}, not {_show(growth)}.")
        if len(self.areas) == MAX_AREAS:
            self._refuse(f"there are more than {MAX_AREAS} areas with a growth.")
        self.areas.append((growth, self._corners(rings, "an area with a growth")))

    def _corners(self, rings: Any, what: str) -> list[Pair]:
        """Return the corners of a Polygon, each once."""
        ring = self._ring(rings, what, POLYGON_CORNERS + 1)
        return ring[:-1] if ring[-1] == ring[0] else ring

    def _ring(self, rings: Any, what: str, most: int) -> list[Pair]:
        """Return the outer ring of a Polygon, which must be its only one."""
        ring = rings[0] if isinstance(rings, list) and rings else None
        if isinstance(rings, list) and len(rings) > 1:
            self._refuse(f"{what} has a hole, and none may have any.")
        if not isinstance(ring, list) or not 4 <= len(ring) <= most:
            self._refuse(f"{what} must be a ring of 4 to {most} positions, the last of them the first.")
        return [self._position(corner) for corner in ring]

    def _position(self, value: Any) -> Pair:
        numbers: list[Any] = value if isinstance(value, list) and 2 <= len(value) <= 4 else [None]
        if any(type(number) not in (int, float) for number in numbers):
            self._refuse(f"coordinates must be [longitude, latitude], not {_show(value)}.")
        # Compared before it becomes a float, which a whole number of any size may not fit.
        if not (abs(numbers[0]) <= 180 and abs(numbers[1]) <= 90):
            self._refuse(f"[longitude, latitude] must lie within 180 and 90 degrees, not {_show(value)}.")
        return float(numbers[0]), float(numbers[1])

    def _refuse(self, sentence: str) -> NoReturn:
        raise ConfigError(f"{self.name}, {self._here}: {sentence}")


def format_geojson(
    points: Iterable[Pair],
    cycles: Iterable[int],
    corners: Sequence[Pair],
    zones: Iterable[Sequence[Pair]] = (),
    areas: Iterable[Area] = (),
) -> str:
    """Return a farm as GeoJSON text, a feature a line.

    Args:
        points: longitude and latitude of each sensor, degrees.
        cycles: update cycle of each, s.
        corners: the field's four corners, counterclockwise.
        zones: corners of each no-fly zone.
        areas: growth and corners of each area in which counters rise faster.
    """
    features = [_feature(_polygon(corners), {"name": "field"})]
    features += [_feature(_polygon(zone), {"no_fly": True}) for zone in zones]
    features += [_feature(_polygon(area), {"growth": growth}) for growth, area in areas]
    for point, cycle in zip(points, cycles, strict=True):
        features.append(_feature({"type": "Point", "coordinates": _rounded(point)}, {"cycle": cycle}))
    body = ",\n".join(json.dumps(feature) for feature in features)
    return f'{{"type": "FeatureCollection", "features": [\n{body}\n]}}\n'


def _feature(geometry: dict[str, Any], properties: dict[str, Any]) -> dict[str, Any]:
    return {"type": "Feature", "properties": properties, "geometry": geometry}


def _polygon(corners: Sequence[Pair]) -> dict[str, Any]:
    return {"type": "Polygon", "coordinates": [[_rounded(corner) for corner in (*corners, corners[0])]]}


def _rounded(pair: Pair) -> list[float]:
    return [round(pair[0], DECIMALS), round(pair[1], DECIMALS)]


def _refuse_constant(name: str) -> NoReturn:
    raise ValueError(f"{name} is no number")


def _show(value: Any) -> str:
    """Return a value as messages show it."""
    if isinstance(value, str):
        return quote(value)
    if isinstance(value, int) and not isinstance(value, bool) and abs(value) > 10**15:
        return "a huge number"
    if value is None or isinstance(value, bool | int | float):
        return json.dumps(value) if not isinstance(value, float) or math.isfinite(value) else "an infinite number"
    if isinstance(value, list) and len(value) <= 4 and all(isinstance(part, int | float) for part in value):
        return "[" + ", ".join(map(_show, value)) + "]"
    return "something else"
