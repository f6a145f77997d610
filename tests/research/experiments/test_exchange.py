"""Searches in the place of learned UAVs."""

from dataclasses import replace

import numpy as np
import pytest

from eia_sec.common.config.presets import PRESETS
from eia_sec.common.farm import COLLECTION, MONITORING
from eia_sec.rollout.evaluation import evaluate
from eia_sec.rollout.policies import policy_of
from eia_sec.rollout.sim.batch import FarmBatch
from research.experiments.exchange import LEARNED, fly, page, searching_team

FARM = replace(PRESETS["eia-sec"].farm, world=replace(PRESETS["eia-sec"].farm.world, steps=40))
FIRST = {MONITORING: 4, COLLECTION: 8}


@pytest.mark.parametrize("kind", FIRST)
def test_only_those_that_are_named_search(kind):
    """All other agents do what the policy that ships does in the same place; the two that search do not."""
    batch, own, learned = FarmBatch(FARM, 1), searching_team(FARM, kind, 2), policy_of(LEARNED, FARM)
    batch.reset(0, 3, 0)
    own.reset(batch, 0)
    learned.reset(batch, 0)
    same = np.ones(12, bool)
    for _ in range(FARM.world.steps):
        action = own.act(batch)
        same &= (action == learned.act(batch)).reshape(12, 2).all(axis=1)
        batch.step(action)
    assert np.flatnonzero(~same).tolist() == [FIRST[kind], FIRST[kind] + 1]


def test_nobody_exchanged_is_the_policy_that_ships():
    """Without a search the type earns what it earns in an evaluation; with all searching nobody is left."""
    none, whole = (fly(FARM, MONITORING, searching, range(2)) for searching in (0, 4))
    flown = evaluate(FARM, policy_of(LEARNED, FARM), range(2), 1, name="").total
    assert (none["search"], none["learned"]) == (None, pytest.approx(flown.types[MONITORING], abs=0.06))
    assert (whole["search"], whole["learned"]) == (whole["all"], None)
    assert whole["all"] != none["all"]
    text = page({"command": "x", "commit": "abc", "farms": [0, 1], "results": [none, whole]})
    assert f"| {MONITORING} | 0 |  | {none['all']:.0f} | {none['all']:.0f} |" in text
