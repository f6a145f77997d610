"""Places where UAVs can work: boxes, reaches and grids."""

import tracemalloc

import numpy as np
import pytest

from eia_sec.common.config import FarmConfig, WorldConfig
from eia_sec.rollout.heuristics.tasks.horizon import plot_grid, sensor_grid
from eia_sec.rollout.heuristics.tasks.sites import (
    images_succeed,
    packet_chances,
    pairs_within,
    radio_range,
    radio_reach,
    sensor_stops,
)
from eia_sec.rollout.sim.layout import make_layout
from eia_sec.rollout.sim.sweep_routes import plot_boxes, plot_centres
from tests.rollout.heuristics.small_farm import SMALL

WORLD = SMALL.world


def test_every_place_in_a_plot_box_gives_an_image():
    """From the corners, edges and middle of a plot's box its image succeeds; beyond a corner it does not."""
    boxes, centre = plot_boxes(SMALL), plot_centres(WORLD)
    half = boxes[1, 0] - centre[0]
    assert (half > 6.0).all()
    around = np.stack(np.meshgrid(np.linspace(-1.0, 1.0, 5), np.linspace(-1.0, 1.0, 5)), axis=-1).reshape(-1, 2)
    assert images_succeed(SMALL, centre[37] + half * around, np.full(25, 37)).all()
    assert images_succeed(SMALL, centre[37] + np.array([half, 1.1 * half]), np.full(2, 37)).tolist() == [True, False]


def test_radio_reach_is_where_the_chance_falls():
    """PLR is 0.045 at 28 m and 0.17 at 30 m beside the sensor; every sensor has a stop within reach."""
    near, far = packet_chances(SMALL, np.array([28.0, 30.0]))
    assert near == pytest.approx(0.955, abs=0.002)
    assert far == pytest.approx(0.833, abs=0.002)
    assert 27.5 < radio_reach(SMALL, 0.95) < 28.5
    xy = make_layout(SMALL, 7).sensor_xy
    stops = sensor_stops(SMALL, xy).mean(axis=0)
    assert np.linalg.norm(xy[:, None] - stops, axis=2).min(axis=1).max() < 30.0


def test_pairs_are_those_of_all_distances():
    """Pairs within a distance, and their distances, are those of the full distance matrix, in order."""
    random = np.random.default_rng(0)
    places, others = random.uniform(0.0, 100.0, (300, 2)), random.uniform(0.0, 100.0, (40, 2))
    others[7] = places[11]
    distance = np.linalg.norm(places[:, None] - others, axis=2)
    place, other, apart = pairs_within(places, others, 20.0)
    np.testing.assert_array_equal(np.stack([place, other]), np.nonzero(distance <= 20.0))
    np.testing.assert_allclose(apart, distance[place, other])
    assert (11, 7) in set(zip(place.tolist(), other.tolist(), strict=True))
    assert [len(part) for part in pairs_within(places, others + 1000.0, 20.0)] == [0, 0, 0]


def test_no_chance_is_missed_within_the_radio_range():
    """Beyond the range of a chance no chance is greater, and just within it one is."""
    far = radio_range(SMALL, 0.02)
    assert (packet_chances(SMALL, np.arange(far, 400.0, 0.1)) <= 0.02).all()
    assert packet_chances(SMALL, np.array([far - 0.25])) > 0.02
    assert radio_range(SMALL, 1.0) == 0.0


def test_a_wide_field_takes_memory_for_what_is_near():
    """Sites of a field of 5 km with 1,000 sensors are found in 200 MB; all its distances would take gigabytes."""
    wide = FarmConfig(world=WorldConfig(field_x=5000.0, field_y=5000.0, sensors=1000))
    xy = np.random.default_rng(0).uniform(0.0, 5000.0, (1000, 2))
    tracemalloc.start()
    stops, heard = sensor_stops(wide, xy), sensor_grid(wide, xy)
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert most < 200e6
    assert np.unique(heard.site).size == 1000
    assert np.linalg.norm(xy[:, None] - stops.mean(axis=0), axis=2).min(axis=1).max() < 30.0


def test_lattices_know_who_is_served():
    """A lattice place serves the plot that holds it, and hears near sensors with the chance of their distance."""
    plots = plot_grid(SMALL)
    assert np.abs(np.diff(plots.place[[0, 1]], axis=0)).max() == pytest.approx(10.0)
    assert (np.diff(plots.first) == 1).all()
    np.testing.assert_array_equal((plots.place // 20.0) @ (10, 1), plots.site)
    xy = make_layout(SMALL, 7).sensor_xy
    heard = sensor_grid(SMALL, xy)
    node = 210
    sites = heard.site[heard.first[node] : heard.first[node + 1]]
    distance = np.linalg.norm(xy - heard.place[node], axis=1)
    assert set(np.flatnonzero(distance < 35.0)) <= set(sites.tolist()) <= set(np.flatnonzero(distance < 39.0))
    np.testing.assert_allclose(
        heard.chance[heard.first[node] : heard.first[node + 1]], packet_chances(SMALL, distance[sites])
    )
