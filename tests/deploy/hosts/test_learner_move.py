"""A run moves to another host whole, is never begun anew where one exists, and never held twice."""

import io
import shutil
import subprocess
from dataclasses import replace

import pytest

from eia_sec.common.errors import HostError, RunDirError, UsageError
from eia_sec.deploy.cli import dispatch
from eia_sec.deploy.hosts import agent, archive, learner_move, operations, run_holders
from eia_sec.deploy.hosts.fleet_file import read
from eia_sec.deploy.hosts.keeper import PLAN, write_json
from eia_sec.deploy.local.run_directory import RunDirectory

LEARNERS = {
    "config.toml": b"seed = 1\n",
    "metrics.jsonl": b"{}\n",
    "policy.safetensors": bytes(100),
    "checkpoints/checkpoint-00000002/manifest.json": b"{}",
    "checkpoints/checkpoint-00000002/state.safetensors": bytes(range(256)) * 9000,
    "history/learner.jsonl": b'["start"]\n',
}
WORKERS = {"history/rollout-one-0.jsonl": b'["start"]\n'}
FLEET = """run = "test"
[network]
endpoint = "tcp/127.0.0.1:7447"
[learner]
host = "two"
[hosts.one]
host = "local"
folder = "one"
workers = 1
[hosts.two]
host = "local"
folder = "two"
"""


def write(folder, files):
    """Write files into a folder."""
    for name, data in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(data)


def files(folder):
    """Return the files below a folder, locks left out."""
    paths = [path for path in folder.rglob("*") if path.is_file() and path.suffix != ".lock"]
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in paths}


def sent(folder):
    """Return what `release` sends."""
    out = io.BytesIO()
    learner_move.release(folder, out)
    return out.getvalue()


@pytest.fixture
def fleet(tmp_path):
    """A fleet of two local hosts; the file names the second for the learner, and the first holds the run."""
    (tmp_path / "fleet.toml").write_text(FLEET)
    write(tmp_path / "one" / "run", LEARNERS | WORKERS)
    return read(tmp_path / "fleet.toml")


@pytest.fixture
def population(tmp_path):
    """The same hosts with a member of a population each."""
    members = (
        '[training]\nset = ["population.members = 2"]\n[router]\nhost = "one"\n[population.member-0]\nhost = "one"\n'
    )
    text = FLEET.replace("[learner]", f"{members}[population.member-1]")
    (tmp_path / "fleet.toml").write_text(text)
    return read(tmp_path / "fleet.toml")


def test_up_refuses_to_begin_a_run_anew(fleet, tmp_path):
    """With the learner's host changed, one sentence names the host that holds the run, and nothing is started."""
    with pytest.raises(UsageError, match=r"one holds run test, and \[learner\] names two, where it would begin anew"):
        operations.up(fleet)
    assert not (tmp_path / "two").exists()
    assert not (tmp_path / "one" / PLAN).exists()


def test_up_refuses_when_the_former_host_has_left_the_file(fleet, tmp_path):
    """A worker's history is proof of a run: without the run itself, nothing is begun."""
    shutil.rmtree(tmp_path / "one" / "run" / "checkpoints")
    (tmp_path / "one" / "run" / "config.toml").unlink()
    with pytest.raises(UsageError, match="one has histories of workers of run test, and no host of"):
        operations.up(fleet)


def test_up_refuses_an_old_copy(fleet, tmp_path):
    """Where two hosts hold the run, one of the two is older, and the user says which."""
    write(tmp_path / "two" / "run", LEARNERS)
    with pytest.raises(UsageError, match=r"one \(one\) and two \(two\) both hold run test"):
        operations.up(fleet)


@pytest.mark.parametrize(
    ("one", "two", "said"),
    [
        ("run", "nothing", "one holds run"),
        ("leaving", "nothing", "one holds run"),
        ("leaving", "histories", "one holds run"),
        ("leaving", "leaving", "both hold"),
        ("run", "run", "both hold"),
        ("nothing", "run", ""),
        ("leaving", "run", ""),
        ("histories", "run", ""),
        ("nothing", "nothing", ""),
        ("histories", "nothing", "one has histories"),
        (None, "nothing", "one, which may hold it, was not reached"),
        (None, "run", ""),
        ("run", None, "one holds run"),
        ("nothing", None, ""),
    ],
)
def test_the_learner_starts_where_the_run_is_or_where_there_never_was_one(fleet, one, two, said):
    """For every pair of hosts, reached or not, the fleet starts or is refused with the reason."""
    held = {"one": one, "two": two}
    states = {host: {"holds": what} for host, what in held.items() if what is not None}
    failed = {host: "no connection" for host, what in held.items() if what is None}
    if said:
        with pytest.raises((UsageError, HostError), match=said):
            run_holders.require_one_run(fleet, states, failed)
    else:
        run_holders.require_one_run(fleet, states, failed)


@pytest.mark.parametrize(
    ("one", "two", "said"),
    [
        ("nothing", "nothing", ""),
        ("run", "nothing", r"one holds member-1 of run test, and \[population.member-1\] names two"),
        ("run", "run", "one and two both hold run/members/member-1"),
        ("nothing", "run", ""),
        ("histories", "nothing", "one has histories of workers of member-1"),
        (None, "nothing", "one, which may hold it, was not reached"),
        (None, "run", ""),
        ("nothing", None, ""),
    ],
)
def test_each_member_of_a_population_starts_where_its_run_is(population, one, two, said):
    """Or where there never was one; the other member, which is where it belongs, changes nothing."""
    held = {"one": one, "two": two}
    states = {
        host: {"members": {"member-0": "run" if host == "one" else "nothing", "member-1": what}}
        for host, what in held.items()
        if what is not None
    }
    failed = {host: "no connection" for host, what in held.items() if what is None}
    if one is None:
        states["two"]["members"]["member-0"] = "run"
        population = replace(population, runs=population.runs[1:])
    if said:
        with pytest.raises((UsageError, HostError), match=said):
            run_holders.require_one_run(population, states, failed)
    else:
        run_holders.require_one_run(population, states, failed)


def test_a_host_that_knows_no_populations_starts_no_member(population):
    """It may hold a member's run and cannot say so; runs alone need no newer version."""
    states = {"one": {"members": {"member-0": "run", "member-1": "nothing"}}, "two": {"holds": "nothing"}}
    with pytest.raises(HostError, match="two has an older version"):
        run_holders.require_one_run(population, states, {})


def test_a_host_tells_which_members_it_holds(tmp_path):
    """Those with a run, and those of which it has workers' histories alone."""
    inside = tmp_path / "run" / "members"
    write(inside, {"member-0/config.toml": b"", "member-1/history/rollout-a-0.jsonl": b"1"})
    write(inside, {"member-2/history/rollout-a-1.jsonl": b""})
    assert agent.status(tmp_path)["members"] == {"member-0": "run", "member-1": "histories"}


def test_a_members_run_is_moved_by_hand(population):
    """`fleet move-learner` says so."""
    with pytest.raises(UsageError, match="is for a run alone; to move a member, stop the fleet and move its folder"):
        operations.move_learner(population, 1.0)


def test_a_run_moves_whole(fleet, tmp_path):
    """Every file of the learner arrives as it was, workers' histories stay, and the copy is renamed."""
    write(tmp_path / "two" / "run", {"history/rollout-two-0.jsonl": b"2"})
    said = operations.move_learner(fleet, 1.0)
    assert said[0] == "run test has moved from one to two."
    assert files(tmp_path / "two" / "run") == LEARNERS | {"history/rollout-two-0.jsonl": b"2"}
    assert files(tmp_path / "one" / "run") == WORKERS
    (kept,) = (tmp_path / "one").glob("moved-*")
    assert said[1] == f"one keeps its copy in {kept.name}; nothing needs it any more."
    assert files(kept) == LEARNERS
    assert operations.move_learner(fleet, 1.0) == []


def test_a_run_moves_back(fleet, tmp_path):
    """What was trained meanwhile is there, and not the older copy that stayed behind."""
    operations.move_learner(fleet, 1.0)
    write(tmp_path / "two" / "run", newer := {"metrics.jsonl": b"{}\n{}\n"})
    (tmp_path / "fleet.toml").write_text(FLEET.replace('host = "two"', 'host = "one"'))
    operations.move_learner(read(tmp_path / "fleet.toml"), 1.0)
    assert files(tmp_path / "one" / "run") == LEARNERS | WORKERS | newer
    assert files(tmp_path / "two" / "run") == {}


@pytest.mark.parametrize("after", range(len(LEARNERS)))
def test_an_interrupted_departure_is_completed(tmp_path, monkeypatch, after):
    """Killed between any two files, the host never looks as if it held a run, and the next attempt sends all of it."""
    write(tmp_path / "run", LEARNERS | WORKERS)
    replace, left = learner_move.os.replace, [after]

    def killed(source, target):
        if not left[0]:
            raise KeyboardInterrupt
        left[0] -= 1
        replace(source, target)

    monkeypatch.setattr(learner_move.os, "replace", killed)
    with pytest.raises(KeyboardInterrupt):
        sent(tmp_path)
    assert learner_move.holding(tmp_path) == ("leaving" if after else "run")
    monkeypatch.setattr(learner_move.os, "replace", replace)
    (tmp_path / "far").mkdir()
    archive.unpack(io.BytesIO(sent(tmp_path)), tmp_path / "far", learner_move.is_learners)
    assert files(tmp_path / "far") == LEARNERS


@pytest.mark.parametrize("after", range(len(LEARNERS)))
def test_an_interrupted_arrival_is_completed(tmp_path, monkeypatch, after):
    """Killed between any two files, the new host holds no run yet, and the next attempt puts all of it in place."""
    write(tmp_path / "one" / "run", LEARNERS)
    packed, target = sent(tmp_path / "one"), tmp_path / "two"
    replace, left = learner_move.os.replace, [after]

    def killed(source, target, **options):
        if not options and not left[0]:
            raise KeyboardInterrupt
        left[0] -= not options
        replace(source, target, **options)

    monkeypatch.setattr(learner_move.os, "replace", killed)
    with pytest.raises(KeyboardInterrupt):
        learner_move.take_in(target, io.BytesIO(packed))
    assert learner_move.holding(target) == "nothing"
    monkeypatch.setattr(learner_move.os, "replace", replace)
    learner_move.take_in(target, io.BytesIO(packed))
    assert files(target / "run") == LEARNERS


def test_what_cannot_be_moved_is_refused(tmp_path):
    """A run that is in use stays, a run that is there is not overwritten, and half an archive arrives nowhere."""
    write(tmp_path / "one" / "run", LEARNERS)
    learner = RunDirectory(tmp_path / "one" / "run")
    learner.lock("learner.lock", directory=True)
    with pytest.raises(RunDirError, match="in use"):
        sent(tmp_path / "one")
    assert files(tmp_path / "one" / "run") == LEARNERS
    learner.unlock()
    packed = sent(tmp_path / "one")
    write(tmp_path / "two" / "run", LEARNERS)
    with pytest.raises(HostError, match="already holds a run"):
        learner_move.take_in(tmp_path / "two", io.BytesIO(packed))
    with pytest.raises(HostError, match="incomplete or malformed"):
        learner_move.take_in(tmp_path / "three", io.BytesIO(packed[:-100]))
    assert learner_move.holding(tmp_path / "three") == "nothing"
    with pytest.raises(HostError, match="holds no run that could leave"):
        sent(tmp_path / "three")


def test_collect_names_a_host_that_still_holds_the_learners_files(fleet, tmp_path, capsys):
    """A policy that is not collected is an error with its remedy, not a file left out."""
    code = dispatch(["fleet", "collect", str(fleet.path), "--out", str(tmp_path / "out")])
    said = capsys.readouterr().out
    assert code == 1
    assert "one holds learner's files of run test, and [learner] names two: they were not collected" in said


def test_up_on_a_finished_run_starts_nothing(tmp_path):
    """Neither what has finished nor a worker that is new, whatever ran before; status calls them finished."""
    never = {"arguments": ["no such command"], "threads": 1}
    named = {"learner.learner": never, "rollout.a": never}
    try:
        state = agent.up(tmp_path, named, {}, "detached", again=())
        assert {name: found["state"] for name, found in state["processes"].items()} == dict.fromkeys(named, "finished")
        assert not list((tmp_path / "logs").glob("*"))
    finally:
        write_json(tmp_path / PLAN, agent.keeper.new_plan({}, again=()))
        subprocess.run(["sleep", "0.6"], check=True)
