"""What a relay's links bring, on any farm: the same step again without them, and what hindsight counts."""

import copy
from dataclasses import replace

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from common.config import FarmConfig
from rollout.sim.batch import REWARD_PARTS, FarmBatch
from rollout.sim.reference.farm import ReferenceFarm
from tests.rollout.sim.course import begin
from tests.rollout.sim.properties.strategies import Flight, dose, farm_configs, flights, placed, worlds

UTILITY, IDLE, RELAYED = (REWARD_PARTS.index(name) for name in ("utility", "idle", "relayed"))
SMALL = worlds(st.integers(1, 5), 90)
REACHES = st.floats(0.1, 1.0)
"""Link ranges over the field's width."""


class CutFarm(ReferenceFarm):
    """A farm in which one relay's links are down wherever it is. The assignment is the same.

    Attributes:
        cut: the relay; -1 for none.
    """

    cut = -1

    def _assign(self, chosen: np.ndarray | None = None) -> None:
        super()._assign(chosen)
        if self.cut >= 0:
            self.linked &= self.assignment != self.cut

    def task_reward(self) -> float:
        """Return the team's utility and idle parts of the last step."""
        return float(self.parts[:, [UTILITY, IDLE]].sum())


def linked(config: FarmConfig, reach: float, weight: float) -> FarmConfig:
    """Return a farm on which links over a share of its width count and relays are paid for them."""
    relay = replace(config.relay, require_link=True, link_range=reach * config.world.field_x)
    return replace(config, relay=relay, reward=replace(config.reward, relayed=weight))


@dose(20)
@given(flights(farm_configs(SMALL)), REACHES, st.sampled_from([-1.0, 0.5, 2.0]))
def test_a_relay_is_paid_the_difference_that_its_links_make(flight: Flight, reach: float, weight: float):
    """Its part is the team's task reward less that of the same step, simulated again, in which its links are down."""
    flight = replace(flight, config=linked(flight.config, reach, weight))
    batch, layout, relays = begin(flight), flight.layout(), flight.config.world.communication_uavs
    with placed(layout, flight.positions()):
        farm = CutFarm(flight.config, layout, flight.episode)
    farm._assign(batch.assignment[0])
    farm._look()
    for action in flight.actions()[:8]:
        before = copy.deepcopy(farm)
        batch.step(action[None])
        farm.step(action, batch.assignment[0])
        for relay in range(relays):
            again = copy.deepcopy(before)
            again.cut = relay
            again.step(action, batch.assignment[0])
            lost = 0.0 if farm.gone[relay] else farm.task_reward() - again.task_reward()
            np.testing.assert_allclose(batch.parts[0, relay, RELAYED], weight * lost, rtol=1e-9, atol=1e-9)
        assert not batch.parts[0, relays:, RELAYED].any()


@dose(20)
@given(flights(farm_configs(SMALL)), REACHES)
def test_hindsight_counts_only_what_was_delivered(flight: Flight, reach: float):
    """In a step without utility, as while its link is down, a UAV makes no visit, and nothing corrects that step."""
    config = linked(flight.config, reach, 1.0)
    config = replace(config, radio=replace(config.radio, delivery="bernoulli"))
    batch = FarmBatch(config, 1, hindsight=True)
    begin(replace(flight, config=config), batch)
    idle = []
    for action in flight.actions():
        batch.step(action[None])
        idle.append(batch.utility[0] == 0.0)
    assert batch.hindsight is not None
    assert not batch.hindsight[0, : len(idle)][np.array(idle)].any()
