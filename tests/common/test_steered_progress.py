"""A callback changes the environment's arguments: what is sent, kept and refused."""

import json

import pytest

from eia_sec.common.config.environment import MOST_ARGUMENTS, EnvConfig
from eia_sec.common.config.presets import preset
from eia_sec.common.errors import ConfigError
from eia_sec.common.steered_progress import SteeredProgress


class Sent(SteeredProgress):
    """Keeps what was sent."""

    environment_steps = episodes = updates = 0
    progress, metrics = 0.0, {}

    def __init__(self, name="mytask.env:Cover"):
        super().__init__(preset("generic").with_environment(name))
        self.sent = []

    def _change(self, arguments):
        self.sent.append(json.loads(arguments))


def test_a_list_that_was_changed_in_place_is_sent():
    """What a callback keeps and changes is compared with what was sent, not with itself; what is equal is not sent."""
    training, levels = Sent(), [1]
    training.set_arguments(levels=levels)
    training.set_arguments(levels=levels)
    levels.append(2)
    training.set_arguments(levels=levels)
    assert training.sent == [{"levels": [1]}, {"levels": [1, 2]}]


@pytest.mark.parametrize(
    ("arguments", "said"),
    [({"size": object()}, "are no JSON"), ({"map": "x" * MOST_ARGUMENTS}, f"at most {MOST_ARGUMENTS} fit")],
)
def test_arguments_that_cannot_be_sent_are_refused(arguments, said):
    """They are no JSON or too long, and nothing is sent."""
    training = Sent()
    with pytest.raises(ConfigError, match=said):
        training.set_arguments(**arguments)
    assert training.sent == []


def test_environments_that_others_serve_take_no_arguments():
    """They are made elsewhere, so a callback and a configuration are refused."""
    with pytest.raises(ConfigError, match="takes no arguments"):
        Sent("zenoh:site-*").set_arguments(size=3)
    with pytest.raises(ConfigError, match=r"env\.arguments have no effect"):
        EnvConfig("zenoh:site-*", arguments='{"size": 3}')
