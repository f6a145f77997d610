"""The densities of a farm: spaced, as many as asked for, pure in the seed, and distinct in their statistics."""

import hashlib
from dataclasses import replace
from typing import get_args

import numpy as np
import pytest
from scipy.spatial import cKDTree

from eia_sec.common.config import FarmConfig, ObservationConfig, WorldConfig
from eia_sec.common.config.farm.world import Density
from eia_sec.common.errors import ConfigError
from eia_sec.rollout.sim.layout import GIVEN, make_layout

KINDS = get_args(Density)
ARRAYS = ("sensor_xy", "sensor_type", "sensor_cycle_steps", "cell_start")
SEEDS = range(12)


def farm(density, **changes):
    return FarmConfig(
        world=replace(WorldConfig(), density=density, **changes), observation=ObservationConfig(sensors=1)
    )


def dispersion(density, bins=8):
    """Variance over mean of the counts in a raster, for each seed: below 1 is more even than chance, above is less."""
    counts = [_counts(make_layout(farm(density), seed), bins) for seed in SEEDS]
    return np.array([count.var() / count.mean() for count in counts])


def _counts(layout, bins):
    return np.histogram2d(*layout.sensor_xy.T, bins=bins, range=[[0.0, 400.0], [0.0, 400.0]])[0]


@pytest.mark.parametrize(
    ("seed", "digest"),
    [
        (0, "d5ce230ac7b2220f2adb47a23b2ae6d7b7106ad2b21b8f2e0e896d23e8e9dc89"),
        (1, "a57a42c86ee73b76403443f70a32e0ca2d12e607b296f814e5923e83c92e3d3f"),
        (1000, "322a8d75b1f322c0f5fe563e8f5643d28c4b2ab234b359495c32c7d59f737218"),
    ],
)
def test_the_default_farms_are_those_of_the_committed_results(seed, digest):
    """Every bit of the layouts that training and evaluation of research/results flew on."""
    layout = make_layout(FarmConfig(), seed)
    assert layout.density == "irregular"
    assert hashlib.sha256(b"".join(getattr(layout, name).tobytes() for name in ARRAYS)).hexdigest() == digest


@pytest.mark.parametrize("density", KINDS)
@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"sensors": 900, "field_y": 600.0, "sensor_spacing": 9.0},
        {"sensors": 50},
        {"sensors": 1},
        {"sensors": 700},
        {"sensor_spacing": 0.0},
        {"sensors": 300, "sensor_spacing": 15.0, "field_x": 800.0, "field_y": 200.0},
    ],
    ids=str,
)
def test_every_density_keeps_count_and_spacing(density, changes):
    """Exactly as many as asked for, inside the field, at least the spacing apart, also where it is nearly full."""
    config = farm(density, **changes)
    world = config.world
    for seed in range(5):
        xy = make_layout(config, seed).sensor_xy
        assert xy.shape == (world.sensors, 2)
        assert ((xy >= 0.0) & (xy <= (world.field_x, world.field_y))).all()
        if world.sensors > 1:
            assert cKDTree(xy).query(xy, k=2)[0][:, 1].min() >= world.sensor_spacing


@pytest.mark.parametrize("density", KINDS)
def test_every_density_is_a_pure_function_of_the_seed(density):
    """Equal for equal seeds when made anew, another for another seed, and never that of another density."""
    first, again = (make_layout.__wrapped__(farm(density), 7) for _ in range(2))
    for name in ARRAYS:
        np.testing.assert_array_equal(getattr(first, name), getattr(again, name))
    assert first.density == again.density
    assert not np.array_equal(first.sensor_xy, make_layout(farm(density), 8).sensor_xy)
    others = [make_layout(farm(kind), 7) for kind in KINDS if kind not in (density, "mixed")]
    same = [other.density for other in others if np.array_equal(first.sensor_xy, other.sensor_xy)]
    assert same == ([first.density] if density == "mixed" else [])


@pytest.mark.parametrize("density", KINDS)
def test_what_does_not_fit_is_refused(density):
    """More sensors than the field holds at that spacing are refused with the same sentence under every density."""
    with pytest.raises(ConfigError) as caught:
        make_layout(farm(density, sensors=1400), 0)
    assert str(caught.value) == "1400 sensors at least 10 m apart do not fit into 400 m x 400 m."


def test_counts_in_a_raster_distinguish_the_densities():
    """On average: uniform is more even than chance, irregular less so, clustered and patchy are lumpy."""
    mean = {density: dispersion(density).mean() for density in KINDS}
    assert mean["uniform"] < 0.6
    assert 0.8 < mean["irregular"] < 1.4
    assert 1.6 < mean["clustered"] < 3.0
    assert mean["patchy"] > 3.0
    assert dispersion("uniform").max() < dispersion("clustered").min()


def test_a_patchy_farm_has_empty_parts():
    """A fifth to six tenths of a patchy farm's 40 m squares hold no sensor; of a uniform one's next to none."""
    empty = {
        density: np.array([(_counts(make_layout(farm(density), seed), 10) == 0).mean() for seed in SEEDS])
        for density in ("patchy", "uniform")
    }
    assert (empty["patchy"] > 0.2).all()
    assert (empty["patchy"] < 0.6).all()
    assert empty["uniform"].max() < 0.05


def _sharpest_rows(xy):
    """How well the best of many directions and distances of rows explains places: 1 when all stand on lines."""
    angles, pitches = np.deg2rad(np.arange(0.0, 180.0, 1.5)), np.arange(18.0, 30.0, 0.2)
    across = xy @ np.stack([-np.sin(angles), np.cos(angles)])
    phase = np.exp(2j * np.pi * across[:, :, None] / pitches)
    return float(np.abs(phase.mean(axis=0)).max())


def test_a_banded_farm_has_rows_and_no_other_has():
    """Places across the best direction repeat themselves on banded farms only."""
    rows = {
        d: [_sharpest_rows(make_layout(farm(d), seed).sensor_xy) for seed in range(2)] for d in KINDS if d != "mixed"
    }
    assert min(rows.pop("banded")) > 0.75
    assert max(map(max, rows.values())) < 0.4


def test_mixed_draws_every_density():
    """Over many farms each of the five turns up about equally often, and the layout says which it is."""
    kinds = [make_layout(farm("mixed", sensors=20), seed).density for seed in range(150)]
    assert set(kinds) == set(KINDS) - {"mixed"}
    assert min(map(kinds.count, set(kinds))) > 15
    name = kinds[3]
    np.testing.assert_array_equal(
        make_layout(farm("mixed", sensors=20), 3).sensor_xy, make_layout(farm(name, sensors=20), 3).sensor_xy
    )


SITES = tuple((float(x), float(y)) for x in range(5, 300, 20) for y in range(3, 200, 30))


def given(sites, **changes):
    world = WorldConfig(sensors=len(sites), sites=tuple(sites), field_x=300.0, field_y=200.0, **changes)
    return FarmConfig(world=world, observation=ObservationConfig(sensors=5))


def test_given_places_are_kept_and_the_seed_decides_the_rest():
    """The same places on every farm, closer than the spacing if need be; balanced types of the seed's own."""
    config = given([*SITES, (5.5, 3.0)])
    one, two = make_layout(config, 1), make_layout(config, 2)
    assert one.density == GIVEN
    assert sorted(map(tuple, one.sensor_xy.tolist())) == sorted(config.world.sites)
    np.testing.assert_array_equal(one.sensor_xy, two.sensor_xy)
    assert not np.array_equal(one.sensor_type, two.sensor_type)
    assert np.ptp(np.bincount(one.sensor_type)) <= 1


def test_given_types_stay_with_their_places():
    """However the sensors are numbered, each keeps its type and has that type's cycle, on every farm."""
    sites = [(x, y, float(int(x + y) % 3)) for x, y in SITES]
    for seed in (0, 5):
        layout = make_layout(given(sites), seed)
        found = {tuple(xy): kind for xy, kind in zip(layout.sensor_xy.tolist(), layout.sensor_type, strict=True)}
        assert found == {(x, y): int(kind) for x, y, kind in sites}
        np.testing.assert_array_equal(layout.sensor_cycle_steps, np.array([40, 50, 60])[layout.sensor_type])


def test_given_places_on_the_edges_have_a_cell():
    """Corners and edges of the field belong to the outermost cells."""
    layout = make_layout(given([(0.0, 0.0), (300.0, 0.0), (300.0, 200.0), (0.0, 200.0), (150.0, 200.0)]), 0)
    assert layout.cell_start[-1] == 5
    assert sorted(np.flatnonzero(np.diff(layout.cell_start)).tolist()) == [0, 7, 55, 88, 95]
