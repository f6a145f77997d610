"""`eia-sec up`, `down`, `status`, `logs` and `fleet collect`: here, over a fake SSH client, and over a real server."""

import json
import os
import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from eia_sec.common.transport.endpoint import free_endpoint
from tests.system.fleet import until
from tests.system.hosts import EIA_SEC, OnHosts, fake_ssh, gone, sshd, taken, until_more

TWO = """
[learner]
host = "one"
[hosts.one]
host = "local"
folder = "one"
[hosts.two]
host = "local"
folder = "two"
workers = 1
"""

LEARNING = ("learner.learner", "elite.coordinator")
SITE = '[router]\nhost = "one"\n[sites.barn]\nhost = "two"\nendpoint = "{endpoint}"' + TWO.replace(
    "workers = 1", 'workers = 2\nsite = "barn"'
)


@pytest.fixture
def folders(tmp_path: Path) -> Iterator[list[Path]]:
    """Folders of hosts whose processes are gone when the test is over."""
    found: list[Path] = [tmp_path / "one", tmp_path / "two"]
    yield found
    OnHosts.close(None, found)  # type: ignore[arg-type]  # it needs no fleet


@pytest.mark.nightly
def test_a_fleet_is_started_changed_and_ended(tmp_path: Path, folders: list[Path]) -> None:
    """What is missing is started, what runs is left alone, the dead are replaced, and nothing is unexplained."""
    fleet, file = OnHosts(tmp_path, TWO), str(tmp_path / "fleet.toml")
    history = tmp_path / "one" / "run" / "history" / "learner.jsonl"
    assert "down" in fleet.eia_sec("status", file, code=1)
    fleet.eia_sec("up", file)
    first = fleet.pids()
    assert set(first) == {"learner.learner", "elite.coordinator", "rollout.two-0"}
    until_more(history)
    fleet.edit("workers = 1", "workers = 2")
    fleet.eia_sec("up", file)
    second = fleet.pids()
    assert {name: second[name] for name in first} == first
    assert set(second) - set(first) == {"rollout.two-1"}
    os.kill(first["rollout.two-0"], signal.SIGKILL)
    until(lambda: fleet.pids().get("rollout.two-0", first["rollout.two-0"]) != first["rollout.two-0"], "a new worker")
    assert "coordinator leads" in fleet.eia_sec("logs", file, "--process", "elite.coordinator")
    fleet.edit("workers = 2", "workers = 1")
    fleet.eia_sec("up", file)
    until(lambda: "rollout.two-1" not in fleet.pids(), "the end of a worker")
    assert len(fleet.pids()) == 3
    ended = fleet.eia_sec("down", file).splitlines()
    assert ended == [
        "two rollout.two-0 has stopped.",
        "one elite.coordinator has stopped.",
        "one learner.learner has stopped.",
    ]
    assert fleet.pids() == {}
    found = fleet.collected()
    assert found.clean, found.to_dict()
    assert found.produced > 0


def test_a_site_is_drained_and_restarted_host_after_host(tmp_path: Path, folders: list[Path]) -> None:
    """Over two routers: a worker ends alone, all hosts are restarted in turn, and nothing acknowledged is lost."""
    fleet, file = OnHosts(tmp_path, SITE.format(endpoint=free_endpoint())), str(tmp_path / "fleet.toml")
    history = tmp_path / "one" / "run" / "history" / "learner.jsonl"
    fleet.eia_sec("up", file)
    first = fleet.pids()
    assert set(first) == {"router.main", "site.barn", *LEARNING, "rollout.two-0", "rollout.two-1"}
    until_more(history)
    assert "has no process 'rollout.9'" in fleet.eia_sec("down", file, "--process", "rollout.9", code=2)
    said = fleet.eia_sec("down", file, "--process", "rollout.two-1")
    assert said.splitlines() == ["two rollout.two-1 has stopped."]
    left = fleet.pids()
    assert left == {name: pid for name, pid in first.items() if name != "rollout.two-1"}
    until_more(history)
    fleet.eia_sec("up", file)
    until(lambda: len(fleet.pids()) == len(first), "the worker")
    again = fleet.eia_sec("restart", file, "--rolling").splitlines()
    assert again == ["one: 3 processes restarted.", "two: 3 processes restarted."]
    second = fleet.pids()
    assert set(second) == set(first)
    assert not set(second.values()) & set(first.values())
    until_more(history)
    fleet.eia_sec("down", file)
    found = fleet.collected()
    assert found.clean, found.to_dict()
    assert found.starts == 2
    assert found.steps["lost"] == 0, found.to_dict()


def test_a_restart_stops_at_a_host_that_does_not_come_back(tmp_path: Path, folders: list[Path]) -> None:
    """The sentence names process and host; the hosts after it run on as they did."""
    fleet, file = OnHosts(tmp_path, SITE.format(endpoint=free_endpoint())), str(tmp_path / "fleet.toml")
    fleet.eia_sec("up", file)
    until_more(tmp_path / "one" / "run" / "history" / "learner.jsonl")
    before = fleet.pids()
    fleet.edit('[learner]\nhost = "one"', '[learner]\nhost = "two"')
    assert "one holds run test, and [learner] names two" in fleet.eia_sec("restart", file, code=2)
    assert fleet.pids() == before
    fleet.edit('[learner]\nhost = "two"', '[learner]\nhost = "one"')
    (tmp_path / "one" / "run" / "config.toml").write_text("nonsense")
    said = fleet.eia_sec("restart", file, "--rolling", code=1)
    assert "learner.learner on one does not come back" in said
    assert f"processes of one may be stopped; `eia-sec up {file}` starts them. Not restarted: two." in said
    after = fleet.pids()
    assert {name: pid for name, pid in after.items() if ".two" in name or "site" in name} == {
        name: pid for name, pid in before.items() if ".two" in name or "site" in name
    }
    assert "learner.learner on one is given up, and others may wait for it" in fleet.eia_sec(
        "restart", file, "--rolling", code=2
    )


@pytest.mark.nightly
def test_a_run_moves_with_its_learner(tmp_path: Path, folders: list[Path]) -> None:
    """`up` refuses to begin anew on another host; after the move the learner continues, and nothing is unexplained."""
    fleet, file = OnHosts(tmp_path, TWO), str(tmp_path / "fleet.toml")
    fleet.eia_sec("up", file)
    until_more(tmp_path / "one" / "run" / "history" / "learner.jsonl")
    fleet.edit('[learner]\nhost = "one"', '[learner]\nhost = "two"')
    before = fleet.pids()
    assert "one holds run test, and [learner] names two" in fleet.eia_sec("up", file, code=2)
    assert fleet.pids() == before
    said = fleet.eia_sec("fleet", "move-learner", file)
    assert "run test has moved from one to two." in said
    moved = tmp_path / "two" / "run" / "history" / "learner.jsonl"
    until_more(moved)
    assert moved.read_text().count('["start"') == 2
    assert not (tmp_path / "one" / "run" / "config.toml").exists()
    fleet.eia_sec("down", file)
    found = fleet.collected()
    assert (found.clean, found.starts) == (True, 2), found.to_dict()


@pytest.mark.nightly
def test_a_killed_keeper_leaves_nothing_behind(tmp_path: Path, folders: list[Path]) -> None:
    """The processes of a killed keeper end, and the next `up` goes on from the learner's checkpoint."""
    fleet, file = OnHosts(tmp_path, TWO), str(tmp_path / "fleet.toml")
    history = tmp_path / "one" / "run" / "history" / "learner.jsonl"
    fleet.eia_sec("up", file)
    until_more(history)
    before = fleet.pids()
    os.kill(json.loads((tmp_path / "one" / "state.json").read_text())["pid"], signal.SIGKILL)
    until(lambda: gone(before["learner.learner"]) and gone(before["elite.coordinator"]), "the end of its processes")
    assert "down" in fleet.eia_sec("status", file, code=1)
    fleet.eia_sec("up", file)
    until_more(history)
    assert history.read_text().count('["start"') == 2
    fleet.eia_sec("down", file)
    found = fleet.collected()
    assert (found.clean, found.starts) == (True, 2), found.to_dict()


@pytest.mark.nightly
def test_who_does_not_end_is_named(tmp_path: Path, folders: list[Path]) -> None:
    """A frozen worker is named after the wait, and --kill ends it; a learner with another configuration says so."""
    fleet, file = OnHosts(tmp_path, TWO), str(tmp_path / "fleet.toml")
    fleet.eia_sec("up", file)
    until(taken(tmp_path / "one" / "run" / "history" / "learner.jsonl"), "chunks", 120.0)
    os.kill(fleet.pids()["rollout.two-0"], signal.SIGSTOP)
    said = fleet.eia_sec("down", file, "--wait", "8", code=1)
    assert "two rollout.two-0 is still running after 8 s" in said
    assert "two rollout.two-0 has stopped." in fleet.eia_sec("down", file, "--kill", "--wait", "1")
    fleet.edit('config = "wanted.toml"', 'config = "wanted.toml"\nset = ["seed = 5"]')
    fleet.eia_sec("up", file)
    until(lambda: fleet.status()["learner.learner"]["state"] == "given up", "the learner's refusal")
    assert "belongs to another configuration" in fleet.eia_sec("status", file, code=1)
    fleet.eia_sec("down", file)


def remote(tmp_path: Path, ssh: list[str], folder: str) -> str:
    """Return a fleet on one host that is reached by SSH."""
    host = f"host = {json.dumps('somebody@far' if not ssh else '127.0.0.1')}\nssh = {json.dumps(ssh)}\n"
    where = f"folder = {json.dumps(folder)}\ncommand = {json.dumps(EIA_SEC)}\nworkers = 1\n"
    return f'[learner]\nhost = "far"\n[hosts.far]\n{host}{where}'


def run_remotely(fleet: OnHosts, folder: Path) -> None:
    """Start a fleet, see it train, end it, and audit what was collected."""
    fleet.eia_sec("up", str(fleet.file))
    history = folder / "run" / "history" / "learner.jsonl"
    until(taken(history), "chunks", 120.0)
    assert set(fleet.pids()) == {"learner.learner", "elite.coordinator", "rollout.far-0"}
    fleet.eia_sec("down", str(fleet.file))
    found = fleet.collected()
    assert found.clean, found.to_dict()


def test_over_an_ssh_client(tmp_path: Path, folders: list[Path]) -> None:
    """A folder with blanks, quotes and dollars survives SSH's shell; an unreachable host is named, the rest runs."""
    programs, log = fake_ssh(tmp_path)
    strange = 'it\'s a $HOME; of "runs"'
    folders.append(tmp_path / "home" / strange)
    fleet = OnHosts(tmp_path, remote(tmp_path, [], strange))
    fleet.environment["PATH"] = f"{programs}:{os.environ['PATH']}"
    fleet.eia_sec("up", str(fleet.file))
    assert (tmp_path / "home" / strange / "run" / "history").is_dir()
    calls = log.read_text().splitlines()
    assert all("BatchMode=yes" in call and "ControlMaster=auto" in call for call in calls)
    fleet.write(fleet.file.read_text() + '[hosts.other]\nhost = "unreachable"\nworkers = 1\n')
    said = fleet.eia_sec("up", str(fleet.file), code=1)
    assert "other: no connection: ssh: no route to host" in said
    assert "learner.learner" in fleet.pids()
    fleet.edit(f"command = {json.dumps(EIA_SEC)}", 'command = "nowhere/eia-sec"')
    assert "nowhere/eia-sec was not found" in fleet.eia_sec("status", str(fleet.file), code=1)
    fleet.edit("nowhere/eia-sec", EIA_SEC)
    fleet.eia_sec("down", str(fleet.file), code=1)
    assert fleet.pids() == {}


def test_over_a_real_ssh_server(tmp_path: Path, folders: list[Path]) -> None:
    """The processes outlive the connection of a real SSH server on loopback, and are found and ended over another."""
    with sshd(tmp_path / "ssh") as options:
        if options is None:
            pytest.skip("a server on loopback needs sshd (openssh-server), ssh-keygen, and to be root")
        far = tmp_path / "far"
        folders.append(far)
        fleet = OnHosts(tmp_path, remote(tmp_path, options, str(far)))
        run_remotely(fleet, far)
        said = subprocess.run(["ssh", *options, "-o", "BatchMode=yes", "127.0.0.1", "true"], check=False).returncode
        assert said == 0
