"""What a relay's links bring, on any farm: the same step again without them, and what hindsight counts."""

import copy
from dataclasses import replace

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from eia_sec.common.config import FailureConfig, FarmConfig
from eia_sec.rollout.sim.batch import REWARD_PARTS, FarmBatch
from eia_sec.rollout.sim.conditions.links import joined_relays
from eia_sec.rollout.sim.reference.farm import ReferenceFarm
from eia_sec.rollout.sim.stations import MIDDLES
from tests.rollout.sim.course import begin
from tests.rollout.sim.properties.strategies import Flight, dose, farm_configs, flights, worlds
from tests.rollout.sim.properties.test_properties_added import with_plans_that_fit, with_seen
from tests.rollout.sim.properties.test_properties_reference import flown_beside, reference_of

UTILITY, IDLE, RELAYED = (REWARD_PARTS.index(name) for name in ("utility", "idle", "relayed"))
SMALL = worlds(st.integers(1, 5), 90)
REACHES = st.floats(0.1, 1.0)
"""Link ranges over the field's width."""
BASES = st.sampled_from(["", *MIDDLES])


class CutFarm(ReferenceFarm):
    """A farm in which one relay's links and hops are down wherever it is. The assignment is the same.

    Attributes:
        cut: the relay; -1 for none.
    """

    cut = -1

    def _assign(self, chosen: np.ndarray | None = None) -> None:
        super()._assign(chosen)
        if self.cut >= 0:
            self.linked &= self.assignment != self.cut
            self.linked &= self.joined_without(self.cut)[self.assignment]

    def joined_without(self, relay: int) -> np.ndarray:
        """Return which relays [n_c] are joined if one has failed."""
        gone = np.array([relay == other or self.gone[other] for other in range(self.config.world.communication_uavs)])
        return joined_relays(self.config, self.position[: len(gone)], gone)

    def task_reward(self) -> float:
        """Return the team's utility and idle parts of the last step."""
        return float(self.parts[:, [UTILITY, IDLE]].sum())


def linked(config: FarmConfig, reach: float, weight: float, base: str = "") -> FarmConfig:
    """Return a farm on which links over a share of its width count and relays are paid for them; hops reach as far."""
    length = reach * config.world.field_x
    height = config.world.height_communication if base else 0.0
    relay = replace(config.relay, require_link=True, link_range=length, base=base, hop_range=height + length)
    return replace(config, relay=relay, reward=replace(config.reward, relayed=weight))


def failing(config: FarmConfig) -> FarmConfig:
    """Let the first relay and the first monitor fail during the episode, and let UAVs see links and chains."""
    at = "communication 0 at 3, monitoring 0 at 4" if config.world.steps >= 4 else ""
    return replace(config, failures=FailureConfig(at=at), observation=replace(config.observation, link=True))


@dose(10)
@given(flights(farm_configs(SMALL)), REACHES, st.sampled_from([-1.0, 0.5, 2.0]), BASES)
def test_a_relay_is_paid_the_difference_that_its_links_make(flight: Flight, reach: float, weight: float, base: str):
    """Its part is the team's task reward less that of the same step, simulated again, in which its links are down."""
    flight = replace(flight, config=linked(flight.config, reach, weight, base))
    batch, relays = begin(flight), flight.config.world.communication_uavs
    farm = reference_of(flight, batch, kind=CutFarm)
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


@dose(10)
@given(flights(farm_configs(SMALL)), REACHES)
def test_hindsight_counts_only_what_was_delivered(flight: Flight, reach: float):
    """In a step without utility, as while its link is down, a UAV makes no visit, and nothing corrects that step."""
    config = linked(flight.config, reach, 1.0)
    batch = FarmBatch(config, 1, hindsight=True)
    begin(replace(flight, config=config), batch)
    idle = []
    for action in flight.actions():
        batch.step(action[None])
        idle.append(batch.utility[0] == 0.0)
    assert batch.hindsight is not None
    assert not batch.hindsight[0, : len(idle)][np.array(idle)].any()


@dose(15)
@given(flights(farm_configs(SMALL)), REACHES, st.sampled_from(sorted(MIDDLES)))
def test_any_flight_with_a_base_station_equals_the_reference(flight: Flight, reach: float, base: str):
    """Every quantity after every step, plans too, with a relay that fails, within the bounds of the observation."""
    config = failing(linked(flight.config, reach, 0.5, base))
    flight = replace(flight, config=with_plans_that_fit(with_seen(config, {"plan": 2})))
    batch, relays = begin(flight), flight.config.world.communication_uavs
    farm = reference_of(flight, batch)
    for _ in flown_beside(flight, batch, farm, 12):
        joined = joined_relays(flight.config, batch.position[0, :relays], batch.gone[0, :relays])
        np.testing.assert_array_equal(joined, farm.joined)
