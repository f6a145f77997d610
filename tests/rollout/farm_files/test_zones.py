"""No-fly zones in farm files."""

import numpy as np
import pytest

from eia_sec.common.errors import ConfigError
from eia_sec.rollout.farm_files import read_farm, write_farm
from tests.rollout.farm_files.texts import FEW, collection, feature, read

YARD = ((11.0002, 48.0002), (11.0006, 48.0002), (11.0004, 48.0005))


def test_polygons_marked_no_fly_are_zones(tmp_path):
    """They move to the field's corner with the sensors, count for no boundary, and survive writing and reading."""
    ring = (*YARD, YARD[0])
    points = [feature(11.0 + k * 0.0005, 48.0 + k * 0.0004) for k in range(3)]
    field = feature((10.999, 47.999), (11.002, 47.999), (11.002, 48.002), (10.999, 47.999), kind="Polygon")
    text = collection(field, feature(*ring, kind="Polygon", no_fly=True), *points)
    farm = read(tmp_path, text, "farm.geojson").on(FEW)
    (zone,) = farm.zones.polygons
    site = np.array(farm.world.sites[0])
    assert np.array(zone) - site == pytest.approx(np.array([[14.92, 22.24], [44.75, 22.24], [29.84, 55.6]]), abs=0.05)
    write_farm(tmp_path / "again.geojson", farm, 0, (10.999, 47.999))
    (again,) = read_farm(tmp_path / "again.geojson").on(FEW).zones.polygons
    assert np.array(again) == pytest.approx(np.array(zone), abs=0.01)
    with pytest.raises(ConfigError, match="cannot hold no-fly zones"):
        write_farm(tmp_path / "again.csv", farm, 0)


def test_zones_without_a_boundary_do_not_move_the_field(tmp_path):
    """The field is that around the sensors."""
    points = [feature(11.0 + k * 0.0005, 48.0 + k * 0.0004) for k in range(3)]
    plain = read(tmp_path, collection(*points), "farm.geojson")
    zoned = read(tmp_path, collection(feature(*YARD, YARD[0], kind="Polygon", no_fly=True), *points), "farm.geojson")
    assert (zoned.xy, zoned.field_x, zoned.field_y) == (plain.xy, plain.field_x, plain.field_y)
    assert len(zoned.zones) == 1
    assert plain.zones == ()


@pytest.mark.parametrize(
    ("features", "message"),
    [
        ([feature(*YARD, YARD[0], kind="Polygon", no_fly=1)], "true or false"),
        ([feature(*YARD, kind="Polygon", no_fly=True)], "ring of 4"),
        ([feature(*YARD, YARD[0], kind="Polygon", no_fly=True)] * 33, "more than 32"),
        ([feature(*YARD, YARD[0], kind="Polygon")] * 2, "second Polygon"),
    ],
)
def test_zones_that_are_none_are_refused(tmp_path, features, message):
    """With the feature's place in the file."""
    with pytest.raises(ConfigError, match=message):
        read(tmp_path, collection(*features, feature(11.0, 48.0)), "farm.geojson")
