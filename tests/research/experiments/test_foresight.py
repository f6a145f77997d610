"""A search on copies of the farm."""

import numpy as np

from eia_sec.common.config.files import with_values
from eia_sec.common.config.presets import preset
from eia_sec.common.farm import farm_team
from eia_sec.rollout.policies import ActorPolicy
from eia_sec.rollout.sim.batch import FarmBatch
from research.experiments.foresight import ForesightPolicy
from research.experiments.inertia import untrained

CONFIG = with_values(preset("inertial"), {"farm.world.steps": 30, "farm.world.vdf_cycle": 10, "algorithm.hidden": 16})


def earned(policy, farms):
    """Return what the team earns on each farm."""
    batch = FarmBatch(CONFIG.farm, len(farms))
    for index, farm in enumerate(farms):
        batch.reset(index, farm, 7)
        policy.reset(batch, index)
    total = np.zeros(len(farms))
    while not batch.ended.any():
        batch.step(policy.act(batch))
        total += batch.reward.sum(axis=1)
    return total


def test_foresight_to_the_end_never_earns_less_than_what_it_begins_with():
    """Copies go on as the farm itself does, so a better command makes the episode better."""
    actors = untrained(CONFIG)
    assert actors.team == farm_team(CONFIG.farm)
    begun = earned(ActorPolicy(actors), (3,))
    found = earned(ForesightPolicy(CONFIG.farm, actors, CONFIG.farm.world.steps), (3,))
    assert (found > begun + 10.0).all()


def test_without_foresight_nothing_changes():
    """Copies that fly no step earn nothing, so the policy's own commands stay."""
    actors = untrained(CONFIG)
    assert (earned(ForesightPolicy(CONFIG.farm, actors, 0), (3,)) == earned(ActorPolicy(actors), (3,))).all()
