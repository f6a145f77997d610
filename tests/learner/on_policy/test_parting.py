"""Agents of a type that share their networks at first, and have their own from a share of the run on."""

from dataclasses import replace

import numpy as np
import pytest

from eia_sec.common.config import EliteConfig
from eia_sec.common.imitation import ImitationEvent
from eia_sec.common.transitions import TRUNCATED, Chunk
from eia_sec.learner.on_policy.trainer import OnPolicyTrainer
from tests.learner.on_policy.small_runs import TEAM, chunk, configured
from tests.learner.test_trainer import assert_bit_equal

SEGMENTS = ((20, TRUNCATED), (20, 0))
"""An iteration's steps in one chunk, in which an episode ends."""


def iterations(trainer: OnPolicyTrainer, count: int) -> None:
    """Take in and learn from so many iterations, each of which ends an episode."""
    for _ in range(count):
        trainer.absorb(chunk(trainer.actors(), 100 + trainer.iterations, SEGMENTS, episodes=1))
        trainer.train(trainer.updates_due())


def networks(trainer: OnPolicyTrainer) -> list[int]:
    return [len(flat) for flat in trainer.actors().flat]


@pytest.mark.parametrize("name", ["ippo", "mappo", "eia-ppo"])
def test_agents_part_at_the_configured_share(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Until then a type has one actor; from then on as many as agents, and trainer and log say since when."""
    trainer = OnPolicyTrainer(configured(name, shared_until=0.5), TEAM)
    iterations(trainer, 4)
    assert (networks(trainer), trainer.separate_since) == ([1, 1], None)
    iterations(trainer, 1)
    assert (networks(trainer), trainer.separate_since) == ([2, 3], 5)
    iterations(trainer, 1)
    assert capsys.readouterr().err.count("agents have actors of their own from episode 5 on.") == 1


@pytest.mark.parametrize(("share", "since", "count"), [(1.0, None, [1, 1]), (0.0, 0, [2, 3])])
def test_agents_may_share_for_ever_or_never(share: float, since: int | None, count: list[int]) -> None:
    """With 1 the end of a run does not part them; with 0 they have networks of their own from the beginning."""
    trainer = OnPolicyTrainer(configured("eia-ppo", shared_until=share), TEAM)
    iterations(trainer, 10)
    assert (networks(trainer), trainer.separate_since, trainer.progress) == (count, since, 1.0)


def test_until_then_it_is_the_run_that_shares() -> None:
    """Weights and moments are those of a run that never parts."""
    parting, sharing = (OnPolicyTrainer(configured("eia-ppo", shared_until=share), TEAM) for share in (0.5, 1.0))
    for trainer in (parting, sharing):
        iterations(trainer, 4)
    assert_bit_equal(parting, sharing)


def test_they_act_alike_at_first() -> None:
    """At the parting every agent's actor is its type's; then they learn apart."""
    trainer = OnPolicyTrainer(configured("eia-ppo", shared_until=0.3), TEAM)
    iterations(trainer, 3)
    for flat in trainer.actors().flat:
        np.testing.assert_array_equal(flat, np.broadcast_to(flat[:1], flat.shape))
    iterations(trainer, 1)
    for flat in trainer.actors().flat:
        assert (flat != flat[:1]).any(axis=1)[1:].all()


def alike(whole: Chunk) -> Chunk:
    """Return a chunk in which all agents of a type saw, did and earned what the first of them did."""
    observation, action, reward = whole.rows.observation.copy(), whole.rows.action.copy(), whole.rows.reward.copy()
    assert whole.rows.log_probability is not None
    log_probability = whole.rows.log_probability.copy()
    for agents in TEAM.agent_slices():
        for numbers in (reward[:, agents], log_probability[:, agents]):
            numbers[:] = numbers[:, :1]
    for numbers in (*TEAM.split_observations(observation), *TEAM.split_actions(action)):
        numbers[:] = numbers[:, :1]
    rows = replace(whole.rows, observation=observation, action=action, reward=reward, log_probability=log_probability)
    return replace(whole, rows=rows)


def test_steps_stay_as_long() -> None:
    """Agents with the same experience step after the parting as the network that they would share otherwise.

    Each gets an n-th of its gradient, which Adam divides by moments that came from the whole one.
    """
    unlimited = {"gradient_clip": 0.0, "target_kl": 0.0}
    parting, sharing = (OnPolicyTrainer(configured(shared_until=share, **unlimited), TEAM) for share in (0.3, 1.0))
    for trainer in (parting, sharing):
        iterations(trainer, 3)
    before = {name: tensor.clone() for name, tensor in sharing._updates.network_tensors()}
    same = alike(chunk(sharing.actors(), 7, SEGMENTS, episodes=1))
    for trainer in (parting, sharing):
        trainer.absorb(same)
        trainer.train(trainer.updates_due())
    shared, parted = (dict(trainer._updates.network_tensors()) for trainer in (sharing, parting))
    for name, own in parted.items():
        if own.ndim and ".exp_avg" not in name:
            step = shared[name] - before[name]
            for agent in own:
                assert float((agent - before[name][0] - step[0]).norm()) < 0.1 * float(step.norm()), name
    assert {len(own) for own in parted.values() if own.ndim} == {2, 3}


def test_local_value_functions_begin_as_a_member_of_the_ensemble() -> None:
    """At the parting each agent's is its type's first member."""
    trainer = OnPolicyTrainer(configured("eia-ppo", shared_until=1.0), TEAM)
    iterations(trainer, 2)
    shared = dict(trainer._updates.network_tensors())
    parted = dict(trainer._updates.separated().network_tensors())
    local = [name for name in parted if ".local.network." in name and not name.rpartition(".")[2].startswith("exp")]
    assert local
    for name in local:
        own = shared[name.replace(".local.network.", ".members.0.")]
        np.testing.assert_array_equal(parted[name], own.expand_as(parted[name]))


def test_scores_count_from_the_parting() -> None:
    """Rewards of the time in which agents shared their actors say nothing about the actors that they have now."""
    trainer = OnPolicyTrainer(configured("eia-ppo", shared_until=0.3), TEAM)
    iterations(trainer, 2)
    assert trainer.rewards.steps == 80
    iterations(trainer, 1)
    assert trainer.rewards.steps == 0
    iterations(trainer, 1)
    assert trainer.rewards.steps == 40


def test_imitation_moves_agents_that_have_parted() -> None:
    """An event before the parting changes no shared actor, and one behind it moves all but the elite."""
    config = replace(configured("eia-ppo", shared_until=0.3), elite=EliteConfig())
    trainer = OnPolicyTrainer(config, TEAM)
    iterations(trainer, 4)
    before = trainer.actors().flat
    trainer.imitate(ImitationEvent(1, 1, 10, 0.5, (1, 2), ((0.0,) * 2, (0.0,) * 3)))
    for old, new, elite in zip(before, trainer.actors().flat, (1, 2), strict=True):
        np.testing.assert_allclose(new, 0.5 * old + 0.5 * old[elite], rtol=1e-5, atol=1e-7)
