"""Areas of faster growth in farm files and configurations."""

import re
from dataclasses import replace

import numpy as np
import pytest

from eia_sec.common.config import FarmConfig, RunConfig, StressConfig
from eia_sec.common.config.files import digest, from_toml, to_toml, with_setting
from eia_sec.common.errors import ConfigError
from eia_sec.rollout.farm_files import read_farm, write_farm
from tests.rollout.farm_files.texts import FEW, collection, feature, read

BLOCK = ((11.0002, 48.0002), (11.0006, 48.0002), (11.0004, 48.0005))
FIELD = ((10.999, 47.999), (11.002, 47.999), (11.002, 48.002), (10.999, 47.999))
YARD = ((11.001, 47.9995), (11.0015, 47.9995), (11.0015, 48.0), (11.001, 47.9995))
POINTS = tuple(feature(11.0 + k * 0.0005, 48.0 + k * 0.0004) for k in range(3))
TRIANGLE = ((0.0, 0.0), (50.0, 0.0), (50.0, 40.0))


def area(growth, ring=(*BLOCK, BLOCK[0]), **properties):
    """Return the feature of an area."""
    return feature(*ring, kind="Polygon", growth=growth, **properties)


def test_polygons_with_a_growth_are_areas(tmp_path):
    """They move to the field's corner with the sensors, are neither boundary nor zone, and survive writing."""
    zone = feature(*YARD, kind="Polygon", no_fly=True)
    text = collection(area(3, no_fly=False), feature(*FIELD, kind="Polygon"), zone, area(1), *POINTS)
    farm = read(tmp_path, text, "farm.geojson").on(FEW)
    (growth, corners), (other, again) = farm.stress.areas
    assert (growth, other, again) == (3, 1, corners)
    assert farm.stress == replace(FEW.stress, areas=farm.stress.areas)
    assert len(farm.zones.polygons) == 1
    site = np.array(farm.world.sites[0])
    wanted = np.array([[14.92, 22.24], [44.75, 22.24], [29.84, 55.6]])
    assert np.array(corners) - site == pytest.approx(wanted, abs=0.05)
    write_farm(tmp_path / "again.geojson", farm, 0, (10.999, 47.999))
    kept = read_farm(tmp_path / "again.geojson").on(FEW).stress.areas
    assert [growth for growth, _ in kept] == [3, 1]
    assert np.array(kept[0][1]) == pytest.approx(np.array(corners), abs=0.01)
    with pytest.raises(ConfigError, match="cannot hold areas with a growth"):
        write_farm(tmp_path / "again.csv", replace(farm, zones=FEW.zones), 0)


def test_areas_without_a_boundary_do_not_move_the_field(tmp_path):
    """The field is that around the sensors, and a file without areas keeps those of the configuration."""
    plain = read(tmp_path, collection(*POINTS), "farm.geojson")
    given = read(tmp_path, collection(area(2), *POINTS), "farm.geojson")
    assert (given.xy, given.field_x, given.field_y) == (plain.xy, plain.field_x, plain.field_y)
    configured = replace(FEW, stress=StressConfig(areas=((5, TRIANGLE),)))
    assert plain.on(configured).stress.areas == ((5, TRIANGLE),)
    assert given.on(configured).stress.areas == given.areas


WRONG = "{}, line 2, feature 1: the growth must be a whole number from 1 to 1000000, not "


@pytest.mark.parametrize(
    ("features", "message"),
    [
        ([area(0)], WRONG + "0."),
        ([area(-2)], WRONG + "-2."),
        ([area(1_000_001)], WRONG + "1000001."),
        ([area(1.5)], WRONG + "1.5."),
        ([area(2.0)], WRONG + "2.0."),
        ([area("3")], WRONG + "'3'."),
        ([area(True)], WRONG + "true."),
        ([area(None)], WRONG + "null."),
        ([area([2])], WRONG + "[2]."),
        ([area(10**30)], WRONG + "a huge number."),
        ([area(2, no_fly=True)], "{}, line 2, feature 1: a Polygon is a no-fly zone or has a growth, not both."),
        ([area(2, BLOCK)], "{}, line 2, feature 1: an area with a growth must be a ring of 4 to 33 positions"),
        ([area(2)] * 33, "{}, line 34, feature 33: there are more than 32 areas with a growth."),
        ([area(2, (*BLOCK, (500.0, 0.0)))], "{}, line 2, feature 1: [longitude, latitude] must lie within"),
    ],
)
def test_areas_that_are_none_are_refused(tmp_path, features, message):
    """In one sentence, with the feature's place in the file."""
    wanted = re.escape(message.format(tmp_path / "farm.geojson"))
    with pytest.raises(ConfigError, match=f"^{wanted}"):
        read(tmp_path, collection(*features, *POINTS), "farm.geojson")


def test_an_area_that_crosses_itself_is_refused_with_the_file(tmp_path):
    """Its corners are checked when the file meets a configuration."""
    (a, b, c), d = BLOCK, (11.0002, 48.0005)
    given = read(tmp_path, collection(area(2, (a, c, b, d, a)), *POINTS), "farm.geojson")
    with pytest.raises(ConfigError, match=r"farm.geojson does not fit the configuration: stress.areas\[0\] crosses"):
        given.on(FEW)


@pytest.mark.parametrize(
    ("areas", "message"),
    [
        (((0, TRIANGLE),), "growth of stress.areas[0] must be between 1 and 1000000, not 0."),
        (((2, TRIANGLE), (2, TRIANGLE[:2])), "stress.areas[1] has 2 corners, not 3 to 32."),
        (((2, ((0.0, 0.0), (float("nan"), 0.0), (4.0, 4.0))),), "stress.areas[0] needs corners [x, y] in m, not "),
        (((2, ((0.0, 0.0), (1e7, 0.0), (4.0, 4.0))),), "stress.areas[0] needs corners [x, y] in m, not "),
        (((2, TRIANGLE),) * 33, "areas are at most 32, not 33."),
    ],
)
def test_areas_that_no_farm_can_have_are_refused(areas, message):
    """Where they are made."""
    with pytest.raises(ConfigError, match=re.escape(message)):
        StressConfig(areas=areas)


def test_areas_are_read_from_toml_and_written():
    """A growth, then corners; whole numbers of metres are numbers, too."""
    config = with_setting(RunConfig(), "farm.stress.areas=[[2, [[0, 0], [50, 0], [50, 40.0]]]]")
    assert config.farm.stress.areas == ((2, TRIANGLE),)
    assert "areas = [[2, [[0.0, 0.0], [50.0, 0.0], [50.0, 40.0]]]]" in to_toml(config)
    assert from_toml(to_toml(config), RunConfig()) == config
    assert digest(config) != digest(RunConfig())
    assert digest(with_setting(config, "farm.stress.areas=[]")) == digest(RunConfig())


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ("3", "must be a list of at most 32 areas, not 3."),
        ("[3]", "must be a list of areas [growth, corners], growth a whole number."),
        ("[[2.5, [[0, 0], [9, 0], [9, 9]]]]", "must be a list of areas [growth, corners], growth a whole number."),
        ("[[true, [[0, 0], [9, 0], [9, 9]]]]", "must be a list of areas [growth, corners], growth a whole number."),
        ("[[2, 3]]", "must be a list of lists of at most 32 corners, not of 3."),
        ("[[2, [[0, 0], [9, 0], [9, inf]]]]", "farm.stress.areas names a number that is too large."),
        ("[[2, [[0, 0], [9, 0], [9, nan]]]]", "stress.areas[0] needs corners [x, y] in m, not [9.0, nan]."),
    ],
)
def test_settings_that_are_no_areas_are_refused(value, message):
    """In one sentence."""
    with pytest.raises(ConfigError, match=re.escape(message)):
        with_setting(RunConfig(), f"farm.stress.areas={value}")


def test_areas_of_growth_1_are_no_stress():
    """They are kept, and change nothing."""
    stress = StressConfig(areas=((1, TRIANGLE),))
    assert (stress.some, stress.faster) == (False, ())
    assert StressConfig(areas=((1, TRIANGLE), (2, TRIANGLE))).faster == ((2, TRIANGLE),)
    assert not FarmConfig().stress.some
