"""Farms as CSV: a header that names the columns, one line for each sensor, comments after #."""

import csv
import math
import re
from collections.abc import Iterable
from typing import Final

from eia_sec.common.config.farm.sites import MAX_SENSORS
from eia_sec.common.errors import ConfigError
from eia_sec.rollout.farm_files.survey import MARKS, Frame, Mark, Pair, Survey, quote

COLUMNS: Final[dict[Frame, tuple[tuple[str, ...], tuple[str, ...]]]] = {
    "farm": (("x",), ("y",)),
    "planar": (("easting", "east"), ("northing", "north")),
    "geographic": (("lon", "longitude", "lng"), ("lat", "latitude")),
}
"""Names of the two columns of each frame, case-insensitive."""
DELIMITERS: Final = (",", ";", "\t")

_NUMBER: Final = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)
_WHOLE: Final = re.compile(r"\d{1,7}", re.ASCII)
_FIELD: Final = re.compile(r"#\s*field:\s*(\S+)\s*x\s*(\S+)\s*m\s*", re.IGNORECASE)


def parse_csv(text: str, name: str) -> Survey:
    """Parse a farm from CSV text.

    Args:
        text: the file's text.
        name: the file, for error messages.

    Raises:
        ConfigError: a line does not describe a farm; the message names the line.
    """
    field: tuple[Pair, int] | None = None
    table: _Table | None = None
    for number, line in enumerate(text.replace("\r\n", "\n").replace("\r", "\n").split("\n"), 1):
        where = f"line {number}"
        if line.lstrip().startswith("#"):
            size = _FIELD.fullmatch(line.strip())
            if size:
                field = (_number(name, where, size[1]), _number(name, where, size[2])), number
        elif line.strip(" \t,;"):
            if table is None:
                table = _Table(name, where, line)
            else:
                table.add(where, line)
    if table is None:
        raise ConfigError(f"{name} has no header line with the column names.")
    if field and table.frame != "farm":
        raise ConfigError(f"{name}, line {field[1]}: the field's size is allowed only with the columns x and y.")
    return Survey(
        name, table.frame, table.points, table.where, table.mark, tuple(table.marks), field=field[0] if field else None
    )


class _Table:
    """The lines after the header."""

    def __init__(self, name: str, where: str, header: str) -> None:
        self.name = name
        self.delimiter = max(DELIMITERS, key=header.count)
        self.columns = [column.strip().lower() for column in self._cells(where, header)]
        self.frame, self._pair = self._find_pair(where)
        self.mark = self._find_mark(where)
        self.points: list[Pair] = []
        self.where: list[str] = []
        self.marks: list[int] = []

    def add(self, where: str, line: str) -> None:
        """Parse a line."""
        cells = self._cells(where, line)
        if len(cells) != len(self.columns):
            raise ConfigError(f"{self.name}, {where}: {len(cells)} values where the header has {len(self.columns)}.")
        if len(self.points) == MAX_SENSORS:
            raise ConfigError(f"{self.name}, {where}: there are more than {MAX_SENSORS} sensors.")
        first, second = (_number(self.name, where, cells[column]) for column in self._pair)
        self.points.append((first, second))
        self.where.append(where)
        if self.mark:
            cell = cells[self.columns.index(self.mark)].strip()
            low, high = MARKS[self.mark]
            if not _WHOLE.fullmatch(cell) or not low <= int(cell) <= high:
                raise ConfigError(
                    f"{self.name}, {where}: {quote(cell)} is no {self.mark}, a whole number from {low} to {high}."
                )
            self.marks.append(int(cell))

    def _cells(self, where: str, line: str) -> list[str]:
        try:
            return next(csv.reader([line], delimiter=self.delimiter, strict=True, skipinitialspace=True), [])
        except csv.Error as error:
            raise ConfigError(f"{self.name}, {where}: not CSV: {str(error).rstrip('.')}.") from error

    def _find_pair(self, where: str) -> tuple[Frame, tuple[int, int]]:
        found: list[tuple[Frame, tuple[int, int]]] = []
        for frame, names in COLUMNS.items():
            places = [[i for i, column in enumerate(self.columns) if column in axis] for axis in names]
            if all(len(place) == 1 for place in places):
                found.append((frame, (places[0][0], places[1][0])))
        if len(found) != 1:
            raise ConfigError(
                f"{self.name}, {where}: the header must name exactly one of x,y and easting,northing and lon,lat, "
                f"each once, and it is {quote(self.delimiter.join(self.columns))}."
            )
        return found[0]

    def _find_mark(self, where: str) -> Mark:
        count = self.columns.count("type") + self.columns.count("cycle")
        if count > 1:
            raise ConfigError(f"{self.name}, {where}: the header names more than one of type and cycle.")
        if not count:
            return ""
        return "type" if "type" in self.columns else "cycle"


def format_csv(points: Iterable[Pair], cycles: Iterable[int], field: Pair) -> str:
    """Return a farm as CSV text.

    Args:
        points: x and y of each sensor, m.
        cycles: update cycle of each, s.
        field: width and depth of the field, m.
    """
    lines = [f"# field: {field[0]!r} x {field[1]!r} m", "x,y,cycle"]
    lines += [f"{x:.3f},{y:.3f},{cycle}" for (x, y), cycle in zip(points, cycles, strict=True)]
    return "\n".join(lines) + "\n"


def _number(name: str, where: str, cell: str) -> float:
    cell = cell.strip()
    value = float(cell) if len(cell) <= 64 and _NUMBER.fullmatch(cell) else math.nan
    if not math.isfinite(value):
        raise ConfigError(f"{name}, {where}: {quote(cell)} is not a number.")
    return value
