"""The learner takes arguments for the run's environments from a command, and refuses what are none."""

from types import SimpleNamespace

import pytest

from eia_sec.common.config.environment import MOST_ARGUMENTS
from eia_sec.common.protocol import keys
from eia_sec.common.protocol.messages import CommandMessage, ConfigurationMessage, ReceiptMessage
from eia_sec.learner.process.command_server import CommandServer


def asked(arguments):
    """Send the command; return the server, the answers and the refusals."""
    answers, refusals = [], []
    request = SimpleNamespace(
        key=keys.COMMAND.key("run", verb="arguments"),
        payload=CommandMessage("train", arguments).encode(),
        reply=answers.append,
        refuse=refusals.append,
    )
    configuration = ConfigurationMessage(1, "", {}, lockstep=False)
    server = CommandServer(SimpleNamespace(waiting=lambda: [request]), configuration, lambda worker: 0)
    server.answer()
    return server, answers, refusals


def test_arguments_are_taken():
    """The learner holds a JSON object, and says that it has it."""
    server, answers, refusals = asked('{"size": 8}')
    assert server.arguments == '{"size": 8}'
    assert ReceiptMessage.decode(answers[0]).done
    assert (refusals, server.malformed) == ([], 0)


@pytest.mark.parametrize("arguments", [None, "[1]", "{", '{"size": "' + "x" * MOST_ARGUMENTS + '"}', "[" * 5000])
def test_what_are_no_arguments_is_refused_and_counted(arguments):
    """Nothing, no object, no JSON, too long, too deep: the present arguments stay."""
    server, answers, refusals = asked(arguments)
    assert (server.arguments, answers, server.malformed) == ("", [], 1)
    assert "argument" in refusals[0]
