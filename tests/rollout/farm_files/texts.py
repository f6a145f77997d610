"""Texts of farm files for tests."""

import json

from eia_sec.common.config import FarmConfig, ObservationConfig
from eia_sec.rollout.farm_files import read_farm

FEW = FarmConfig(observation=ObservationConfig(sensors=1))
"""A farm on which any number of sensors fits the observations."""


def read(tmp_path, text, name="farm.csv"):
    """Return what a file with this text holds."""
    path = tmp_path / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return read_farm(path)


def feature(*coordinates, kind="Point", **properties):
    """Return a GeoJSON feature: a point, or a polygon of one ring."""
    shape = list(coordinates) if kind == "Point" else [[list(corner) for corner in coordinates]]
    return {"type": "Feature", "properties": properties, "geometry": {"type": kind, "coordinates": shape}}


def collection(*features, **members):
    """Return GeoJSON text with a feature a line, the first on line 2."""
    body = ",\n".join(item if isinstance(item, str) else json.dumps(item) for item in features)
    more = "".join(f', "{name}": {json.dumps(value)}' for name, value in members.items())
    return f'{{"type": "FeatureCollection", "features": [\n{body}\n]{more}}}'
