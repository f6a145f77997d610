"""What fresh policies do before they have learned anything."""

import numpy as np
import pytest
import torch

from eia_sec.common.actions.adapters import Headings, NineMoves
from eia_sec.common.config import IppoConfig
from eia_sec.common.errors import ConfigError
from eia_sec.common.farm import HEADING_SPEEDS
from eia_sec.common.team import GroupSpec, TeamSpec
from eia_sec.learner.on_policy.policies import Policies

FIRST = 5
TEAM = TeamSpec((GroupSpec("a", 3, 16, 1, (NineMoves(FIRST),), (9,)),))
TIME_LEFT = 2
RELAY = Headings(*HEADING_SPEEDS, 0.025, potential=FIRST, time_left=TIME_LEFT)
RELAYS = TeamSpec((GroupSpec("a", 3, 16, 1, (RELAY,), (25,)),))


@pytest.mark.parametrize("shared_until", [1.0, 0.0])
def test_a_fresh_policy_follows_the_suggested_move(shared_until):
    """Whatever else it sees, it takes that move seven times in eight."""
    policies = Policies(IppoConfig(hidden=32, shared_until=shared_until), TEAM, 0)
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
    for logits, wanted in (({}, 1.0), ({"b": 9.0}, 1.0), ({"a": 8.0}, 2.0), ({"a": 0.0}, 0.0)):
        policies = Policies(IppoConfig(hidden=32, suggestion_logits=logits), TEAM, 0)
        with torch.no_grad():
            outputs = policies.stacks[0](observation)
        assert (outputs[..., 2] - outputs[..., 7]).numpy() == pytest.approx(wanted, abs=0.1)


def test_hidden_layers_must_hold_the_suggestion():
    """One unit for each move, or one clear sentence."""
    with pytest.raises(ConfigError, match=r"algorithm\.hidden must be at least 9"):
        Policies(IppoConfig(hidden=8), TEAM, 0)


def test_a_fresh_policy_favours_moves_that_serve_much_and_lead_to_nobody():
    """Without a suggestion. With one, it follows that."""
    worth, harm = 0, 9
    observation = torch.from_numpy(np.random.default_rng(0).uniform(0.0, 1.0, (40, 3, 18)).astype(np.float32))
    for first, wanted in (
        (-1, 4.0 * observation[..., :9] - 8.0 * observation[..., 9:]),
        (3, 4.0 * observation[..., 3:12]),
    ):
        moves = NineMoves(first, worth=worth, harm=harm)
        team = TeamSpec((GroupSpec("a", 3, 18, 1, (moves,), (9,)),))
        with torch.no_grad():
            outputs = Policies(IppoConfig(hidden=32), team, 0).stacks[0](observation)
        assert outputs.numpy() == pytest.approx(wanted.numpy(), abs=0.1)
        narrow = Policies(IppoConfig(hidden=17), team, 0).stacks[0].layers[-2]
        assert (narrow.abs().max() > 1.0) == (first >= 0)


def options_of(hidden: int, observation: torch.Tensor, **settings) -> torch.Tensor:
    policies = Policies(IppoConfig(hidden=hidden, **settings), RELAYS, 0)
    with torch.no_grad():
        return policies.stacks[0](observation)[0, 0]


@pytest.mark.parametrize("shared_until", [1.0, 0.0])
def test_a_fresh_relay_flies_where_a_potential_falls_as_time_runs_out(shared_until):
    """It rests until then. At the end it flies fast on the heading of the best move, for every heading."""
    for heading in range(8):
        x, y = np.rint(np.cos(heading * np.pi / 4)), np.rint(np.sin(heading * np.pi / 4))
        observation = torch.zeros(1, 3, 16)
        observation[..., FIRST : FIRST + 9] = 0.3
        observation[..., FIRST + int(3 * (x + 1) + y + 1)] = -0.5
        observation[..., TIME_LEFT] = 1.0
        assert options_of(16, observation, shared_until=shared_until).argmax() == 0
        observation[..., TIME_LEFT] = 0.2
        outputs = options_of(16, observation, shared_until=shared_until)
        assert outputs.argmax() == 1 + 8 * 2 + heading
        assert outputs[1 + 8 * 2 + heading].item() == pytest.approx(20.0 * (0.5 - 0.2), abs=0.1)
        assert outputs[1 + 8 + heading].item() == pytest.approx(0.9 * 20.0 * (0.5 - 0.2), abs=0.1)


@pytest.mark.parametrize("settings", [{"hidden": 8}, {"hidden": 16, "memory": "gru", "sequence_steps": 4}])
def test_a_relay_without_room_for_it_rests(settings):
    """Narrow networks, and networks with memory, begin without that preference."""
    policies = Policies(IppoConfig(**settings), RELAYS, 0)
    layers = policies.stacks[0].layers
    assert layers[-1][0, 0].item() == 2.5
    assert layers[-2].abs().max().item() < 0.1
