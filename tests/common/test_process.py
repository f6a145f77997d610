"""What every process does alike: logs that a full disk does not stop, and reports that any sum fits into."""

import io
import sys

from common.process import LARGEST, SEPARATOR, Presence, log
from common.protocol import keys
from common.protocol.messages import MetricMessage
from common.transport.bus import Bus
from common.transport.endpoint import free_endpoint
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
    told = capsys.readouterr().err.splitlines()
    assert [line.partition(" ")[2] for line in told] == ["(2 lines before this one could not be written) three", "four"]


def test_what_others_wrote_is_printable(capsys):
    """A line stays one line, and the lines of one entry stay divided as they were."""
    log("worker \x1b[2J says\nALARM" + SEPARATOR + "second")
    told = capsys.readouterr().err.splitlines()
    assert [line.partition(" ")[2] for line in told] == ["worker ?[2J says?ALARM", " | second"]


def test_a_sum_that_no_frame_holds_is_told_as_the_largest_one_does():
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
