"""A program's callbacks beside a learner of another process: what the learner answers."""

from types import SimpleNamespace

import pytest

from eia_sec.common.config.presets import preset
from eia_sec.common.errors import BusError, ConfigError
from eia_sec.deploy.python.training import _Elsewhere

CONFIG = preset("generic").with_environment("mytask.env:Cover")


def test_a_learner_that_refuses_is_heard_and_one_that_is_silent_is_asked_again():
    """A refusal is the caller's error and is not repeated; where no answer came, the arguments are sent again."""
    asked, monitor = [], SimpleNamespace(learner_values=lambda: {"arguments": ""})
    training = _Elsewhere(CONFIG, (), monitor, asked.append)
    training.set_arguments(size=9)
    training.repeat()
    assert asked == ['{"size": 9}', '{"size": 9}']

    def refuse(arguments):
        raise BusError("no.")

    refused = _Elsewhere(CONFIG, (), monitor, refuse)
    with pytest.raises(ConfigError, match=r"the learner refused the environment's arguments: no\."):
        refused.set_arguments(size=9)
    refused.repeat()
