"""Farm files: read, written, and every mistake named by file and line."""

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from eia_sec.common.config import FarmConfig, ObservationConfig, WorldConfig
from eia_sec.common.errors import ConfigError
from eia_sec.rollout.farm_files import read_farm, write_farm
from eia_sec.rollout.farm_files.csv_text import parse_csv
from eia_sec.rollout.farm_files.geojson import parse_geojson
from eia_sec.rollout.farm_files.survey import settle
from eia_sec.rollout.sim.layout import make_layout
from tests.rollout.farm_files.texts import FEW, collection, feature, read


def test_csv_in_the_farms_own_frame(tmp_path):
    """Places stay as they are to 1 mm; the field is what the file says."""
    farm = read(tmp_path, "# field: 120 x 80.5 m\n# probes\n\nX , y\n1.5,2\n 3.25,4e1 \n+.5,7.0004\n")
    assert farm.xy == ((1.5, 2.0), (3.25, 40.0), (0.5, 7.0))
    assert (farm.field_x, farm.field_y) == (120.0, 80.5)
    assert farm.survey.where == ["line 5", "line 6", "line 7"]


def test_csv_without_a_field_gets_one_with_a_margin(tmp_path):
    """From 0, 0 to 10 m beyond the farthest sensor, rounded up to whole 10 m."""
    farm = read(tmp_path, "x,y\n95,3\n2,171\n")
    assert farm.xy == ((95.0, 3.0), (2.0, 171.0))
    assert (farm.field_x, farm.field_y) == (110.0, 190.0)


def test_csv_in_a_grid_is_moved_to_the_corner(tmp_path):
    """Easting and northing keep their differences; the margin is 10 m around; semicolons, BOM and CRLF are read."""
    text = '\ufeffid;Easting;Northing\r\na;700010.25;5364000\r\n"b;b";700045;5364033.5\r\n;;\r\n'
    farm = read(tmp_path, text)
    assert farm.xy == ((10.0, 10.0), (44.75, 43.5))
    assert (farm.field_x, farm.field_y) == (60.0, 60.0)


def test_degrees_become_metres(tmp_path):
    """A thousandth of a degree at 48 degrees north is 74.6 m to the east and 111.2 m to the north."""
    farm = read(tmp_path, "name,latitude,longitude\nA,48,11\nB,48.001,11\nC,48,11.001\n")
    a, b, c = np.array(farm.xy)
    assert a == pytest.approx([10.0, 10.0], abs=0.01)
    assert b - a == pytest.approx([0.0, 111.2], abs=0.1)
    assert c - a == pytest.approx([74.6, 0.0], abs=0.1)
    assert (farm.field_x, farm.field_y) == (100.0, 140.0)


def test_a_farm_across_the_antimeridian_is_one_farm(tmp_path):
    """Longitudes of 179.9995 and -179.9995 degrees are 0.001 degrees apart."""
    west, east = read(tmp_path, "lon,lat\n179.9995,-17\n-179.9995,-17\n").xy
    assert east[0] - west[0] == pytest.approx(106.5, abs=0.1)
    features = [feature(-179.9995, -17.0), feature(179.9995, -17.0)]
    assert read(tmp_path, collection(*features), "farm.geojson").xy[::-1] == (west, east)


def test_geojson_with_a_boundary(tmp_path):
    """The field is the rectangle around the Polygon, wherever it stands in the file; heights and names are left out."""
    corners = [(11.0, 48.0), (11.004, 48.0), (11.004, 48.002), (11.0, 48.002), (11.0, 48.0)]
    points = [feature(11.001, 48.001, 512.0, name="a"), feature(11.002, 48.0)]
    farm = read(tmp_path, collection(points[0], feature(*corners, kind="Polygon"), points[1]), "farm.json")
    assert (farm.field_x, farm.field_y) == pytest.approx((298.50, 222.4), abs=0.1)
    assert farm.xy[0] == pytest.approx((farm.field_x / 4, farm.field_y / 2), abs=0.05)
    assert farm.xy[1] == pytest.approx((farm.field_x / 2, 0.0), abs=0.01)
    assert farm.survey.where == ["line 2, feature 1", "line 4, feature 3"]


def test_cycles_of_a_file_become_the_farms(tmp_path):
    """The types are the different cycles in rising order, whatever the configuration had."""
    farm = read(tmp_path, "x,y,Cycle\n1,1,60\n2,2,30\n3,3,60\n").on(FEW)
    assert farm.world.sensor_cycles == (30, 60)
    assert farm.world.sites == ((1.0, 1.0, 1.0), (2.0, 2.0, 0.0), (3.0, 3.0, 1.0))
    features = [feature(1.0, 1.0, cycle=50), feature(1.0001, 1.0, cycle=20)]
    assert read(tmp_path, collection(*features), "farm.geojson").on(FEW).world.sensor_cycles == (20, 50)


def test_types_of_a_file_are_the_configurations(tmp_path):
    """They are numbers of the configured cycles."""
    farm = read(tmp_path, "x,y,type\n1,1,2\n2,2,0\n").on(FEW)
    assert farm.world.sensor_cycles == (40, 50, 60)
    assert sorted(make_layout(farm, 3).sensor_cycle_steps.tolist()) == [40, 60]


def test_plots_keep_their_size(tmp_path):
    """On a field of 900 m x 110 m with plots of at most 20 m there are 45 x 6, and never more than 256."""
    world = read(tmp_path, "# field: 900 x 110 m\nx,y\n1,1\n").on(FEW).world
    assert (world.plots_x, world.plots_y, world.sensors, world.field_x) == (45, 6, 1, 900.0)
    world = read(tmp_path, "# field: 9000 x 3 m\nx,y\n1,1\n").on(FEW).world
    assert (world.plots_x, world.plots_y) == (256, 1)


@pytest.mark.parametrize(
    ("name", "corner"),
    [
        ("farm.csv", (0.0, 0.0)),
        ("farm.geojson", (0.0, 0.0)),
        ("farm.geojson", (11.65, 48.4)),
        ("farm.geojson", (179.998, -36.8)),
        ("farm.json", (25.0, 69.5)),
    ],
)
@pytest.mark.parametrize("side", [400.0, 5000.0])
def test_what_is_saved_is_what_is_read(tmp_path, name, corner, side):
    """Every sensor within 1 mm of its place with its cycle, and the field to 1 mm; saved again it is the same file."""
    config = FarmConfig(world=WorldConfig(density="patchy", field_x=side, field_y=0.75 * side + 0.125))
    layout, path = make_layout(config, 3), tmp_path / name
    write_farm(path, config, 3, corner)
    loaded = read_farm(path).on(FarmConfig())
    again = make_layout(loaded, 11)
    assert (loaded.world.field_x, loaded.world.field_y) == pytest.approx((side, config.world.field_y), abs=0.001)
    distance, partner = cKDTree(again.sensor_xy).query(layout.sensor_xy)
    assert distance.max() < 0.001
    assert len(set(partner.tolist())) == config.world.sensors
    np.testing.assert_array_equal(again.sensor_cycle_steps[partner], layout.sensor_cycle_steps)


def test_ten_thousand_sensors_are_read_and_one_more_is_not(tmp_path):
    """The largest farm loads from both formats; one sensor more is refused where it stands."""
    lines = [f"{x},{y}" for x in range(1, 101) for y in range(1, 101)]
    assert len(read(tmp_path, "\n".join(["x,y", *lines])).on(FEW).world.sites) == 10_000
    with pytest.raises(ConfigError, match=r"farm\.csv, line 10002: there are more than 10000 sensors\.$"):
        read(tmp_path, "\n".join(["x,y", *lines, "0,0"]))
    points = [feature(x * 1e-5, y * 1e-5) for x in range(101) for y in range(100)]
    assert len(read(tmp_path, collection(*points[:10_000]), "farm.json").xy) == 10_000
    with pytest.raises(ConfigError, match=r"line 10002, feature 10001: there are more than 10000 sensors\.$"):
        read(tmp_path, collection(*points), "farm.json")


BAD_CSV = [
    ("", "{} has no header line with the column names."),
    ("# nothing\n\n,,\n", "{} has no header line with the column names."),
    ("x,y\n", "{} holds 0 sensors; a farm has 1 to 10000."),
    ("1,2\n3,4\n", "{}, line 1: the header must name exactly one of x,y and easting,northing and lon,lat, each once, "),
    ("x,y,lon,lat\n1,2,3,4\n", "{}, line 1: the header must name exactly one of"),
    ("x,x,y\n1,2,3\n", "{}, line 1: the header must name exactly one of"),
    ("x,lat\n1,2\n", "{}, line 1: the header must name exactly one of"),
    ("x,y,type,cycle\n1,2,0,40\n", "{}, line 1: the header names more than one of type and cycle."),
    ("# a\n\nx,y\n1,2\n3,abc\n", "{}, line 5: 'abc' is not a number."),
    ("x,y\n1,\n", "{}, line 2: '' is not a number."),
    ("x,y\nnan,1\n", "{}, line 2: 'nan' is not a number."),
    ("x,y\n1,inf\n", "{}, line 2: 'inf' is not a number."),
    ("x,y\n1,1e999\n", "{}, line 2: '1e999' is not a number."),
    ("x,y\n1,1_0\n", "{}, line 2: '1_0' is not a number."),
    ("x,y\n1,\u0661\n", "{}, line 2: '\\u0661' is not a number."),
    ("x,y\n1,\x1b[2J\n", "{}, line 2: '\\x1b[2J' is not a number."),
    ("x,y\n1," + "9" * 400 + "\n", "{}, line 2: '" + "9" * 37 + "...' is not a number."),
    ("x;y\n1,5;2\n", "{}, line 2: '1,5' is not a number."),
    ("x,y\n1,2,3\n", "{}, line 2: 3 values where the header has 2."),
    ("x,y\n1\n", "{}, line 2: 1 values where the header has 2."),
    ('x,y\n"1,2\n', "{}, line 2: not CSV: unexpected end of data."),
    ("x,y\n1,1\n-0.5,2\n", "{}, line 3: x and y begin at 0 in the field's south-west corner; name the columns"),
    ("# field: 10 x 10 m\nx,y\n1,1\n11,2\n", "{}, line 4: the sensor lies outside the field of 10 m x 10 m."),
    ("# field: 10 x ten m\nx,y\n1,1\n", "{}, line 1: 'ten' is not a number."),
    ("# field: 0 x 10 m\nx,y\n0,1\n", "{}: a field of 0 m x 10 m is none: above 0, at most 20000 m."),
    ("# field: 30000 x 10 m\nx,y\n0,1\n", "{}: a field of 30000 m x 10 m is none: above 0, at most 20000 m."),
    ("# field: 10 x 10 m\nlon,lat\n1,1\n", "{}, line 1: the field's size is allowed only with the columns x and y."),
    ("x,y\n1,1\n2,2\n\n1.0001,1\n", "{}, line 5: the sensor stands where that of line 2 does."),
    ("x,y\n1,1\n30000,1\n", "{} spans 30 km; a farm spans at most 20 km."),
    ("easting,northing\n1,1\n1e300,1\n", "{} spans 1e+297 km; a farm spans at most 20 km."),
    ("lon,lat\n11,48\n48,191\n", "{}, line 3: longitude 48, latitude 191 is no place: at most 180 and 90 degrees."),
    ("lon,lat\n11,48\n48,11\n", " km; a farm spans at most 20 km."),
    ("lon,lat\n0,0\n180,0\n", " km; a farm spans at most 20 km."),
    ("x,y,cycle\n1,1,0\n", "{}, line 2: '0' is no cycle, a whole number from 1 to 1000000."),
    ("x,y,cycle\n1,1,40.5\n", "{}, line 2: '40.5' is no cycle, a whole number from 1 to 1000000."),
    ("x,y,type\n1,1,-1\n", "{}, line 2: '-1' is no type, a whole number from 0 to 255."),
    ("x,y,type\n1,1,\n", "{}, line 2: '' is no type, a whole number from 0 to 255."),
    ("x,y,type\n1,1,0\n2,2,3\n", "{}, line 3: there is no type 3; the types are 0 to 2."),
    (b"x,y\n1,2\n\xff,3\n", "{}, line 3: the text is not UTF-8."),
]

POINT = feature(11.0, 48.0)
SQUARE = [(11.0, 48.0), (11.001, 48.0), (11.001, 48.001), (11.0, 48.0)]
BOW_TIE = [(11.0, 48.0), (11.001, 48.001), (11.001, 48.0), (11.0, 48.001), (11.0, 48.0)]


def with_hole(**properties):
    """Return a polygon with two rings."""
    polygon = feature(*SQUARE, kind="Polygon", **properties)
    polygon["geometry"]["coordinates"].append([[11.0005, 48.0001], [11.0006, 48.0001], [11.0006, 48.0002]])
    return polygon


BAD_GEOJSON = [
    ("", "{}, line 1: not JSON: { is missing."),
    ("[1, 2]", "{}, line 1: not JSON: { is missing."),
    ('{"type": "FeatureCollection",\n"features": [\n{]}', "{}, line 3: not JSON: "),
    (collection(POINT) + "x", "{}, line 3: not JSON: something stands behind the end."),
    (collection(POINT)[:-1], "{}, line 3: not JSON: } is missing."),
    ('{"type": "FeatureCollection", 3: 4}', "{}, line 1: not JSON: "),
    (collection("[" * 100_000), "{} is not JSON that can be read: "),
    (collection(POINT, big=0).replace('"big": 0', '"big": ' + "9" * 5000), "{} is not JSON that can be read: "),
    (collection('{"type": "Feature", "a": NaN}'), "{} is not JSON that can be read: 'NaN is no number'."),
    ("{}", "{} is no GeoJSON FeatureCollection with features."),
    (json.dumps(POINT), "{} is no GeoJSON FeatureCollection with features."),
    (collection(), "{} is no GeoJSON FeatureCollection with features."),
    ('{"type": "FeatureCollection", "features": 7}', "{} is no GeoJSON FeatureCollection with features."),
    (collection(feature(*SQUARE, kind="Polygon")), "{} holds 0 sensors; a farm has 1 to 10000."),
    (collection(POINT, "7"), "{}, line 3, feature 2: not a Feature."),
    (collection(POINT, {"type": "Point"}), "{}, line 3, feature 2: not a Feature."),
    (
        collection({"type": "Feature", "geometry": None}),
        "{}, line 2, feature 1: no geometry, where a sensor is a Point",
    ),
    (
        collection(json.dumps(POINT).replace("Point", "LineString")),
        "{}, line 2, feature 1: a geometry 'LineString', where a sensor is a Point and the field's boundary a Polygon.",
    ),
    (collection(POINT, feature(11.0)), "{}, line 3, feature 2: coordinates must be [longitude, latitude], not [11.0]."),
    (collection(feature("11", 48.0)), "coordinates must be [longitude, latitude], not something else."),
    (collection(feature(True, 48.0)), "coordinates must be [longitude, latitude], not [true, 48.0]."),
    (
        collection(feature(48.4, 211.7)),
        "{}, line 2, feature 1: [longitude, latitude] must lie within 180 and 90 degrees, not [48.4, 211.7].",
    ),
    (collection(feature(10**400, 1)), "within 180 and 90 degrees, not [a huge number, 1]."),
    (
        collection('{"type": "Feature", "geometry": {"type": "Point", "coordinates": [1e999, 1]}}'),
        "within 180 and 90 degrees, not [an infinite number, 1].",
    ),
    (collection(feature(1.0, 1.0, cycle=0)), "the cycle must be a whole number from 1 to 1000000, not 0."),
    (collection(feature(1.0, 1.0, cycle="40")), "the cycle must be a whole number from 1 to 1000000, not '40'."),
    (collection(feature(1.0, 1.0, type=True)), "the type must be a whole number from 0 to 255, not true."),
    (collection(feature(1.0, 1.0, type=1, cycle=40)), "the sensor has both a type and a cycle."),
    (
        collection(feature(1.0, 1.0, type=1), POINT),
        "{}, line 3, feature 2: either every sensor has a type, or every one ",
    ),
    (
        collection(POINT, feature(*SQUARE, kind="Polygon"), feature(*SQUARE, kind="Polygon")),
        '{}, line 4, feature 3: a second Polygon without "no_fly": true or a growth; a farm has one field.',
    ),
    (collection(POINT, feature(*BOW_TIE, kind="Polygon")), "{}, line 3, feature 2: the boundary crosses itself."),
    (collection(POINT, with_hole()), "{}, line 3, feature 2: the boundary has a hole, and none may have any."),
    (
        collection(POINT, with_hole(no_fly=True)),
        "{}, line 3, feature 2: a no-fly zone has a hole, and none may have any.",
    ),
    (collection(POINT, feature(*SQUARE[:3], kind="Polygon")), "the boundary must be a ring of 4 to 10000 positions"),
    (
        collection(feature(*SQUARE, kind="Polygon"), feature(11.002, 48.0)),
        "{}, line 3, feature 2: the sensor lies outside the field of ",
    ),
    (collection(feature(*[(11.0, 48.0)] * 4, kind="Polygon"), POINT), "a field of 0 m x 0 m is none"),
    (collection(POINT, POINT), "{}, line 3, feature 2: the sensor stands where that of line 2, feature 1 does."),
    (collection(POINT, feature(48.0, 11.0)), " km; a farm spans at most 20 km."),
    (
        collection(POINT, crs={"type": "name", "properties": {"name": "EPSG:25832"}}),
        "{} names another coordinate system",
    ),
    (b'{"type":\n"\xff"}', "{}, line 2: the text is not UTF-8."),
]


@pytest.mark.parametrize(
    ("name", "text", "sentence"),
    [("a.csv", *case) for case in BAD_CSV] + [("a.geojson", *case) for case in BAD_GEOJSON],
    ids=[case[1][:60] for case in BAD_CSV + BAD_GEOJSON],
)
def test_a_bad_file_is_refused_with_file_and_line(tmp_path, monkeypatch, name, text, sentence):
    """One sentence that begins with the file, names the line where there is one, and says what is wrong."""
    monkeypatch.chdir(tmp_path)
    Path(name).write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(ConfigError) as caught:
        read_farm(Path(name)).on(FEW)
    said = str(caught.value)
    assert sentence.replace("{} ", f"{name} ").replace("{},", f"{name},").replace("{}:", f"{name}:") in said
    assert said.startswith(name)
    assert said.endswith(".")
    assert said.count(". ") == 0
    assert said.isprintable()


def test_crs_of_wgs84_is_accepted(tmp_path):
    """What older programs add to say that coordinates are longitude and latitude does no harm."""
    crs = {"type": "name", "properties": {"name": "urn:ogc:def:crs:OGC:1.3:CRS84"}}
    assert len(read(tmp_path, collection(POINT, crs=crs), "farm.geojson").xy) == 1


def test_a_file_that_cannot_be_read_or_written_is_refused(tmp_path):
    """Missing, a folder, another ending, too large, a pipe, a folder that does not exist."""
    for path, said in (
        (tmp_path / "nowhere.csv", "cannot be read: No such file"),
        (tmp_path / "farm.shp", "must end in .csv, .geojson, .json."),
        (Path("a\0b.csv"), "cannot be read"),
    ):
        with pytest.raises(ConfigError, match=said.replace(".", r"\.")):
            read_farm(path)
    (tmp_path / "folder.csv").mkdir()
    with pytest.raises(ConfigError, match="is no plain file"):
        read_farm(tmp_path / "folder.csv")
    with (tmp_path / "large.csv").open("wb") as large:
        large.truncate(9 * 1024 * 1024)
    with pytest.raises(ConfigError, match="is larger than 8 MiB"):
        read_farm(tmp_path / "large.csv")
    with pytest.raises(ConfigError, match="cannot be written: No such file"):
        write_farm(tmp_path / "no" / "farm.csv", FEW, 0)
    with pytest.raises(ConfigError, match="no farm lies at longitude 0 and latitude 91"):
        write_farm(tmp_path / "farm.geojson", FEW, 0, (0.0, 91.0))


def test_what_does_not_fit_the_configuration_is_refused_with_the_file(tmp_path):
    """Fewer sensors than a UAV observes, and a cycle that is no whole number of steps."""
    with pytest.raises(ConfigError, match=r"farm\.csv does not fit the configuration: observation\.sensors 10 exceeds"):
        read(tmp_path, "x,y\n1,1\n").on(FarmConfig())
    slow = FarmConfig(world=WorldConfig(step_seconds=2.0), observation=ObservationConfig(sensors=1))
    with pytest.raises(ConfigError, match=r"farm\.csv does not fit the configuration: a cycle of 41 s is not a whole"):
        read(tmp_path, "x,y,cycle\n1,1,41\n").on(slow)


CELLS = st.one_of(
    st.floats(width=32).map(str), st.integers(-5, 500).map(str), st.sampled_from(["", "x", "y", "lon", "lat", '"', "#"])
)
ROWS = st.lists(st.lists(CELLS, max_size=4).map(",".join), max_size=8).map("\n".join)
HEADS = st.sampled_from(["", "x,y\n", "x,y,type\n", "lon,lat\n", "easting,northing,cycle\n", "# field: 9 x 9 m\nx,y\n"])
JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=3), inner, max_size=3),
    max_leaves=8,
)
COORDINATES = st.lists(st.integers(-200, 200) | st.floats(-1e-3, 1e-3) | JSON, max_size=3)
GEOMETRIES = st.fixed_dictionaries(
    {"type": st.sampled_from(["Point", "Polygon", "X"]), "coordinates": COORDINATES | st.lists(st.lists(COORDINATES))}
)
FEATURES = JSON | st.fixed_dictionaries(
    {
        "type": st.just("Feature"),
        "geometry": GEOMETRIES | JSON,
        "properties": st.fixed_dictionaries({}, optional={"cycle": JSON, "type": JSON}) | JSON,
    }
)


def check_farm_or_sentence(parse, text):
    """Fail unless a text is a farm, or is refused in one line that names the file."""
    refusal, farm = "", None
    try:
        farm = settle(parse(text, "f")).on(FEW)
    except ConfigError as error:
        refusal = str(error)
    if farm is None:
        assert refusal.startswith("f")
        assert "\n" not in refusal
    else:
        assert make_layout.__wrapped__(farm, 0).sensor_xy.shape == (farm.world.sensors, 2)


@settings(max_examples=150, deadline=None)
@given(text=st.text(max_size=80) | st.builds("{}{}".format, HEADS, ROWS))
def test_any_text_as_csv_is_a_farm_or_one_sentence(text):
    """No text, near to a farm or far from one, raises anything but ConfigError."""
    check_farm_or_sentence(parse_csv, text)


@settings(max_examples=150, deadline=None)
@given(
    text=st.text(max_size=80)
    | JSON.map(json.dumps)
    | st.lists(FEATURES, max_size=5).map(lambda features: collection(*features))
)
def test_any_text_as_geojson_is_a_farm_or_one_sentence(text):
    """No text, near to a farm or far from one, raises anything but ConfigError."""
    check_farm_or_sentence(parse_geojson, text)


@settings(max_examples=60, deadline=None)
@given(
    position=st.integers(0, 3000),
    byte=st.integers(0, 255),
    cut=st.booleans(),
    example=st.sampled_from(["csv", "geojson"]),
)
def test_a_damaged_file_is_a_farm_or_one_sentence(position, byte, cut, example, tmp_path_factory):
    """The examples with a byte changed, or cut there, raise nothing but ConfigError."""
    whole = (Path(__file__).parents[3] / f"docs/examples/orchard.{example}").read_bytes()
    damaged = whole[:position] + (b"" if cut else bytes([byte]) + whole[position + 1 :])
    path = tmp_path_factory.getbasetemp() / f"damaged.{example}"
    path.write_bytes(damaged)
    refusal, sensors = str(path), 1
    try:
        sensors = len(read_farm(path).xy)
    except ConfigError as error:
        refusal = str(error)
    assert refusal.startswith(str(path))
    assert 1 <= sensors <= 45
