"""What every process does alike: logs that a full disk does not stop, and reports that any sum fits into."""

import datetime
import io
import os
import signal
import sys
from pathlib import Path

import pytest

from eia_sec.common.log import SEPARATOR, log
from eia_sec.common.process import LARGEST, Presence, StopSignal, denial
from eia_sec.common.protocol import keys
from eia_sec.common.protocol.messages import MetricMessage
from eia_sec.common.transport.bus import Bus
from eia_sec.common.transport.credentials import Credentials, Identity
from eia_sec.common.transport.endpoint import free_endpoint
from tests.system.fleet import until


def test_a_full_disk_costs_lines_and_nothing_else(monkeypatch, capsys):
    """A line that cannot be written is counted, and the next one that can says how many there were."""
    refused = []

    class Full(io.StringIO):
        def write(self, text: str) -> int:
            refused.append(text)
            raise OSError(28, "No space left on device")

    monkeypatch.setattr(sys, "stderr", Full())
    log("one")
    log("two")
    monkeypatch.undo()
    assert len(refused) == 2
    log("three")
    log("four")
    lines = capsys.readouterr().err.splitlines()
    assert [line.partition(" ")[2] for line in lines] == [
        "(2 lines before this one could not be written) three",
        "four",
    ]


def test_what_others_wrote_is_printable(capsys):
    """A line stays one line, and the lines of one entry stay divided as they were."""
    log("worker \x1b[2J says\nALARM" + SEPARATOR + "second")
    lines = capsys.readouterr().err.splitlines()
    assert [line.partition(" ")[2] for line in lines] == ["worker ?[2J says?ALARM", " | second"]


def test_a_sum_that_no_frame_holds_is_reported_as_the_largest_one_does():
    """Whatever adds up to what a message cannot hold, the report leaves, and everything else in it is as it was."""
    endpoint = free_endpoint()
    with Bus.listen(endpoint, "control") as bus:
        heard = bus.subscribe(keys.METRIC.pattern("r"), 16)
        values = {
            "ledgers": {"a": {"produced": 2**70, "lost": -(2**70)}},
            "list": [2**64, "x"],
            "rate": 0.5,
            "on": True,
        }
        presence = Presence(bus, "r", "rollout", "0", 1)
        presence.report(values)
        sample = until(heard.poll, "a report")
        assert MetricMessage.decode(sample.payload).values == {
            "ledgers": {"a": {"produced": LARGEST, "lost": -LARGEST}},
            "list": [LARGEST, "x"],
            "rate": 0.5,
            "on": True,
        }


def expiring(seconds):
    ends = datetime.datetime.now(datetime.UTC) + datetime.timedelta(seconds=seconds)
    return Credentials(Path("keys/rollout.w"), Identity("rollout", "w"), ends)


@pytest.mark.parametrize(
    ("seconds", "words"),
    [(-1, "has expired"), (86_400, "expires on"), (365 * 86_400, "")],
    ids=["past", "soon", "later"],
)
def test_a_certificate_that_ends_is_an_alarm(seconds, words, capsys):
    """Each report of the process says so, its log says so once, and a process that waits for a learner does."""
    endpoint = free_endpoint()
    with Bus.listen(endpoint, "control") as bus:
        inbox = bus.subscribe(keys.METRIC.pattern("r"), 8)
        bus.credentials = expiring(seconds)
        presence = Presence(bus, "r", "rollout", "w", 1)
        presence.report({"alarms": ["own"]})
        presence.report({})
        found = []
        until(lambda: found.extend(inbox.drain()) or len(found) == 2, "two reports")
        first, second = (MetricMessage.decode(sample.payload).values for sample in found)
        assert (denial(bus, "r", "key") is not None) == (seconds < 0)
    assert first["alarms"][0] == "own"
    assert [words in text for text in first["alarms"][1:]] == [True] * bool(words)
    assert len(second.get("alarms", [])) == bool(words)
    assert capsys.readouterr().err.count("the certificate of rollout.w") == bool(words)


def test_a_signal_that_interrupts_a_wait_does_not_wait_for_it():
    """The handler runs in the thread that may hold the event's lock, and must not want it."""
    stop, before = StopSignal(), (signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGTERM))
    stop.install()
    try:
        with stop.event._cond:
            os.kill(os.getpid(), signal.SIGTERM)
            assert not stop
        until(lambda: stop, "the flag")
    finally:
        for number, handler in zip((signal.SIGINT, signal.SIGTERM), before, strict=True):
            signal.signal(number, handler)


def test_no_standard_error_is_like_a_full_one(monkeypatch, capsys):
    """A process whose standard error was closed at its start goes on."""
    monkeypatch.setattr(sys, "stderr", None)
    log("unheard")
    monkeypatch.undo()
    log("heard")
    assert "1 lines before this one could not be written) heard" in capsys.readouterr().err
