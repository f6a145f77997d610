"""The keeper of a host: full disks, plans that cannot be read, and what becomes of processes that ended."""

import fcntl
import json
import os
import subprocess
import sys
import threading
import time
from dataclasses import replace

import pytest

from eia_sec.common.config.files import to_toml
from eia_sec.common.config.plugin_names import PluginNames
from eia_sec.common.config.presets import preset
from eia_sec.common.errors import HostError
from eia_sec.deploy.hosts import agent, keeper
from eia_sec.deploy.hosts.keeper import PLAN, STATE, Keeper, new_plan, write_json
from eia_sec.deploy.local import supervisor
from tests.system.fleet import until


@pytest.fixture
def kept(tmp_path, monkeypatch):
    """A keeper whose processes are `sleep`, or whatever their arguments say, in a folder of its own."""
    real = subprocess.Popen

    def spawn(command, **options):
        return real([sys.executable, "-c", command[-1]], **options)

    monkeypatch.setattr(supervisor.subprocess, "Popen", spawn)
    found = Keeper(tmp_path)
    yield found
    found._supervisor.stop(seconds=1.0)


def plan(folder, *, again=True, **programs):
    """Write a plan, whose processes are started again or not; a program is a line of Python."""
    processes = {f"rollout.{name}": {"arguments": [text], "threads": 1} for name, text in programs.items()}
    write_json(folder / PLAN, new_plan(processes, again=processes if again else ()))


def turn(kept, times=1):
    """Let the keeper look so many times."""
    for _ in range(times):
        kept._read()
        kept._supervisor.watch()
        kept._apply()
        kept._write_state()


def states(folder):
    """Return each process's state by the keeper's file."""
    return {name: state["state"] for name, state in json.loads((folder / STATE).read_text())["processes"].items()}


def until_state(kept, folder, name, wanted):
    deadline = time.monotonic() + 30.0
    while states(folder).get(name) != wanted:
        assert time.monotonic() < deadline, states(folder)
        turn(kept)
        time.sleep(0.01)


LONG = "import time; time.sleep(600)"


def test_a_full_disk_ends_no_process(kept, tmp_path, monkeypatch):
    """The state is written when there is room again, and an alarm in it says that it was late."""
    plan(tmp_path, a=LONG)
    turn(kept)
    child = kept._supervisor.children["rollout.a"].process

    def refuse(path, value):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(keeper, "write_json", refuse)
    write_json(tmp_path / PLAN, new_plan({}, again=()))
    turn(kept, 3)
    assert states(tmp_path) == {"rollout.a": "running"}
    monkeypatch.setattr(keeper, "write_json", write_json)
    child.wait(10.0)
    turn(kept)
    state = json.loads((tmp_path / STATE).read_text())
    assert state["processes"] == {}
    assert state["alarms"] == ["state.json cannot be written: No space left on device"]
    turn(kept)
    assert json.loads((tmp_path / STATE).read_text()) == state


def test_a_plan_that_cannot_be_read_leaves_the_one_before(kept, tmp_path):
    """What runs goes on, an alarm says why, and the next plan that can be read holds."""
    with pytest.raises(HostError, match=r"plan\.json cannot be read"):
        turn(kept)
    plan(tmp_path, a=LONG)
    turn(kept)
    for damage in ('{"issue": 5}', "nothing"):
        (tmp_path / PLAN).write_text(damage)
        turn(kept, 2)
        assert states(tmp_path) == {"rollout.a": "running"}
    (tmp_path / PLAN).unlink()
    turn(kept)
    assert len(json.loads((tmp_path / STATE).read_text())["alarms"]) == 3
    plan(tmp_path, b=LONG)
    turn(kept)
    until_state(kept, tmp_path, "rollout.b", "running")


@pytest.mark.parametrize("again", [True, False])
def test_up_starts_again_what_ended_as_it_should(kept, tmp_path, again):
    """A worker that somebody stopped runs again after the next plan, unless the run is over."""
    plan(tmp_path, a=f"open({str(tmp_path / 'starts')!r}, 'a').write('x')")
    turn(kept)
    until_state(kept, tmp_path, "rollout.a", "finished")
    plan(tmp_path, again=again, a=f"open({str(tmp_path / 'starts')!r}, 'a').write('x')")
    turn(kept)
    until_state(kept, tmp_path, "rollout.a", "finished")
    assert (tmp_path / "starts").read_text() == ("xx" if again else "x")


def test_no_room_for_a_process_is_tried_again(kept, tmp_path, monkeypatch):
    """A process that cannot be started is one that died: it is started after a pause, and an alarm says why."""
    monkeypatch.setattr(supervisor, "BACKOFF_SECONDS", (0.05,))
    real = supervisor.subprocess.Popen

    def refuse(command, **options):
        raise OSError(11, "Resource temporarily unavailable")

    monkeypatch.setattr(supervisor.subprocess, "Popen", refuse)
    plan(tmp_path, a=LONG)
    turn(kept)
    assert states(tmp_path) == {"rollout.a": "restarting"}
    monkeypatch.setattr(supervisor.subprocess, "Popen", real)
    until_state(kept, tmp_path, "rollout.a", "running")
    alarms = json.loads((tmp_path / STATE).read_text())["alarms"]
    assert alarms == ["rollout.a could not be started (Resource temporarily unavailable); restarting it"]


def test_a_keeper_that_ends_starts_nothing_more(kept, tmp_path, monkeypatch):
    """A process whose pause is over just then stays down."""

    class Stopped:
        def __bool__(self):
            return True

    monkeypatch.setattr(supervisor, "BACKOFF_SECONDS", (0.0,))
    plan(tmp_path, a=f"open({str(tmp_path / 'starts')!r}, 'a').write('x'); raise SystemExit(1)")
    turn(kept)
    kept._supervisor.children["rollout.a"].process.wait(30.0)
    kept._supervisor._ended(kept._supervisor.children["rollout.a"], 1)
    kept.run(Stopped())
    assert kept._supervisor.children["rollout.a"].process is None
    assert (tmp_path / "starts").read_text() == "x"


def test_a_process_that_ends_by_itself_is_no_failure_of_kill(tmp_path, monkeypatch):
    """`down --kill` of one that ended between two looks of its keeper brings an answer like any other."""
    ended = subprocess.Popen([sys.executable, "-c", ""])
    ended.wait()
    write_json(tmp_path / PLAN, new_plan({}, again=()))
    found = [{"rollout.a": ended.pid}, {"rollout.a": ended.pid}, {}]
    monkeypatch.setattr(agent, "_pids", lambda folder, roles: found.pop(0) if len(found) > 1 else found[0])
    assert agent.down(tmp_path, ["rollout"], 0.05, kill=True) == {"ended": ["rollout.a"], "left": []}


@pytest.mark.parametrize(
    ("metrics", "changed", "over"),
    [("finished", False, True), ("finished", True, False), ("draining", False, False), (None, False, False)],
)
def test_a_run_that_came_to_its_end_is_over(tmp_path, metrics, changed, over):
    """So it is while its configuration is wanted; a drained one goes on, and with another one the learner objects."""
    config = preset("quick")
    os.makedirs(tmp_path / "run")
    (tmp_path / "run" / "config.toml").write_text(to_toml(config))
    wanted = to_toml(replace(config, seed=config.seed + changed))
    if metrics is not None:
        (tmp_path / "run" / "metrics.jsonl").write_text(json.dumps({"kind": "end", "state": metrics}) + "\n")
    assert agent.status(tmp_path, {"l": {"run": "run", "config": wanted}})["over"] == ["l"] * over


def test_a_plan_that_starts_nothing_leaves_what_is_new_alone(kept, tmp_path):
    """A worker that a finished run's fleet file names anew is not started, and runs with the next plan that starts."""
    plan(tmp_path, again=False, a=LONG)
    turn(kept, 2)
    assert states(tmp_path) == {"rollout.a": "finished"}
    plan(tmp_path, a=LONG)
    turn(kept)
    until_state(kept, tmp_path, "rollout.a", "running")


@pytest.mark.parametrize(("place", "awaited"), [(".", True), ("..", False)])
def test_the_processes_of_a_killed_keeper_are_awaited(tmp_path, place, awaited):
    """They still hold the run directory and the ports; a process that only has a number of theirs is none of them."""
    child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(2.0)"], cwd=tmp_path / place)
    write_json(tmp_path / STATE, {"processes": {"learner.learner": {"pid": child.pid}, "rollout.a": {"pid": 0}}})
    try:
        agent._await_orphans(tmp_path)
        assert (child.poll() is not None) == awaited
    finally:
        child.kill()
        child.wait()


def test_nobody_waits_for_ever_for_the_processes_of_a_killed_keeper(tmp_path, monkeypatch):
    """One that hangs is left to the new keeper's log; a torn state names nobody."""
    monkeypatch.setattr(agent, "ORPHAN_SECONDS", 0.3)
    child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600.0)"], cwd=tmp_path)
    try:
        write_json(tmp_path / STATE, {"processes": {"learner.learner": {"pid": child.pid}}})
        agent._await_orphans(tmp_path)
        (tmp_path / STATE).write_text("{")
        agent._await_orphans(tmp_path)
        assert child.poll() is None
    finally:
        child.kill()
        child.wait()


def test_a_full_disk_does_not_keep_processes_alive(kept, tmp_path, monkeypatch):
    """The plan gets shorter in place, and a state that nobody could write is not believed."""
    plan(tmp_path, one=LONG, two=LONG)
    monkeypatch.chdir(tmp_path)
    turn(kept)
    pids = [child.process.pid for child in kept._supervisor.children.values()]

    def full(path, value):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(agent, "write_json", full)
    monkeypatch.setattr(keeper, "write_json", full)
    answers = []
    with keeper.lock(tmp_path):
        thread = threading.Thread(target=lambda: answers.append(agent.down(tmp_path, ["rollout"], 30.0, kill=False)))
        thread.start()
        until(lambda: turn(kept) or not thread.is_alive(), "the answer")
    assert answers == [{"ended": ["rollout.one", "rollout.two"], "left": []}]
    assert set(states(tmp_path)) == {"rollout.one", "rollout.two"}
    assert not any(agent._is_ours(pid, tmp_path) for pid in pids)


def test_two_who_look_for_a_keeper_do_not_see_each_other(tmp_path):
    """Looking takes a lock that others may take, too; a keeper's excludes them."""
    with (tmp_path / keeper.LOCK).open("a") as other:
        fcntl.flock(other, fcntl.LOCK_SH)
        assert not keeper.is_kept(tmp_path)
    with keeper.lock(tmp_path):
        assert keeper.is_kept(tmp_path)


def test_a_plan_of_the_same_time_is_read(kept, tmp_path):
    """A file system's time may be coarse; a plan is always another file."""
    plan(tmp_path, one=LONG)
    turn(kept)
    before = (tmp_path / PLAN).stat()
    plan(tmp_path, one=LONG, two=LONG)
    os.utime(tmp_path / PLAN, ns=(before.st_atime_ns, before.st_mtime_ns))
    turn(kept)
    assert set(states(tmp_path)) == {"rollout.one", "rollout.two"}


def test_without_proc_a_number_is_all_there_is(tmp_path, monkeypatch):
    """Where no place of a process is known, it is taken for ours while it exists."""
    child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600.0)"])
    assert not agent._is_ours(child.pid, tmp_path)
    monkeypatch.setattr(agent, "PROCESSES", tmp_path / "none")
    assert agent._is_ours(child.pid, tmp_path)
    child.kill()
    child.wait()
    assert not agent._is_ours(child.pid, tmp_path)


def test_a_run_with_a_plugin_is_over_though_the_keeper_lacks_it(tmp_path):
    """Texts that are equal need not be understood."""
    os.makedirs(tmp_path / "run")
    text = to_toml(replace(preset("quick"), plugins=PluginNames(("mytask",))))
    (tmp_path / "run" / "config.toml").write_text(text)
    (tmp_path / "run" / "metrics.jsonl").write_text(json.dumps({"kind": "end", "state": "finished"}) + "\n")
    assert agent._is_over(tmp_path / "run", text)
