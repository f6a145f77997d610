"""Workers and evaluations with memory: states go on from chunk to chunk, and end with their episodes."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from eia_sec.common.actors import TeamActors
from eia_sec.common.config import IppoConfig, RolloutConfig, RunConfig
from eia_sec.common.farm import farm_team
from eia_sec.common.transitions import TRANSITION
from eia_sec.learner.on_policy.distributions import evaluate as evaluate_actions
from eia_sec.learner.on_policy.trainer import OnPolicyTrainer
from eia_sec.rollout.evaluation import evaluate
from eia_sec.rollout.policies import ActorPolicy
from eia_sec.rollout.worker.collector import Collector, run_noise_free_episodes
from tests.learner.on_policy.small_runs import moved
from tests.rollout.heuristics.small_farm import SMALL

STEPS = 40
FARM = replace(SMALL, world=replace(SMALL.world, steps=15))


def configured(chunk=STEPS):
    """Return a run with memory on a small farm with episodes of 15 steps."""
    algorithm = IppoConfig(hidden=8, memory="gru", sequence_steps=10, precision="float32")
    rollout = RolloutConfig(environments=2, chunk_steps=chunk)
    return RunConfig(farm=FARM, rollout=rollout, algorithm=algorithm)


def collected(config, chunks=1):
    """Return the actors of a run, and the rows that a worker collects with them."""
    collector = Collector(config, "w", 0)
    actors = moved(OnPolicyTrainer(config, collector.team).actors(), 0.5, np.random.default_rng(1))
    return actors, [collector.collect(actors, 0.0, uniform=False).rows for _ in range(chunks)]


def test_chunks_of_any_length_hold_the_same_steps():
    """Four chunks hold what one of four times the length holds, and the states at which they were cut."""
    (actors, (whole,)), (_, quarters) = collected(configured()), collected(configured(STEPS // 4), 4)
    for name in ("observation", "action", "log_probability"):
        of_first = [
            getattr(rows, name)[(rows.flag & TRANSITION) > 0][:length]
            for rows, length in ((whole, STEPS), *((rows, STEPS // 4) for rows in quarters))
        ]
        np.testing.assert_array_equal(np.concatenate(of_first[1:]), of_first[0])
    assert not whole.state.any()
    assert not quarters[0].state.any()
    assert np.abs(quarters[1].state).min(axis=2).max() > 0.0
    # An episode ends with the third chunk, so the fourth begins with one.
    assert [bool(rows.state.any()) for rows in quarters] == [False, True, True, False]
    for rows in quarters:
        rows.check(actors.team, 8)


def test_the_state_of_a_chunk_is_that_of_the_actors_at_its_first_row():
    """Going through the first chunk's steps from a state of 0 leads to the state that the second one states."""
    actors, (first, second) = collected(configured(STEPS // 4), 2)
    state = actors.initial_state(2)
    for step in first.steps_by_environment():
        actors.sample(first.observation[step], *np.zeros((2, 2, actors.team.action_size), np.float32), state)
    np.testing.assert_array_equal(second.state, state)


def test_a_state_ends_with_its_episode():
    """In rows with several episodes, the log-probabilities are those of states that begin each episode with 0."""
    actors, (rows,) = collected(configured())
    actions = actors.team.split_actions(rows.action)
    for steps in rows.steps_by_environment().T:
        state = actors.initial_state(1)
        for step in steps:
            if step and rows.flag[step - 1] == 0:
                state[:] = 0.0
            found = [
                evaluate_actions(group, *(torch.from_numpy(part) for part in (own, outputs, action[step : step + 1])))
                for (group, own, outputs), action in zip(
                    actors.outputs(rows.observation[step : step + 1], state), actions, strict=True
                )
            ]
            wanted = torch.cat([part.log_probability for part in found], dim=1)[0].numpy()
            np.testing.assert_allclose(rows.log_probability[step], wanted, atol=2e-3)


def policy():
    """Return actors with memory that move."""
    actors = TeamActors.initial(farm_team(FARM), 16, 5, per_type=False, memory="gru")
    return replace(actors, flat=tuple(flat * np.float32(4.0) for flat in actors.flat))


def test_results_do_not_depend_on_batch_or_order():
    """Each farm's result is bit-equal whatever is flown beside it, before it or after it."""
    farms, shared = (1003, 1000, 1001), ActorPolicy(policy())
    whole = evaluate(FARM, ActorPolicy(policy()), farms, 2, name="a", batch=32)
    single = evaluate(FARM, shared, farms, 2, name="a", batch=1)
    waves = evaluate(FARM, shared, farms, 2, name="a", batch=4)
    assert whole == single == waves


def test_flights_for_the_elite_remember():
    """Noise-free episodes are those of actors that go through them with a state; without one they are others."""
    config, actors = configured(), policy()
    reward, steps = run_noise_free_episodes(config, actors, (3, 4), (5, 6))
    again, _ = run_noise_free_episodes(config, actors, (3,), (5,))
    assert steps.tolist() == [15, 15]
    np.testing.assert_allclose(again[0], reward[0], rtol=1e-4)

    class Forgetful(TeamActors):
        def environment_actions(self, observations, state=None):
            return super().environment_actions(observations, self.initial_state(len(observations)))

    forgetful = Forgetful(actors.team, actors.hidden, actors.flat, actors.head, actors.memory)
    other, _ = run_noise_free_episodes(config, forgetful, (3, 4), (5, 6))
    assert not np.allclose(other, reward, rtol=1e-3)


@pytest.mark.parametrize("memory", ["none", "gru"])
def test_rows_have_states_only_with_memory(memory):
    """Actors without memory leave rows as they were."""
    algorithm = replace(configured().algorithm, memory=memory)
    _, (rows,) = collected(replace(configured(), algorithm=algorithm))
    assert (rows.state is None) == (memory == "none")
