"""How many cores there are, and how many compute threads a process has."""

from eia_sec.deploy.local import threads


def test_only_cores_that_may_be_used_count(monkeypatch):
    """A process that is held to one of two cores has one; where the system does not say, all count."""
    monkeypatch.setattr(threads.os, "cpu_count", lambda: 2)
    monkeypatch.setattr(threads.os, "sched_getaffinity", lambda _: {1}, raising=False)
    assert threads.allowed_cores() == 1
    monkeypatch.delattr(threads.os, "sched_getaffinity")
    assert threads.allowed_cores() == 2
