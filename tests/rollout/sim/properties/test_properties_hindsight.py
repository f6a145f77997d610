"""What visits turn out to be worth: the kernel's corrections against episodes in which the visits are left out."""

from dataclasses import replace

import numpy as np
from hypothesis import example, given
from hypothesis import strategies as st

from eia_sec.common.config import FarmConfig
from eia_sec.rollout.sim.batch import FarmBatch
from tests.constants import with_constants
from tests.rollout.sim.course import STARTING, STEPPING, begin
from tests.rollout.sim.properties.strategies import Flight, dose, farm_configs, flights, worlds
from tests.rollout.sim.properties.test_properties_reference import TOGETHER
from tests.rollout.sim.services import UTILITY, LoggedFarm

SMALL = worlds(st.integers(1, 5), 60)


def countable(config: FarmConfig) -> FarmConfig:
    """Return the farm with weights whose sums are exact in float32."""
    return replace(config, reward=with_constants(config.reward, collection=0.5))


FARMS = farm_configs(SMALL).map(countable)
LONGER = with_constants(replace(TOGETHER.config.world, steps=60), vdf_max=2)
PLAY = replace(TOGETHER, config=countable(replace(TOGETHER.config, world=LONGER)))
"""Many visits of every plot, some of them after the counter has reached its cap."""


def flown(flight: Flight) -> tuple[FarmBatch, LoggedFarm, np.ndarray, np.ndarray]:
    """Fly an episode in the kernel and in the reference.

    Returns:
        the batch, the reference, the assignments [T, n_m + n_d] and the utility parts of the rewards [T, n].
    """
    batch, logged = FarmBatch(flight.config, 1, hindsight=True), LoggedFarm(flight)
    begin(flight, batch)
    assignments, utility = [], []
    for action in flight.actions():
        batch.step(action[None])
        logged.step(action, batch.assignment[0])
        assignments.append(batch.assignment[0].copy())
        utility.append(batch.parts[0, :, UTILITY].copy())
    return batch, logged, np.stack(assignments), np.stack(utility)


@dose(30)
@given(flights(FARMS), st.integers(0, 2**32))
@example(PLAY, 0)
def test_a_visit_is_worth_what_the_team_earns_less_without_it(flight: Flight, seed: int):
    """Simulated again without the visits of one UAV in one step, the team's utility falls by exactly their worth."""
    batch, logged, assignments, utility = flown(flight)
    assert logged.earned == utility.sum()
    worth, paid = utility + batch.hindsight[0], np.random.default_rng(seed).permutation(np.argwhere(utility > 0))
    least = np.argsort(worth[tuple(paid.T)], kind="stable")[:2]
    for step, agent in np.concatenate([paid[least], paid[:3]]):
        without = LoggedFarm(flight, logged.services_of(agent, step + 1))
        for action, assignment in zip(flight.actions(), assignments, strict=True):
            without.step(action, assignment)
        assert logged.earned - without.earned == worth[step, agent]


@dose(30)
@given(flights(FARMS))
@example(PLAY)
def test_corrections_equal_those_of_counters_that_go_on(flight: Flight):
    """All visits of the episode; each counter counts on from one visit to the next as if nobody had come."""
    batch, logged, *_ = flown(flight)
    np.testing.assert_array_equal(batch.hindsight[0], logged.corrections())


@dose(12)
@given(flights(farm_configs(SMALL)))
def test_tracking_changes_nothing_else(flight: Flight):
    """Every public array is bit-equal with and without it after every step, and so is the summary."""
    plain, tracked = begin(flight), begin(flight, FarmBatch(flight.config, 1, hindsight=True))
    for action in flight.actions():
        plain.step(action[None])
        tracked.step(action[None])
        for name in (*STARTING, *STEPPING, "link_quality"):
            np.testing.assert_array_equal(getattr(plain, name), getattr(tracked, name), err_msg=name)
    assert plain.summary(0) == tracked.summary(0)


def test_the_play_has_visits_of_every_sort():
    """Worth all of what they pay, a part of it, nothing, and less than nothing."""
    batch, logged, _, utility = flown(PLAY)
    worth = (utility + batch.hindsight[0])[utility > 0]
    assert (worth < 0).any()
    assert (worth == 0).any()
    assert ((worth > 0) & (worth < utility[utility > 0])).any()
    assert (worth == utility[utility > 0]).any()
    assert any(len(visit) > 1 for item in logged.services for visit in logged.visits(item))
