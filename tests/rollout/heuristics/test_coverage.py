"""Relays that keep links up."""

from dataclasses import replace

import numpy as np
import pytest

from common.config.presets import preset
from rollout.evaluation import evaluate
from rollout.heuristics.registry import default_relays
from rollout.policies import policy_of
from rollout.sim.batch import FarmBatch

FARM = preset("connected").farm
NEAR = replace(FARM, relay=replace(FARM.relay, link_range=70.0), world=replace(FARM.world, steps=150))


def linked_share(config, relays):
    """Return the share of links that are up, over an episode of the tour."""
    batch, policy = FarmBatch(config, 2), policy_of(f"tour+{relays}", config)
    for index in range(2):
        batch.reset(index, 1000 + index, 7)
        policy.reset(batch, index)
    up = []
    while not batch.ended.all():
        batch.step(policy.act(batch))
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


@pytest.mark.parametrize(("config", "name"), [(FARM, "coverage"), (preset("default").farm, "search")])
def test_a_task_heuristic_brings_the_relays_that_the_farm_needs(config, name):
    """`tour` alone is `tour+coverage` where links count, and `tour+search` elsewhere."""
    assert default_relays(config) == name
    short = replace(config, world=replace(config.world, steps=30))
    flown = [evaluate(short, policy_of(policy, short), [1000], 1, name="").total for policy in ("tour", f"tour+{name}")]
    assert flown[0] == flown[1]
