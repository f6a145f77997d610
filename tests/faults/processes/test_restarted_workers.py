"""Two starts of one worker: the first with a wrong clock, or frozen while the second takes its place."""

import signal
import time
from pathlib import Path

from eia_sec.common.history.history import End, Entry, Start, read
from eia_sec.common.protocol import keys
from eia_sec.common.protocol.messages import Envelope
from eia_sec.common.transport.bus import Bus
from tests.faults.tools.harness import FaultRun, run
from tests.faults.tools.shifted_clock import AHEAD
from tests.system.fleet import RUN, until

DAY = 86_400
HISTORY = Path("run") / "history" / "rollout-0.jsonl"


def start_with_a_clock_ahead(fleet: FaultRun, monkeypatch, seconds: float) -> None:
    """Start worker 0 on a machine whose clock is ahead."""
    monkeypatch.setattr(fleet, "module", "tests.faults.tools.shifted_clock")
    monkeypatch.setenv(AHEAD, str(seconds))
    fleet.worker()
    monkeypatch.undo()


def test_a_worker_whose_earlier_start_had_a_clock_ahead_gets_in(tmp_path, monkeypatch):
    """Its chunks are taken at once, its metrics name the clock, and every step is accounted for."""
    with run(tmp_path) as fleet:
        fleet.learner()
        start_with_a_clock_ahead(fleet, monkeypatch, DAY)
        until(lambda: fleet.newest_incarnation("0"), "chunks of the first start", 120.0)
        first = fleet.newest_incarnation("0")
        assert first > (time.time() + DAY / 2) * 1e6
        fleet.kill("rollout-0")
        with fleet.metrics("rollout", "0") as reports:
            fleet.worker()
            until(lambda: fleet.newest_incarnation("0") > first, "a chunk of the second start", 60.0)
            until(lambda: reports() and reports()[-1].get("accepted"), "a report", 30.0)
            assert any("the clock of this machine is 86" in alarm for alarm in reports()[-1]["alarms"])
        assert fleet.newest_incarnation("0") < first + 2**20 + 1
        fleet.kill("rollout-0")
        second = fleet.newest_incarnation("0")
        fleet.worker()
        until(lambda: fleet.newest_incarnation("0") > second, "a chunk of the third start", 60.0)
        fleet.end()
        fleet.audit()


def test_a_worker_that_was_frozen_and_replaced_ends(tmp_path):
    """Thawed, it ends with one sentence, publishes no more metrics, and leaves the newer start's history whole."""
    with run(tmp_path) as fleet:
        fleet.learner()
        old = fleet.worker()
        until(lambda: fleet.newest_incarnation("0"), "chunks of the first start", 120.0)
        first = fleet.newest_incarnation("0")
        old.send_signal(signal.SIGSTOP)
        fleet.running["rollout-frozen"] = fleet.running.pop("rollout-0")
        fleet.worker()
        until(lambda: fleet.newest_incarnation("0") > first, "a chunk of the second start", 60.0)
        old.send_signal(signal.SIGCONT)
        assert fleet.wait("rollout-frozen", 30.0) == 2
        fleet.running.pop("rollout-frozen")
        assert "worker 0 ends:" in fleet.log("rollout-0")
        with Bus.connect(fleet.endpoint, "control", 30.0) as bus:
            metrics = bus.subscribe(keys.METRIC.key(RUN, role="rollout", name="0"), 64)
            seen = []
            until(lambda: seen.extend(metrics.drain()) or len(seen) >= 4, "reports", 30.0)
        assert {Envelope.decode(sample.attachment).incarnation for sample in seen} == {fleet.newest_incarnation("0")}
        fleet.until_more("0")
        fleet.end()
        fleet.audit()
        records = read(tmp_path / HISTORY)[0]
        starts = [record.incarnation for record in records if isinstance(record, Start)]
        assert len(starts) == 2
        assert isinstance(records[-1], End)
        newest = [r.last for r in records if isinstance(r, Entry) and r.incarnation == starts[-1]]
        assert newest, "the second start wrote nothing"


def test_a_frozen_worker_with_a_history_of_its_own_is_ended_by_the_learner(tmp_path):
    """Two starts on two hosts share no file: the learner's verdict ends the older one, and is counted."""
    with run(tmp_path) as fleet:
        fleet.learner()
        old = fleet.worker()
        until(lambda: fleet.newest_incarnation("0"), "chunks of the first start", 120.0)
        first = fleet.newest_incarnation("0")
        old.send_signal(signal.SIGSTOP)
        fleet.running["rollout-frozen"] = fleet.running.pop("rollout-0")
        elsewhere = ("--run", RUN, "--connect", str(fleet.endpoint), "--name", "0")
        fleet.start("rollout-0", "rollout", *elsewhere)
        until(lambda: fleet.newest_incarnation("0") > first, "a chunk of the second start", 60.0)
        old.send_signal(signal.SIGCONT)
        assert fleet.wait("rollout-frozen", 30.0) == 2
        fleet.running.pop("rollout-frozen")
        assert "a newer start of it delivers" in fleet.log("rollout-0")
        with fleet.metrics("learner", "learner") as reports:
            until(lambda: reports() and reports()[-1]["replaced"], "the count of requests", 30.0)
        fleet.end()
