"""Rewards in a worker's rows, corrected by what visits turned out to be worth."""

from dataclasses import replace

import numpy as np
import pytest

from eia_sec.common.config import FarmConfig, WorldConfig
from eia_sec.common.team import Float32
from eia_sec.rollout.sim.batch import FarmBatch
from eia_sec.rollout.worker.hindsight_credit import corrected, credit_newest
from tests.rollout.heuristics.small_farm import SMALL

STEPS = 60
FARM = replace(SMALL, world=replace(SMALL.world, steps=STEPS, start_levels="random"))


def flown(batch: FarmBatch, steps: int) -> Float32:
    """Fly some steps of all environments at random; return the rewards, [E, steps, n]."""
    random, rewards = np.random.default_rng(int(batch.time[0])), []
    for _ in range(steps):
        batch.step(random.uniform(-1.0, 1.0, (len(batch.time), batch.team.environment_action_size)).astype(np.float32))
        rewards.append(batch.reward.copy())
    return np.stack(rewards, axis=1)


def shares(batch: FarmBatch, share: float) -> Float32:
    """Return the same share for every agent."""
    return np.full(batch.team.agents, share, np.float32)


def begun(config: FarmConfig = FARM, *, hindsight: bool = True) -> FarmBatch:
    """Return two farms at the start of an episode."""
    batch = FarmBatch(config, 2, hindsight=hindsight)
    for index in range(2):
        batch.reset(index, index, 0)
    return batch


def test_some_steps_are_corrected_by_their_share():
    """These steps get s times their corrections, the corrections of others left alone, float32 as before."""
    correction = np.arange(12, dtype=np.float32).reshape(6, 2)
    reward = np.full((3, 2), 100.0, np.float32)
    found = corrected(reward, correction, 2, np.array([0.5, 0.5], np.float32))
    assert found.dtype == np.float32
    assert found.tolist() == [[102.0, 102.5], [103.0, 103.5], [104.0, 104.5]]
    assert (reward == 100.0).all()


@pytest.mark.parametrize("share", [0.25, 1.0])
def test_whole_episodes_are_corrected_in_full(share):
    """Each of the newest steps gets the share of its own environment's correction."""
    batch = begun()
    reward = flown(batch, STEPS)
    assert batch.hindsight is not None
    for index in range(2):
        found = credit_newest(batch, index, reward[index], shares(batch, share))
        np.testing.assert_allclose(found - reward[index], share * batch.hindsight[index], atol=1e-5)
    assert (batch.hindsight < 0.0).any()


def test_a_chunk_keeps_what_is_known_at_its_end():
    """Steps of a part are those up to now; corrections by later visits come too late for their rows."""
    batch = begun()
    flown(batch, 10)
    reward = flown(batch, 35)
    assert batch.hindsight is not None
    known = batch.hindsight.copy()
    found = credit_newest(batch, 1, reward[1], shares(batch, 1.0))
    np.testing.assert_allclose(found - reward[1], known[1, 10:45], atol=1e-5)
    assert not known[:, 45:].any()
    flown(batch, STEPS - 45)
    assert not np.array_equal(batch.hindsight[:, :45], known[:, :45])


def test_nothing_is_added_without_hindsight_or_share():
    """The very rewards come back: without tracking, without a share, and of no steps."""
    plain, tracked = begun(hindsight=False), begun()
    rewards = flown(plain, 20), flown(tracked, 20)
    assert credit_newest(plain, 0, rewards[0][0], shares(plain, 1.0)).tobytes() == rewards[0][0].tobytes()
    assert credit_newest(tracked, 0, rewards[1][0], shares(tracked, 0.0)).tobytes() == rewards[0][0].tobytes()
    assert credit_newest(tracked, 0, rewards[1][0, :0], shares(tracked, 1.0)).shape == (0, tracked.team.agents)


def test_hindsight_never_adds_to_what_is_paid():
    """No visit is worth more than it paid; relays serve nothing, so theirs stays as it is."""
    batch = begun(FarmConfig(world=WorldConfig(steps=200)))
    reward = flown(batch, 200)
    credited = np.stack([credit_newest(batch, index, reward[index], shares(batch, 1.0)) for index in range(2)])
    relays = batch.config.world.communication_uavs
    assert (credited <= reward).all()
    assert (credited < reward).any()
    assert np.array_equal(credited[..., :relays], reward[..., :relays])
