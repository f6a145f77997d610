"""Relays that keep links up."""

from dataclasses import replace

import numpy as np
import pytest

from eia_sec.common.config.presets import preset
from eia_sec.rollout.evaluation import evaluate
from eia_sec.rollout.heuristics.registry import default_relays
from eia_sec.rollout.policies import policy_of
from eia_sec.rollout.sim.batch import FarmBatch
from eia_sec.rollout.sim.conditions.links import joined_relays
from eia_sec.rollout.sim.layout import make_layout
from tests.rollout.sim.properties.strategies import placed

FARM = preset("connected").farm
NEAR = replace(FARM, relay=replace(FARM.relay, link_range=70.0), world=replace(FARM.world, steps=150))


def tour_flown(config, relays):
    """Fly an episode of the tour on two farms; yield the batch after every step."""
    batch, policy = FarmBatch(config, 2), policy_of(f"tour+{relays}", config)
    for index in range(2):
        batch.reset(index, 1000 + index, 7)
        policy.reset(batch, index)
    while not batch.ended.all():
        batch.step(policy.act(batch))
        yield batch


def linked_share(config, relays):
    """Return the share of links that are up, over an episode of the tour."""
    up = []
    for batch in tour_flown(config, relays):
        offset = batch.position[:, 4:] - np.take_along_axis(batch.position, batch.assignment[..., None], axis=1)
        up.append(np.hypot(*np.moveaxis(offset, -1, 0)) <= config.relay.link_range)
    return np.mean(up)


def test_more_links_are_up_than_with_the_other_relays():
    """At a range of 70 m the search ahead keeps many more links than relays that wait or follow a centre."""
    share = {relays: linked_share(NEAR, relays) for relays in ("coverage", "centroid", "search")}
    assert share["coverage"] > share["centroid"] + 0.1
    assert share["coverage"] > share["search"] + 0.1


def test_links_that_reach_everywhere_need_no_flight():
    """Where no link is in danger, relays stay where they are."""
    config = replace(FARM, relay=replace(FARM.relay, link_range=2000.0), world=replace(FARM.world, steps=20))
    batch, policy = FarmBatch(config, 1), policy_of("tour+coverage", config)
    batch.reset(0, 1000, 7)
    policy.reset(batch, 0)
    start = batch.position[0, :4].copy()
    for _ in range(20):
        batch.step(policy.act(batch))
    assert np.abs(batch.position[0, :4] - start).max() < 2.0  # they idle back and forth


@pytest.mark.parametrize(("config", "name"), [(FARM, "coverage"), (preset("instant").farm, "search")])
def test_a_task_heuristic_brings_the_relays_that_the_farm_needs(config, name):
    """`tour` alone is `tour+coverage` where links count, and `tour+search` elsewhere."""
    assert default_relays(config) == name
    short = replace(config, world=replace(config.world, steps=30))
    flown = [evaluate(short, policy_of(policy, short), [1000], 1, name="").total for policy in ("tour", f"tour+{name}")]
    assert flown[0] == flown[1]


CHAINED = replace(NEAR, relay=replace(NEAR.relay, link_range=150.0, base="south", hop_range=150.0))


def joined_share(config):
    """Return the share of relays that are joined in the second half of an episode of the tour."""
    joined = [joined_relays(CHAINED, batch.position[:, :4]) for batch in tour_flown(config, "coverage")]
    return np.mean(joined[len(joined) // 2 :])


def test_relays_keep_a_chain_to_the_base_station():
    """Wherever they start, hops soon lead from nearly all of them to the base station, which they leave without one."""
    alone = replace(CHAINED, relay=replace(CHAINED.relay, base=""))
    assert joined_share(CHAINED) > 0.9
    assert joined_share(alone) < 0.5


def test_a_relay_that_serves_nobody_stays_in_the_chain():
    """The first relay joins the second one, which serves both UAVs, to the base station."""
    world = replace(FARM.world, communication_uavs=2, monitoring_uavs=1, collection_uavs=1, steps=40)
    relay = replace(FARM.relay, capacity=2, link_range=300.0, base="south", hop_range=150.0)
    config = replace(FARM, world=world, relay=relay)
    batch, policy = FarmBatch(config, 1), policy_of("tour+coverage", config)
    places = np.array([[200.0, 120.0], [200.0, 240.0], [200.0, 260.0], [210.0, 260.0]])
    with placed(make_layout(config, 1000), places):
        batch.reset(0, 1000, 7)
    policy.reset(batch, 0)
    assert (batch.assignment[0] == 1).all()
    for _ in range(10):
        batch.step(policy.act(batch))
        assert joined_relays(config, batch.position[0, :2]).all()


def test_a_relay_that_cannot_serve_both_serves_the_monitor():
    """With a monitor and a collector 80 m apart and links of 30 m, it flies to the monitor, on either side."""
    world = replace(FARM.world, communication_uavs=1, monitoring_uavs=1, collection_uavs=1, steps=10)
    config = replace(FARM, world=world, relay=replace(FARM.relay, capacity=2, link_range=30.0))
    for x in (160.0, 240.0):
        batch, policy = FarmBatch(config, 1), policy_of("tour+coverage", config)
        with placed(make_layout(config, 1000), np.array([[200.0, 200.0], [x, 200.0], [400.0 - x, 200.0]])):
            batch.reset(0, 1000, 7)
        policy.reset(batch, 0)
        batch.step(policy.act(batch))
        assert (batch.position[0, 0, 0] < 200.0) == (x < 200.0)
