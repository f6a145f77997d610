"""What fresh policies do before they have learned anything."""

import numpy as np
import pytest
import torch

from common.actions.adapters import NineMoves
from common.config import IppoConfig
from common.errors import ConfigError
from common.team import GroupSpec, TeamSpec
from learner.on_policy.policies import Policies

FIRST = 5
TEAM = TeamSpec((GroupSpec("a", 3, 16, 1, (NineMoves(FIRST),), (9,)),))


@pytest.mark.parametrize("parameters", ["shared", "separate"])
def test_a_fresh_policy_follows_the_suggested_move(parameters):
    """Whatever else it sees, it takes that move seven times in eight."""
    policies = Policies(IppoConfig(hidden=32, parameters=parameters), TEAM, 0)
    observation = np.random.default_rng(0).uniform(-1.0, 1.0, (40, 3, 16)).astype(np.float32)
    marked = np.random.default_rng(1).integers(0, 9, (40, 3))
    observation[..., FIRST : FIRST + 9] = np.arange(9) == marked[..., None]
    with torch.no_grad():
        chance = policies.stacks[0](torch.from_numpy(observation)).softmax(dim=-1)
    followed = np.take_along_axis(chance.numpy(), marked[..., None], axis=-1)
    assert 0.8 < followed.min() <= followed.max() < 0.95


def test_a_type_follows_as_closely_as_it_should():
    """Of two moves that are marked with 1 and with 3/4, the logits differ by a quarter of the type's; others have 4."""
    observation = torch.zeros(1, 3, 16)
    observation[..., FIRST + 2], observation[..., FIRST + 7] = 1.0, 0.75
    for logits, wanted in (("", 1.0), ("b=9", 1.0), ("a=8", 2.0), ("a=0", 0.0)):
        policies = Policies(IppoConfig(hidden=32, suggestion_logits=logits), TEAM, 0)
        with torch.no_grad():
            outputs = policies.stacks[0](observation)
        assert (outputs[..., 2] - outputs[..., 7]).numpy() == pytest.approx(wanted, abs=0.1)


def test_hidden_layers_must_hold_the_suggestion():
    """One unit for each move, or one clear sentence."""
    with pytest.raises(ConfigError, match=r"algorithm\.hidden must be at least 9"):
        Policies(IppoConfig(hidden=8), TEAM, 0)
