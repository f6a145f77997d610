"""Learners with a part of the rows each do what one learner does with all of them."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from eia_sec.common.protocol.bfloat16 import to_bits
from eia_sec.learner.group.following import introduce
from eia_sec.learner.group.shares import Shares
from eia_sec.learner.on_policy.trainer import OnPolicyTrainer
from eia_sec.learner.on_policy.updates import Updates
from tests.learner.group.members import DoubledLeader, doubled, end, group_of
from tests.learner.on_policy.small_runs import ENDS, TEAM, chunk, configured, moved

CASES = {
    "ippo": ("ippo", {}),
    "ippo without clips": ("ippo", {"gradient_clip": 0.0, "target_kl": 0.0}),
    "ippo tight clips": ("ippo", {"gradient_clip": 0.01, "clip": 0.02, "target_kl": 0.0}),
    "ippo stops": ("ippo", {"actor_rate": 0.02, "target_kl": 0.02, "epochs": 4}),
    "mappo scales": ("mappo", {"normalise_observations": True, "normalise_returns": True, "objective": "decoupled"}),
    "eia-ppo": ("eia-ppo", {"target_kl": 0.0}),
    "eia-ppo parts": ("eia-ppo", {"shared_until": 0.2, "objective": "decoupled", "target_kl": 0.0}),
    "eia-ppo scales": ("eia-ppo", {"normalise_observations": True, "normalise_returns": True, "ensemble_members": 3}),
    "eia-ppo in bfloat16": ("eia-ppo", {"precision": "bfloat16", "target_kl": 0.0}),
}
UPDATES = 50


class OneLearner(Updates):
    """One learner, whose minibatches have the samples of those of `size` learners."""

    size = 2

    def _with(self, config):
        found = doubled(OneLearner(config, self._team, self._seed, self._learner))
        found.size = self.size
        return found

    def minibatches(self, rows, random):
        """See `Updates`."""
        samples, count = self.samples(rows), self._count(rows)
        shares = Shares.of(samples, len(rows.flag), count, self.size, max(1, self._config.ensemble_size))
        return shares.minibatches(random.permutation(samples), count)


@pytest.fixture(scope="module", params=[2, pytest.param(3, marks=pytest.mark.slow)])
def group(request, tmp_path_factory):
    """A group of two or three learners with float64 numbers."""
    with group_of(request.param, tmp_path_factory.mktemp("group"), "double") as (found, _):
        yield found


@pytest.mark.parametrize("case", CASES)
def test_a_group_does_what_one_learner_does(group, case):
    """Parameters, moments and measurements of 50 updates agree to 1e-10, clips, stops and the parting included."""
    assert agree(group, *CASES[case]) >= UPDATES


@pytest.mark.parametrize("name", ["ippo", "eia-ppo"])
def test_a_learner_without_samples_changes_nothing(group, name, monkeypatch):
    """A minibatch of one learner's samples alone moves the networks as that learner would alone."""
    minibatches = Shares.minibatches

    def lopsided(shares, shuffled, count):
        return [part[part >= shares.starts[-2]] for part in minibatches(shares, shuffled, count)]

    monkeypatch.setattr(Shares, "minibatches", lopsided)
    assert agree(group, name, {"target_kl": 0.0}) >= UPDATES


def agree(group, name, options):
    """Let one learner and a group learn the same, compare them, and return how many updates they made."""
    config = configured(name, **options)
    one, led = OnPolicyTrainer(config, TEAM), OnPolicyTrainer(config, TEAM, group)
    arguments = config.on_policy, TEAM, config.seed, config.learner
    one._updates, led._updates = doubled(OneLearner(*arguments)), DoubledLeader(*arguments, group)
    one._updates.size = group.size
    introduce(group, config, TEAM)
    number, fresh = 0, OnPolicyTrainer(config, TEAM).actors()
    while led.updates < UPDATES:
        behaviour = moved(fresh, 0.1, np.random.default_rng(number))
        experience = chunk(behaviour, number, ENDS, episodes=2)
        if config.bfloat16_observations:
            bits = to_bits(experience.rows.observation)
            experience = replace(experience, rows=replace(experience.rows, observation=bits))
        for trainer in (one, led):
            trainer.absorb(experience)
            trainer.train(trainer.updates_due())
        number += 1
    end(group)
    assert one.updates == led.updates
    assert one.separate_since == led.separate_since
    wanted, found = dict(one._updates.network_tensors()), dict(led._updates.network_tensors())
    assert any(tensor.dtype == torch.float64 for tensor in found.values())
    for tensor_name, tensor in wanted.items():
        torch.testing.assert_close(found[tensor_name], tensor, atol=1e-10, rtol=0.0)
    for statistic, value in one.statistics().items():
        # Each learner reports the mean loss of an ensemble, whose members may differ by one row.
        most = 0.1 * value if name == "eia-ppo" and statistic.startswith("value_loss") else 1e-6
        assert led.statistics()[statistic] == pytest.approx(value, abs=most), statistic
    return led.updates
