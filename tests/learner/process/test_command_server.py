"""Commands to the learner: arguments for the run's environments, and the configuration that a process asks for."""

from itertools import pairwise
from types import SimpleNamespace

import pytest

from eia_sec.common.config.environment import MOST_ARGUMENTS
from eia_sec.common.incarnation import STRIDE
from eia_sec.common.protocol import keys
from eia_sec.common.protocol.messages import CommandMessage, ConfigurationMessage, ReceiptMessage
from eia_sec.learner.process.command_server import CommandServer


def asked(arguments=None, verb="arguments", known=0):
    """Send a command; return the server, the answers and the refusals."""
    answers, refusals = [], []
    request = SimpleNamespace(
        key=keys.COMMAND.key("run", verb=verb),
        payload=CommandMessage("train", arguments).encode(),
        reply=answers.append,
        refuse=refusals.append,
    )
    configuration = ConfigurationMessage(1, "", {}, lockstep=False)
    server = CommandServer(SimpleNamespace(waiting=lambda: [request]), configuration, lambda worker: known)
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


@pytest.mark.parametrize(("ahead", "beyond"), [(-5_000_000, 0), (0, 0), (5_000_000, 5_000_000)])
def test_a_new_start_goes_beyond_earlier_ones_that_have_delivered_nothing_yet(monkeypatch, ahead, beyond):
    """Of these the learner knows no number, but they took theirs before now; a known greater one counts."""
    now = 1_700_000_000_000_000
    monkeypatch.setattr("eia_sec.learner.process.command_server.microseconds", lambda: now)
    _, answers, _ = asked(verb="configuration", known=now + ahead)
    assert ConfigurationMessage.decode(answers[0]).newest_incarnation == now + beyond


def test_of_two_starts_at_once_the_later_goes_beyond_whatever_the_earlier_took(monkeypatch):
    """Both draw at random how far they go beyond the number that they are given."""
    monkeypatch.setattr("eia_sec.learner.process.command_server.microseconds", lambda: 1_700_000_000_000_000)
    answers = []
    request = SimpleNamespace(
        key=keys.COMMAND.key("run", verb="configuration"),
        payload=CommandMessage("0").encode(),
        reply=answers.append,
    )
    configuration = ConfigurationMessage(1, "", {}, lockstep=False)
    server = CommandServer(SimpleNamespace(waiting=lambda: [request]), configuration, lambda worker: 0)
    for _ in range(3):
        server.answer()
    given = [ConfigurationMessage.decode(answer).newest_incarnation for answer in answers]
    assert [later - earlier for earlier, later in pairwise(given)] == [STRIDE, STRIDE]
