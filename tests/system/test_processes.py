"""The processes one by one: any order, joining, leaving, dying, and nothing unexplained at the end."""

import signal
import subprocess
from pathlib import Path

import psutil
import pytest

from eia_sec.common.config import RolloutConfig
from eia_sec.common.errors import BusError
from eia_sec.common.imitation import ImitationEvent
from eia_sec.common.protocol import frame, keys
from eia_sec.common.protocol.messages import (
    ChunkAck,
    ChunkMessage,
    CommandMessage,
    Envelope,
    ImitationMessage,
    ReceiptMessage,
)
from eia_sec.common.transport.bus import Bus
from eia_sec.deploy.monitor.audit import audit
from tests.faults.tools.harness import BEHIND
from tests.system.fleet import RUN, Processes, until


def finish(processes: Processes) -> dict[str, int]:
    """Wait for the learner's end and return the last ledger."""
    assert processes.wait("learner") == 0
    return processes.records("status")[-1]["ledger"]


def test_any_order_and_a_clean_end(processes: Processes) -> None:
    """A worker that starts before the learner waits for it; when the run is done everybody ends with code 0."""
    processes.lengthen(300)  # so that the coordinator has joined before it ends
    processes.worker()
    processes.coordinator()
    processes.learner()
    ledger = finish(processes)
    assert processes.wait("rollout-0") == 0
    assert processes.wait("elite") == 0
    assert ledger["accepted"] > 0
    assert (ledger["unexplained"], ledger["lost"], ledger["rejected"]) == (0, 0, 0)
    events = processes.records("imitation")
    assert [record["event"] for record in events] == list(range(1, len(events) + 1))
    assert len(events) >= 2


def maps(process: "subprocess.Popen[bytes]") -> set[str]:
    """Return the shared-memory segments of Zenoh that a process has in its address space."""
    lines = Path(f"/proc/{process.pid}/maps").read_text().splitlines()
    return {line.split()[-1] for line in lines if "/dev/shm/" in line and ".zenoh" in line}


def test_transitions_through_shared_memory(processes: Processes) -> None:
    """Learner and worker that both say so share memory, one that does not is served as always; nothing is lost."""
    processes.lengthen(100_000)
    learner = processes.learner("--shared-memory")
    sharing, other = processes.worker("0", "--shared-memory"), processes.worker("1")
    until(lambda: maps(learner) & maps(sharing), "common memory")
    assert not maps(other)
    known = processes.directory / "run" / "history" / "learner.jsonl"
    for name in "01":
        until(lambda name=name: known.exists() and f'["accepted","{name}"' in known.read_text(), "chunks of each")
    assert processes.drain()
    ledger = finish(processes)
    assert ledger["accepted"] > 0
    assert (ledger["unexplained"], ledger["lost"], ledger["rejected"]) == (0, 0, 0)


def said_flown(processes: Processes, *workers: str) -> int:
    """Return what the workers' starts together said that they had flown, by the requests that the learner took."""
    said: dict[tuple[str, int], int] = {}
    for entry in (entry for worker in workers for entry in processes.accepted(worker)):
        source = entry.worker, entry.incarnation
        said[source] = max(said.get(source, 0), entry.flown, entry.produced)
    return sum(said.values())


def stranded(processes: Processes, learner: subprocess.Popen[bytes]) -> bool:
    """Freeze the learner when it knows of three chunks that worker 0 still holds; thaw it if they came meanwhile.

    A request may hold all of them, so that what had been sent before the kill can still arrive after the thaw.
    """

    def held() -> bool:
        newest = processes.accepted("0")[-1:]
        return any(entry.flown - entry.produced >= 3 * entry.steps for entry in newest)

    if not held():
        return False
    learner.send_signal(signal.SIGSTOP)
    until(lambda: psutil.Process(learner.pid).status() == psutil.STATUS_STOPPED, "the freeze")
    if held():
        return True
    learner.send_signal(signal.SIGCONT)
    return False


def test_a_late_event_is_waited_for(processes: Processes) -> None:
    """New experience waits for an event that is a whole cycle late, instead of a run that ends without imitation."""
    event = ImitationEvent(1, 1, 2, 0.1, (0, 1, 1), ((0.5,), (0.1, 0.2), (0.1, 0.2)))
    processes.learner("--await-elite")
    processes.worker()
    epoch = processes.configuration().epoch
    until(lambda: any(r["waits"]["imitation"] > 0.5 for r in processes.records("status")), "a wait for imitation")
    assert processes.records("status")[-1]["episodes"] == 4
    with Bus.connect(processes.endpoint, "control") as bus:
        late = Envelope("elite", "late", 1, 1).encode()
        bus.ask(keys.COMMAND.key(RUN, verb="lead"), CommandMessage("late").encode(), 5.0, late)
        answer = bus.ask(keys.IMITATION.key(RUN), ImitationMessage.of(event, epoch).encode(), 5.0, late)
    assert answer is not None
    assert ReceiptMessage.decode(answer) == ReceiptMessage(True, "")
    assert finish(processes)["unexplained"] == 0
    assert [(record["event"], record["episodes"]) for record in processes.records("imitation")] == [(1, 4)]


def test_a_worker_that_is_killed_and_replaced(processes: Processes) -> None:
    """After kill -9 with chunks in its spool a new start goes on; what no request held is explained, nothing twice."""
    processes.config.write_text(BEHIND)
    learner = processes.learner()
    processes.coordinator()
    processes.worker()
    processes.worker("1")
    until(lambda: stranded(processes, learner), "a spool with chunks")
    first = processes.accepted("0")[-1].incarnation
    processes.kill("rollout-0")
    learner.send_signal(signal.SIGCONT)
    processes.worker("0")
    until(lambda: processes.accepted("0")[-1].incarnation > first, "a chunk of the new start")
    learner.send_signal(signal.SIGTERM)
    ledger = finish(processes)
    found = audit(processes.directory / "run")
    assert found.clean, found.to_dict()
    # Three starts end with chunks in hand: the killed one, and two for which the finished learner took no more.
    assert found.chunks["lost"] <= 3 * (RolloutConfig().spool_chunks + 1)
    assert ledger["unexplained"] == 0
    assert ledger["accepted"] == processes.records("status")[-1]["environment_steps"] == found.steps["accepted"]
    fates = ledger["accepted"] + ledger["lost"] + ledger["rejected"] + ledger["in_flight"]
    assert fates == ledger["produced"] == said_flown(processes, "0", "1")
    assert fates <= sum(found.steps.values())


def test_a_learner_that_is_killed_resumes(processes: Processes) -> None:
    """After kill -9 the learner goes on from its checkpoint; the waiting worker and coordinator go on by themselves."""
    processes.lengthen(200)
    processes.learner()
    processes.coordinator()
    processes.worker()
    until(lambda: list((processes.directory / "run" / "checkpoints").glob("*")), "a checkpoint")
    until(lambda: len(processes.records("episodes")) >= 4, "training")
    processes.kill("learner")
    processes.learner("--resume")
    ledger = finish(processes)
    assert ledger["unexplained"] == 0
    assert ledger["accepted"] == processes.records("status")[-1]["environment_steps"]
    assert processes.records("end")[-1]["episodes"] >= 200
    events = [record["event"] for record in processes.records("imitation")]
    assert sorted(set(events)) == list(range(1, max(events) + 1))
    assert processes.wait("rollout-0") == 0
    assert processes.wait("elite") == 0


def test_sigterm_drains_and_checkpoints(processes: Processes) -> None:
    """A learner that gets SIGTERM writes a checkpoint and a policy and exits with code 0; so does a worker."""
    processes.lengthen(100_000)
    learner = processes.learner()
    worker = processes.worker()
    until(lambda: processes.records("episodes"), "training")
    before = processes.records("status")[-1]["environment_steps"] if processes.records("status") else 0
    learner.send_signal(signal.SIGTERM)
    assert processes.wait("learner", 20.0) == 0
    assert processes.records("end")[-1]["state"] == "draining"
    last = processes.records("status")[-1]
    assert last["ledger"]["accepted"] == last["environment_steps"] >= before
    assert (processes.directory / "run" / "policy.safetensors").exists()
    worker.send_signal(signal.SIGTERM)
    assert processes.wait("rollout-0", 20.0) == 0


def test_a_drain_takes_in_what_a_worker_holds(processes: Processes) -> None:
    """A worker whose spool stands full before a slow learner has delivered it when the learner has drained."""
    processes.config.write_text(BEHIND)
    processes.learner()
    worker = processes.worker()

    def holding() -> bool:
        newest = processes.accepted("0")[-1:]
        return any(entry.flown - entry.produced >= 4 * entry.steps for entry in newest)

    until(holding, "a spool with chunks")
    assert processes.drain()
    assert processes.wait("learner", 20.0) == 0
    worker.send_signal(signal.SIGTERM)
    assert processes.wait("rollout-0", 20.0) == 0
    found = audit(processes.directory / "run")
    assert found.clean, found.to_dict()
    # On a busy machine the learner may take a late chunk for the end.
    assert found.chunks["lost"] <= 1


def test_the_learner_answers_commands(processes: Processes) -> None:
    """It answers with its configuration, drains on request, and its epoch is that of its start."""
    processes.lengthen(100_000)
    processes.learner()
    answer = processes.configuration()
    assert "episodes = 100000" in answer.toml
    assert answer.epoch > 0
    assert processes.drain()
    assert processes.wait("learner", 20.0) == 0


def test_crafted_frames_do_not_stop_the_learner(processes: Processes) -> None:
    """Requests that are no chunks are refused and counted, and the run comes to its end all the same."""
    processes.learner()
    processes.configuration()
    with Bus.connect(processes.endpoint, "control") as bus, pytest.raises(BusError):
        bus.ask(keys.COMMAND.key(RUN, verb="drain"), b"junk", 5.0)
    with Bus.connect(processes.endpoint, "bulk") as bus:
        key = keys.TRANSITION.key(RUN, worker="x")
        envelope = Envelope("rollout", "x", 1, 1).encode()
        mixed = frame.encode(ChunkMessage.KIND, {"a": 1, b"b": 2}, {})  # type: ignore[dict-item]  # on purpose
        for payload, attachment in ((b"", b""), (b"junk", envelope), (mixed, envelope), (mixed, b"junk")):
            try:
                answer = bus.ask(key, payload, 5.0, attachment)
            except BusError:
                continue
            assert answer is not None
            assert ChunkAck.decode(answer).verdicts == ("damaged",)
    processes.coordinator()
    processes.worker()
    ledger = finish(processes)
    assert ledger["damaged"] >= 2
    assert processes.records("status")[-1]["malformed"] >= 2
    assert processes.records("status")[-1]["malformed_commands"] == 1


def test_a_lockstep_run_takes_one_worker_only(processes: Processes) -> None:
    """A second worker is refused with the reason, and the first one's run ends as it should."""
    processes.learner("--lockstep")
    processes.worker()
    until(lambda: processes.records("episodes"), "training")
    processes.worker("1")
    # Without a coordinator the run stands still at its first imitation event, so it is not over before.
    until(lambda: "a lockstep run has exactly one worker" in processes.log("rollout-1"), "the refusal")
    processes.coordinator()
    assert processes.wait("learner") == 0
    assert processes.records("end")[-1]["state"] == "finished"
    assert processes.records("status")[-1]["ledger"]["accepted"] == 8 * 40
