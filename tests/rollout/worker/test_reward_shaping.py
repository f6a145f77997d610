"""Rewards in a worker's rows, shaped by a potential."""

from dataclasses import replace

import numpy as np
import pytest

from eia_sec.common.actors import TeamActors
from eia_sec.common.config import EiaSecConfig, EnvConfig, RewardConfig, RolloutConfig, RunConfig
from eia_sec.common.errors import ConfigError
from eia_sec.common.farm import farm_team
from eia_sec.common.transitions import TRANSITION
from eia_sec.rollout.sim.batch import REWARD_PARTS
from eia_sec.rollout.worker.collector import Collector, run_noise_free_episodes
from tests.constants import with_constants
from tests.rollout.heuristics.small_farm import SMALL

STEPS = 40
"""Steps of a chunk, several episodes long."""
POSITIONING = REWARD_PARTS.index("positioning")


class Witness:
    """Notes what the first environment's farm is like after every reset and step."""

    index = 0

    def __init__(self, farms):
        self.farms = farms
        self.seen = []

    def record(self):
        """Look."""
        farms = self.farms
        self.seen.append((int(farms.time[0]), farms.service[0].copy(), farms.parts[0].copy()))


def configured(discount, seconds=1.0, relays=2, chunk=STEPS, threads=1, **reward):
    """Return a run on a small farm with episodes of 15 steps."""
    world = replace(SMALL.world, steps=15, step_seconds=seconds, communication_uavs=relays)
    farm = replace(SMALL, world=world, reward=with_constants(RewardConfig(), **reward))
    rollout = RolloutConfig(environments=2, chunk_steps=chunk, threads=threads)
    return RunConfig(farm=farm, rollout=rollout, algorithm=EiaSecConfig(hidden=4, potential_discount=discount))


def flown(config):
    """Return one chunk, flown by actors that nothing has trained, and what was seen of its first farm."""
    collector = Collector(config, "w", 0)
    witness = Witness(collector.environments)
    witness.record()
    collector.probe = witness
    actors = TeamActors.initial(collector.team, config.algorithm.hidden, 0)
    return collector.collect(actors, 0.5, uniform=False), witness.seen


def paid(chunk):
    """Return the rewards in the first environment's rows, [STEPS, n]."""
    rows = chunk.rows
    return rows.reward[(rows.flag & TRANSITION) > 0][:STEPS]


@pytest.mark.parametrize(
    ("discount", "seconds", "weights"),
    [
        (0.995, 1.0, {}),
        (0.9, 0.5, {"positioning": 3.0}),
        (1.0, 1.0, {}),
        (0.97, 2.0, {"positioning": 0.5}),
    ],
)
def test_relays_are_paid_for_where_they_stand(discount, seconds, weights):
    """A row holds (1 - gamma_s) of D_c itself instead of its change, also where an episode begins."""
    config = configured(discount, seconds, **weights)
    chunk, seen = flown(config)
    steps = [(service, parts) for time, service, parts in seen if time > 0]
    wanted = np.array([parts.sum(axis=1) for _, parts in steps])
    for row, (service, parts) in zip(wanted, steps, strict=True):
        level = -config.farm.reward.positioning * service * seconds
        row[:2] += (1.0 - discount) * level - parts[:2, POSITIONING]
    assert len(steps) == STEPS
    assert sum(time == 0 for time, *_ in seen) > 2
    np.testing.assert_allclose(paid(chunk), wanted, atol=2e-4)
    changes = np.array([parts[:2, POSITIONING] for _, parts in steps])
    assert np.abs(changes).max() > 1.0


def test_nothing_is_shaped_without_a_discount():
    """At 0 rows hold the farm's own rewards, bit for bit."""
    chunk, seen = flown(configured(0.0))
    wanted = np.array([parts.sum(axis=1) for time, _, parts in seen if time > 0])
    assert np.array_equal(paid(chunk), wanted.astype(np.float32))


def test_episodes_are_summed_up_as_they_were_flown():
    """Neither the summary of an episode nor its course depends on shaping."""
    plain, _ = flown(configured(0.0))
    shaped, _ = flown(configured(0.995))
    assert shaped.episodes == plain.episodes
    assert len(plain.episodes) == 4
    assert np.array_equal(shaped.rows.observation, plain.rows.observation)
    assert not np.array_equal(shaped.rows.reward, plain.rows.reward)


def test_chunks_and_threads_change_nothing():
    """Two chunks hold the rewards of one of twice the length, and two threads those of one."""
    whole, _ = flown(configured(0.995))
    threaded, _ = flown(configured(0.995, threads=2))
    assert np.array_equal(threaded.rows.reward, whole.rows.reward)
    collector = Collector(configured(0.995, chunk=STEPS // 2), "w", 0)
    actors = TeamActors.initial(collector.team, 4, 0)
    halves = [collector.collect(actors, 0.5, uniform=False).rows for _ in range(2)]
    steps = [rows.reward[(rows.flag & TRANSITION) > 0][: STEPS // 2] for rows in halves]
    assert np.array_equal(np.concatenate(steps), paid(whole))


def test_elites_are_chosen_by_what_farms_pay():
    """Noise-free episodes, which score the agents, are not shaped."""
    plain, shaped = configured(0.0), configured(0.995)
    actors = TeamActors.initial(farm_team(plain.farm), 4, 0)
    found = [run_noise_free_episodes(config, actors, [3, 4], [5, 6])[0] for config in (plain, shaped)]
    assert np.array_equal(*found)
    assert np.abs(found[0][..., :2]).max() > 1.0


def test_other_environments_pay_what_they_pay():
    """The rewards of a PettingZoo environment have no known potential, so they are not shaped."""
    chunks = []
    for discount in (0.0, 0.9):
        config = replace(configured(discount), env=EnvConfig(name="tests.rollout.envs.toy_env:Relay"))
        collector = Collector(config, "w", 0)
        actors = TeamActors.initial(collector.team, config.algorithm.hidden, 0)
        chunks.append(collector.collect(actors, 0.5, uniform=False))
    assert np.array_equal(chunks[0].rows.reward, chunks[1].rows.reward)
    assert np.abs(chunks[0].rows.reward).max() > 0.0


@pytest.mark.parametrize("discount", [-0.1, 1.1, float("nan")])
def test_discounts_outside_0_to_1_are_refused(discount):
    """An impossible discount is refused by name."""
    with pytest.raises(ConfigError, match="potential_discount"):
        EiaSecConfig(potential_discount=discount)
