"""Collectors' tours where links count: near a monitor's area, so that one relay can be near both."""

from dataclasses import replace

import numpy as np

from eia_sec.common.config import WorldConfig
from eia_sec.common.config.presets import preset
from eia_sec.rollout.evaluation import evaluate
from eia_sec.rollout.heuristics.tasks.tour import plot_tours, tours_beside_monitors
from eia_sec.rollout.policies import policy_of
from eia_sec.rollout.sim.sweep_routes import plot_centres

WORLD = WorldConfig()
STOPS = np.random.default_rng(3).uniform(0.0, 400.0, (60, 2))


def test_every_stop_belongs_to_the_nearest_monitors_area():
    """Each is in one tour, the one whose monitor's plots have the nearest middle."""
    tours = tours_beside_monitors(STOPS, WORLD)
    assert sorted(np.concatenate(tours)) == list(range(60))
    middles = np.array([plot_centres(WORLD)[list(plots)].mean(axis=0) for plots in plot_tours(WORLD)])
    for area, tour in enumerate(tours):
        apart = np.linalg.norm(STOPS[tour][:, None] - middles, axis=2)
        assert (apart.argmin(axis=1) == area).all()


def test_no_tours_without_pairs():
    """With more collectors than monitors, or no stop in some area, there are none."""
    assert tours_beside_monitors(STOPS, replace(WORLD, collection_uavs=5)) == []
    assert tours_beside_monitors(STOPS[STOPS.max(axis=1) < 190.0], WORLD) == []


def test_only_links_that_count_change_the_tours():
    """Links of any length: the same farm, flown by another division of the sensors."""
    farm = preset("instant").farm
    short = replace(farm, world=replace(farm.world, steps=60))
    linked = replace(short, relay=replace(short.relay, require_link=True, link_range=2000.0))
    scores = [
        evaluate(each, policy_of("tour+centroid", each), [1000], 1, name="tour").total.types
        for each in (short, linked, replace(linked, relay=short.relay))
    ]
    assert scores[0] == scores[2]
    assert scores[0]["monitoring"] == scores[1]["monitoring"]
    assert scores[0]["collection"] != scores[1]["collection"]
