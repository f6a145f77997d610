"""What a worker does from its stop to its end."""

from rollout.worker.service import Worker, WorkerOptions


class Recorded:
    """Stands for every part of a worker; writes down who was called, and a sender waits as the real one does."""

    def __init__(self, name: str, calls: list[str]) -> None:
        self._name, self._calls = name, calls
        self.state, self.in_flight = "running", 12

    def wait_empty(self, timeout, meanwhile):
        """Two turns of waiting in which nothing is delivered."""
        meanwhile()
        meanwhile()
        return False

    def __getattr__(self, method):
        return lambda *_: self._calls.append(f"{self._name}.{method}")


def test_a_worker_that_ends_still_serves_the_coordinator(monkeypatch, capsys):
    """A learner that waits for an imitation event takes no chunks, so the worker's last ones would wait for itself."""
    calls: list[str] = []
    worker = Worker.__new__(Worker)
    worker._options = WorkerOptions("run", "3", None)
    worker._stop = True
    for part in ("learner", "evaluations", "sender", "history"):
        setattr(worker, f"_{part}", Recorded(part, calls))
    monkeypatch.setattr(worker, "_report", lambda: calls.append("report"))
    worker.run()
    served = ["learner.poll", "evaluations.poll"]
    assert calls == [*served, *served, "report", "sender.close", "history.close"]
    assert "worker 3: 12 steps were not delivered." in "".join(capsys.readouterr())
