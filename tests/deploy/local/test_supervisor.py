"""The supervisor: who dies is started again after a while, with its reason, and not for ever."""

import time

import pytest

from eia_sec.deploy.local import memory_kills, supervisor
from eia_sec.deploy.local.supervisor import Supervisor

PAUSES = (0.05, 0.1, 0.15)
FAILING = ("alive", "learner", "learner", "--connect", "tcp/127.0.0.1:1", "--patience", "0.1")
"""A command that ends with code 1, since nobody listens there."""


@pytest.fixture
def children(tmp_path, monkeypatch):
    monkeypatch.setattr(supervisor, "BACKOFF_SECONDS", PAUSES)
    family = Supervisor(tmp_path)
    yield family
    family.stop(seconds=1.0)


def watch(family, child, seconds=120.0):
    """Watch until a child is given up; return the times at which it was started."""
    starts, deadline = [child.started], time.monotonic() + seconds
    while not child.given_up:
        assert time.monotonic() < deadline, family.alarms
        family.watch()
        if child.started != starts[-1]:
            starts.append(child.started)
        time.sleep(0.005)
    return starts


def test_a_child_that_always_dies_is_given_up_after_the_last_pause(children):
    """It is restarted after each pause, each time with exit code and last line in an alarm, and then given up."""
    child = children.start("probe", FAILING)
    starts = watch(children, child)
    assert len(starts) == 1 + len(PAUSES)
    assert [b - a >= pause for a, b, pause in zip(starts, starts[1:], PAUSES, strict=False)] == [True] * len(PAUSES)
    assert len(children.alarms) == len(starts)
    assert all("probe ended with exit code 1" in alarm and "learner" in alarm for alarm in children.alarms)
    assert [("restarting it" in alarm) for alarm in children.alarms] == [True] * len(PAUSES) + [False]
    assert "is not restarted" in children.alarms[-1]


def test_a_mistake_is_not_tried_again(children):
    """A child that exits over a usage error is given up at once, with its message."""
    child = children.start("typo", ["nonsense"])
    assert len(watch(children, child)) == 1
    assert "exit code 2" in children.alarms[0]
    assert "unknown command 'nonsense'" in children.alarms[0]


def test_the_log_shows_all_that_a_dead_child_wrote_last(children, tmp_path, capsys):
    """An alarm is one line; the log has the child's last lines."""
    child = children.start("typo", ["nonsense"])
    (tmp_path / "typo.log").write_text("first\nsecond\n", encoding="utf-8")
    watch(children, child)
    printed = "".join(capsys.readouterr())
    assert "| first" in printed
    assert "| second" in printed
    assert "first" not in children.alarms[0]


def test_a_killed_child_is_named_by_its_signal(children):
    """The reason of a child that somebody killed is the signal."""
    child = children.start("sleeper", ["alive", "learner", "learner", "--connect", "tcp/127.0.0.1:1"])
    child.process.kill()
    child.process.wait()
    children.watch()
    assert "sleeper ended with signal 9" in children.alarms[0]
    assert "the kernel or somebody else killed it; nothing shows that memory ran out" in children.alarms[0]


@pytest.mark.parametrize(
    ("version", "before", "said"),
    [
        (2, {"control group": 3}, "the kernel killed it, because the memory of its control group ran out"),
        (1, {"control group": 3}, "the kernel killed it, because the memory of its control group ran out"),
        (2, {"control group": 4, "host": 6}, "the kernel killed processes of this host while it ran, because memory"),
        (2, {"control group": 4, "host": 7}, "nothing shows that memory ran out"),
    ],
)
def test_a_child_that_the_kernel_killed_for_memory_is_told_from_others(tmp_path, monkeypatch, version, before, said):
    """The kernel's own counters are the evidence, and the memory that there is follows."""
    files = {
        "proc/self/cgroup": "4:memory:/a/b\n0::/a/b\n",
        "proc/vmstat": "oom_kill 7\n",
        "proc/meminfo": "MemTotal: 8388608 kB\nMemAvailable: 4194304 kB\n",
    }
    if version == 2:
        files |= {"cg/a/b/memory.events": "low 0\noom_kill 4\n", "cg/a/b/memory.max": "2147483648"}
        files["cg/a/b/memory.current"] = "1073741824"
    else:
        files |= {"cg/memory/a/b/memory.oom_control": "under_oom 0\noom_kill 4\n"}
        files |= {
            f"cg/memory/a/b/memory.{name}_in_bytes": str(2**size) for name, size in (("limit", 31), ("usage", 30))
        }
    for name, text in files.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    monkeypatch.setattr(memory_kills, "PROC", tmp_path / "proc")
    monkeypatch.setattr(memory_kills, "GROUPS", tmp_path / "cg")
    found = memory_kills.kill_sentence(before)
    assert said in found
    assert found.endswith("(the control group uses 1.0 of 2.0 GiB, 4.0 of the host's 8.0 GiB are available)")


def test_a_child_that_code_of_others_ended_is_told_from_ours(children):
    """No command of ours ends with another code than those of its page."""
    child = children.start("stranger", ["alive", "learner", "learner", "--connect", "tcp/127.0.0.1:1"])
    children._ended(child, 7)
    assert f"stranger ended with exit code 7; restarting it: {supervisor.FOREIGN}" in children.alarms[0]
    assert supervisor.FOREIGN in child.ending


def test_of_a_long_log_only_the_end_is_read(tmp_path, monkeypatch):
    """The last lines are those of the whole file, and a line without an end is cut."""
    monkeypatch.setattr(supervisor, "TAIL_BYTES", 40)
    (tmp_path / "a.log").write_text("x" * 1000 + "\none\ntwo\nthree\nfour\nfive\n")
    assert Supervisor(tmp_path).tail("a").splitlines() == ["one", "two", "three", "four", "five"]
    (tmp_path / "a.log").write_bytes(b"\xff" * 1000)
    assert len(Supervisor(tmp_path).tail("a")) == 40
