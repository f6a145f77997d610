"""Running scales of observations and returns: their numbers, and what networks keep when they move."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from eia_sec.common.errors import CheckpointError
from eia_sec.common.team import GroupSpec
from eia_sec.learner.on_policy.normalisation import ObservationScale, ReturnScale
from eia_sec.learner.on_policy.trainer import OnPolicyTrainer
from tests.learner.on_policy.small_runs import ENDS, TEAM, chunk, configured, moved
from tests.learner.test_trainer import assert_bit_equal

SCALED = {"normalise_observations": True, "normalise_returns": True, "target_kl": 0.0}
STILL = {**SCALED, "actor_rate": 1e-12, "critic_rate": 1e-12}
"""Networks that move with their scales alone."""


def absorb(trainer, number, factor=1.0, shift=0.0):
    """Let a trainer learn from an iteration whose observations are larger by a factor."""
    behaviour = moved(trainer.actors(), 0.1, np.random.default_rng(number))
    experience = chunk(behaviour, number, ENDS, episodes=1)
    rows = experience.rows
    observation = rows.observation.copy()
    for group, own in zip(TEAM.groups, TEAM.split_observations(observation), strict=True):
        part = own[..., : -group.options] if group.masked else own
        part *= factor
        part += shift
    trainer.absorb(replace(experience, rows=replace(rows, observation=observation)))
    trainer.train(trainer.updates_due())
    return observation


def test_the_scale_is_that_of_all_rows():
    """Mean and deviation of parts that come one after another are those of the whole; masks are left alone."""
    draw = np.random.default_rng(1)
    group = GroupSpec("a", 2, 7, 1, choices=(3,), masked=True)
    scale, parts = ObservationScale(group), [draw.normal(50.0, 20.0, (n, 7)) for n in (5, 300, 40)]
    for part in parts:
        scale.add(torch.from_numpy(part))
    shift, divisor = scale.shift_and_scale()
    whole = np.concatenate(parts)
    np.testing.assert_allclose(shift[:4], whole.mean(axis=0)[:4], rtol=1e-6)
    np.testing.assert_allclose(divisor[:4], whole.std(axis=0)[:4], rtol=1e-6)
    assert shift[4:].tolist() == [0.0] * 3
    assert divisor[4:].tolist() == [1.0] * 3


def test_what_is_rarely_there_is_not_made_large():
    """The farthest number is about ten scales from the mean; a number that never changes becomes 0."""
    rows = torch.zeros(10_000, 2)
    rows[17, 0], rows[:, 1] = 1.0, 3.0
    scale = ObservationScale(GroupSpec("a", 1, 2, 1))
    scale.add(rows)
    shift, divisor = scale.shift_and_scale()
    assert ((rows - shift) / divisor).abs().amax(dim=0).tolist() == pytest.approx([10.0, 0.0], abs=0.01)


def test_the_scale_of_returns_follows_them():
    """It begins as that of the first iteration, and forgets it when returns move."""
    scale = ReturnScale()
    scale.add(torch.tensor([1.0, 3.0]))
    assert scale.shift_and_scale() == (2.0, 1.0)
    for _ in range(60):
        scale.add(torch.tensor([90.0, 110.0]))
    assert scale.shift_and_scale() == pytest.approx((100.0, 10.0), rel=0.03)


@pytest.mark.parametrize("name", ["ippo", "mappo", "eia-ppo"])
def test_networks_keep_their_function_when_scales_move(name):
    """What the published actors and the value functions answer does not change with the scales, only by learning."""
    trainer = OnPolicyTrainer(configured(name, **STILL), TEAM)
    observation = absorb(trainer, 0, 30.0, 5.0)
    updates, actors = trainer._updates, trainer.actors()
    noise, draws = np.zeros((len(observation), TEAM.action_size), np.float32), np.full((1,), 0.5, np.float32)
    before = actors.sample(observation, noise, np.broadcast_to(draws, noise.shape).copy())
    value = _values(updates, observation)
    absorb(trainer, 1, 300.0, -100.0)
    after = trainer.actors().sample(observation, noise, np.broadcast_to(draws, noise.shape).copy())
    for old, new in zip(before, after, strict=True):
        np.testing.assert_allclose(new, old, atol=2e-4)
    np.testing.assert_allclose(_values(updates, observation), value, rtol=1e-3, atol=1e-3)


def _values(updates, observation):
    """Return V of all agents for rows of observations as they are."""
    shift, scale = updates._scales.of_team()
    team = (torch.from_numpy(observation) - shift) / scale
    found = []
    for kind, (value, scale_of) in enumerate(zip(updates.values, updates._scales.returns, strict=True)):
        own = TEAM.split_observations(team.numpy())[kind]
        mean, deviation = scale_of.shift_and_scale()
        found.append(mean + deviation * value.value(team, torch.from_numpy(own.copy())).detach().numpy())
    return np.concatenate(found, axis=1)


def test_actors_from_elsewhere_keep_their_function():
    """A policy that a run begins with acts as it did, also after the first iteration has set the scales."""
    start = moved(OnPolicyTrainer(configured(**STILL), TEAM).actors(), 0.2, np.random.default_rng(3))
    trainer = OnPolicyTrainer(configured(**STILL), TEAM)
    trainer.begin_with(start.flat)
    absorb(trainer, 0, 30.0, 5.0)
    for old, new in zip(start.flat, trainer.actors().flat, strict=True):
        np.testing.assert_allclose(new, old, rtol=1e-4, atol=1e-4)


def test_fresh_networks_begin_on_scaled_observations():
    """Numbers in the thousands do not decide what a fresh policy does after the first iteration."""
    trainer = OnPolicyTrainer(configured(**STILL), TEAM)
    plain = OnPolicyTrainer(configured(**STILL), TEAM)
    observation = absorb(trainer, 0, 1000.0)
    absorb(plain, 0)
    noise = np.zeros((len(observation), TEAM.action_size), np.float32)
    draws = np.full(noise.shape, 0.5, np.float32)
    action, _ = trainer.actors().sample(observation, noise, draws)
    smooth = TEAM.split_actions(action)[1]
    assert np.abs(smooth).max() < 0.1


@pytest.mark.parametrize("cut", [3, 9])
def test_scales_continue_bit_equal(cut):
    """A checkpoint holds the scales, in the middle of an iteration too."""
    config = configured("eia-ppo", **SCALED)
    whole, before, after = (OnPolicyTrainer(config, TEAM) for _ in range(3))
    behaviour = before.actors()
    for trainer in (whole, before):
        trainer.absorb(chunk(behaviour, 1, ENDS))
        trainer.train(cut)
    after.restore(*before.state())
    for trainer in (whole, after):
        trainer.train(trainer.updates_due())
        trainer.absorb(chunk(behaviour, 2, ENDS))
        trainer.train(trainer.updates_due())
    assert_bit_equal(after, whole)


@pytest.mark.parametrize("name", ["observations.a.rows", "observations.b.deviation", "returns.a.weight", "loaded"])
def test_a_forged_scale_is_refused(name):
    """Counts, weights and deviations are not negative."""
    trainer = OnPolicyTrainer(configured(**SCALED), TEAM)
    absorb(trainer, 0)
    tensors, state = trainer.state()
    key = f"networks.scales.{name}"
    with pytest.raises(CheckpointError, match=f"{name} is negative"):
        OnPolicyTrainer(configured(**SCALED), TEAM).restore({**tensors, key: -1.0 - tensors[key]}, state)
