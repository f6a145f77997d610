"""The processes one by one: any order, joining, leaving, dying, and nothing unexplained at the end."""

import signal

from tests.system.fleet import Processes, until


def finish(processes: Processes) -> dict[str, int]:
    """Wait for the learner's end and return the last ledger."""
    assert processes.wait("learner") == 0
    return processes.records("status")[-1]["ledger"]


def test_any_order_and_a_clean_end(processes: Processes) -> None:
    """A worker that starts before the learner waits for it; when the run is done everybody ends with code 0."""
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


def test_a_worker_that_is_killed_and_replaced(processes: Processes) -> None:
    """After kill -9 a new start under the same name goes on, nothing is counted twice and nothing unexplained."""
    processes.config.write_text(processes.config.read_text().replace("episodes = 8", "episodes = 24"))
    processes.learner()
    processes.coordinator()
    processes.worker()
    processes.worker("1")
    until(lambda: len(processes.records("episodes")) >= 2, "training")
    processes.kill("rollout-0")
    processes.worker("0")
    ledger = finish(processes)
    assert ledger["unexplained"] == 0
    steps = processes.records("status")[-1]["environment_steps"]
    assert steps <= ledger["accepted"]
    assert ledger["accepted"] + ledger["lost"] + ledger["rejected"] == ledger["produced"]


def test_a_learner_that_is_killed_resumes(processes: Processes) -> None:
    """After kill -9 the learner goes on from its checkpoint; the waiting worker and coordinator go on by themselves."""
    processes.config.write_text(processes.config.read_text().replace("episodes = 8", "episodes = 40"))
    processes.learner()
    processes.coordinator()
    processes.worker()
    until(lambda: list((processes.directory / "run" / "checkpoints").glob("*")), "a checkpoint")
    until(lambda: len(processes.records("episodes")) >= 4, "training")
    processes.kill("learner")
    processes.learner("--resume")
    ledger = finish(processes)
    assert ledger["unexplained"] == 0
    assert processes.records("end")[-1]["episodes"] >= 40
    events = [record["event"] for record in processes.records("imitation")]
    assert sorted(set(events)) == list(range(1, max(events) + 1))
    assert processes.wait("rollout-0") == 0
    assert processes.wait("elite") == 0


def test_sigterm_drains_and_checkpoints(processes: Processes) -> None:
    """A learner that is told to end writes a checkpoint and a policy and ends with code 0; so does a worker."""
    processes.config.write_text(processes.config.read_text().replace("episodes = 8", "episodes = 100000"))
    learner = processes.learner()
    worker = processes.worker()
    until(lambda: processes.records("episodes"), "training")
    learner.send_signal(signal.SIGTERM)
    assert processes.wait("learner", 20.0) == 0
    assert processes.records("end")[-1]["state"] == "draining"
    assert (processes.directory / "run" / "policy.safetensors").exists()
    worker.send_signal(signal.SIGTERM)
    assert processes.wait("rollout-0", 20.0) == 0


def test_the_learner_answers_commands(processes: Processes) -> None:
    """It tells its configuration, drains when asked, and the epoch is that of its start."""
    processes.config.write_text(processes.config.read_text().replace("episodes = 8", "episodes = 100000"))
    processes.learner()
    answer = processes.configuration()
    assert "episodes = 100000" in answer.toml
    assert answer.epoch > 0
    assert processes.drain()
    assert processes.wait("learner", 20.0) == 0
