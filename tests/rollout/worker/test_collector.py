"""What a worker collects for algorithms that learn on policy: log-probabilities, and rewards that end with episodes."""

from dataclasses import replace

import numpy as np
import pytest

from eia_sec.common.actors import TeamActors
from eia_sec.common.config import EnvConfig, IppoConfig, RolloutConfig, RunConfig
from eia_sec.common.protocol.bfloat16 import to_bits
from eia_sec.common.transitions import TRANSITION
from eia_sec.learner.on_policy.trainer import OnPolicyTrainer
from eia_sec.rollout.worker.collector import Collector
from tests.learner.on_policy.small_runs import moved
from tests.rollout.heuristics.small_farm import SMALL

STEPS = 40
"""Steps of a chunk, several episodes long."""
ALGORITHM = IppoConfig(hidden=8, potential_discount=1.0, precision="float32")


def configured(chunk=STEPS, **changes):
    """Return a run on a small farm with episodes of 15 steps."""
    farm = replace(SMALL, world=replace(SMALL.world, steps=15, communication_uavs=2))
    rollout = RolloutConfig(environments=2, chunk_steps=chunk)
    return RunConfig(farm=farm, rollout=rollout, algorithm=replace(ALGORITHM, **changes))


def collected(config, chunks=1):
    """Return the actors of a run, and the chunks that a worker collects with them."""
    collector = Collector(config, "w", 0)
    actors = moved(OnPolicyTrainer(config, collector.team).actors(), 0.3, np.random.default_rng(1))
    return actors, [collector.collect(actors, 0.5, uniform=True) for _ in range(chunks)]


def log_probabilities(actors, rows):
    """Evaluate the actions of rows of continuous actions once more, in double precision."""
    found = []
    for (group, _, outputs), action in zip(
        actors.outputs(rows.observation), actors.team.split_actions(rows.action), strict=True
    ):
        mean, log_std = outputs[..., : group.action_size], outputs[..., group.action_size :].clip(-20.0, 2.0)
        score = (np.arctanh(action.astype(np.float64)) - mean) / np.exp(log_std)
        found.append((-0.5 * score**2 - log_std - 0.5 * np.log(2.0 * np.pi)).sum(axis=-1))
    return np.concatenate(found, axis=1)


def test_rows_carry_the_log_probabilities_of_their_actions():
    """Evaluating the actors at a row's observation gives its log-probability; rows without a step have zeros."""
    actors, (chunk,) = collected(configured())
    rows = chunk.rows
    rows.check(actors.team)
    step = (rows.flag & TRANSITION) > 0
    assert rows.log_probability is not None
    np.testing.assert_allclose(rows.log_probability[step], log_probabilities(actors, rows)[step], atol=1e-3)
    assert (~step).sum() == 2 + 4
    assert not rows.log_probability[~step].any()
    assert len(np.unique(rows.log_probability[step])) > STEPS


def test_steps_are_counted_while_a_chunk_is_collected():
    """After each step the caller sees those simulated so far; the other count rises at the end. Rows stay the same."""
    config = configured()
    actors, (quiet,) = collected(config)
    collector, seen = Collector(config, "w", 0), []

    def watch():
        seen.append((collector.simulated, collector.environment_steps))
        return True

    chunk = collector.collect(actors, 0.5, uniform=True, goes_on=watch)
    assert seen == [(2 * (step + 1), 0) for step in range(STEPS)]
    assert collector.environment_steps == collector.simulated == 2 * STEPS
    np.testing.assert_array_equal(chunk.rows.reward, quiet.rows.reward)


def test_actions_do_not_depend_on_the_schedule_of_noise():
    """Neither the deviation of exploration noise nor a warm-up has a meaning: actions are the actors' samples."""
    config = configured()
    chunks = []
    for noise_std, uniform in ((0.0, False), (0.9, True)):
        collector = Collector(config, "w", 0)
        actors = OnPolicyTrainer(config, collector.team).actors()
        chunks.append(collector.collect(actors, noise_std, uniform).rows)
    assert np.array_equal(chunks[0].action, chunks[1].action)
    assert np.array_equal(chunks[0].log_probability, chunks[1].log_probability)
    assert chunks[0].action.std() > 0.2


def test_chunks_of_any_length_hold_the_same_steps():
    """Two chunks hold the observations, actions and log-probabilities of one of twice the length."""
    (_, (whole,)), (_, halves) = collected(configured()), collected(configured(STEPS // 2), 2)
    for name in ("observation", "action", "reward", "log_probability"):
        of_first = [
            getattr(chunk.rows, name)[(chunk.rows.flag & TRANSITION) > 0][:length]
            for chunk, length in ((whole, STEPS), *((half, STEPS // 2) for half in halves))
        ]
        np.testing.assert_array_equal(np.concatenate(of_first[1:]), of_first[0])


@pytest.mark.parametrize("time_limit", ["terminal", "bootstrap"])
def test_shaped_rewards_of_an_episode_add_up(time_limit):
    """At gamma_s 1 they sum to the episode's reward less Phi at its start, plus Phi at its end if that is not 0."""
    config = configured(15, time_limit=time_limit)
    collector = Collector(config, "w", 0)
    start = collector.environments.potential.copy()
    last = np.zeros_like(start)
    step = collector.environments.step

    def watched(action):
        step(action)
        last[...] = collector.environments.potential

    collector.environments.step = watched
    actors = TeamActors.initial(collector.team, 8, 0, head="gaussian")
    chunk = collector.collect(actors, 0.0, uniform=False)
    assert len(chunk.episodes) == 2
    rewards = chunk.rows.reward[(chunk.rows.flag & TRANSITION) > 0].reshape(2, 15, -1).sum(axis=1)
    end = last if time_limit == "bootstrap" else 0.0
    unshaped = np.array([episode.reward for episode in chunk.episodes])
    np.testing.assert_allclose(rewards, unshaped - start + end, atol=2e-3)
    assert (np.abs(start[:, :2]) > 1.0).all()
    assert not np.allclose(last, 0.0)


def test_an_environment_without_potential_pays_what_it_pays():
    """Rows of a PettingZoo environment hold the very rewards of its episodes."""
    config = replace(configured(5), env=EnvConfig(name="tests.rollout.envs.toy_env:Relay"))
    _, (chunk,) = collected(config)
    sums = chunk.rows.reward[(chunk.rows.flag & TRANSITION) > 0].reshape(2, 5, -1).sum(axis=1)
    np.testing.assert_allclose(sums, [episode.reward for episode in chunk.episodes], atol=1e-5)


def test_rows_may_hold_observations_of_half_the_size():
    """In bfloat16 a worker flies the same, and its rows hold the same observations, rounded."""
    (exact,), (halved,) = (collected(configured(precision=name))[1] for name in ("float32", "bfloat16"))
    assert halved.rows.observation.dtype == np.uint16
    np.testing.assert_array_equal(halved.rows.observation, to_bits(exact.rows.observation))
    for name in ("action", "reward", "flag", "log_probability"):
        np.testing.assert_array_equal(getattr(halved.rows, name), getattr(exact.rows, name))
    assert halved.episodes == exact.episodes
