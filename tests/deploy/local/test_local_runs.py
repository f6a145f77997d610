"""How monitors find the runs of this machine."""

import json
import socket
import subprocess
import sys
from contextlib import ExitStack
from pathlib import Path

import pytest

from eia_sec.common.errors import EndpointError, UsageError
from eia_sec.common.transport.endpoint import DEFAULT, free_endpoint
from eia_sec.deploy.local.local_runs import LocalRun, chosen, folder, listed, local_runs, reached
from eia_sec.deploy.local.run_directory import TRAIN_LOCK, RunDirectory

HOLD = """
import sys, time
from eia_sec.deploy.local.local_runs import LocalRun, listed
with listed(LocalRun(sys.argv[1], "tcp/127.0.0.1:4000", sys.argv[2], "farm", tls=False)):
    print("listed", flush=True)
    time.sleep(60)
"""


@pytest.fixture(autouse=True)
def own_state(tmp_path, monkeypatch):
    """An empty state directory for each test."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))


def a_run(name="farm", port=4000, run_dir="", environment="farm"):
    return LocalRun(name, f"tcp/127.0.0.1:{port}", run_dir, environment, tls=False)


def choose(run_dir, run, connect, patience=0.0):
    return chosen(run_dir, run, connect, patience, lambda: True)


def test_a_run_is_found_while_it_lasts():
    """Runs are sorted by name, and nothing is left of those that end."""
    assert local_runs() == []
    with listed(a_run("b")), listed(a_run("a", 4002)):
        assert local_runs() == [a_run("a", 4002), a_run("b")]
        assert local_runs() == [a_run("a", 4002), a_run("b")]
        assert folder().stat().st_mode & 0o077 == 0
    assert list(folder().iterdir()) == []


def test_what_a_killed_learner_left_is_removed(tmp_path):
    """Its lock ended with it, whoever has its number now; a living one of another process is found."""
    holder = subprocess.Popen([sys.executable, "-c", HOLD, "held", str(tmp_path)], stdout=subprocess.PIPE, text=True)
    try:
        assert holder.stdout is not None
        assert holder.stdout.readline() == "listed\n"
        assert local_runs() == [a_run("held", run_dir=str(tmp_path))]
    finally:
        holder.kill()
        holder.wait()
    assert len(list(folder().iterdir())) == 1
    assert local_runs() == []
    assert list(folder().iterdir()) == []


@pytest.mark.parametrize(
    "text",
    [
        "",
        "{",
        "[]",
        '{"run": "a"}',
        json.dumps({**vars(a_run()), "run": "a b"}),
        json.dumps({**vars(a_run()), "run_dir": 3}),
    ],
)
def test_files_that_are_no_runs_are_passed_over(text, monkeypatch):
    """Whatever stands in a file whose lock is held, the others are found."""
    with listed(a_run("whole")), listed(a_run("odd", 4002)):
        next(folder().glob("odd*")).write_text(text)
        assert local_runs() == [a_run("whole")]


def test_a_run_is_chosen_by_what_is_said_of_it(tmp_path):
    """Directory, name or endpoint name one; nothing at all names the only one."""
    first, second = a_run("a", 4000, str(tmp_path / "a")), a_run("b", 4002, str(tmp_path / "b"))
    with listed(first):
        assert choose(None, None, None) == first
        with listed(second):
            assert choose(tmp_path / "x" / ".." / "b", None, None) == second
            assert choose(None, "a", None) == first
            assert choose(None, None, second.endpoint) == second
            with pytest.raises(UsageError) as several:
                choose(None, None, None)
    assert str(several.value) == (
        "several runs are training; name one of them; on this machine there are:\n"
        f"  --run a --connect tcp/127.0.0.1:4000   # {tmp_path}/a\n"
        f"  --run b --connect tcp/127.0.0.1:4002   # {tmp_path}/b"
    )


def test_what_is_not_listed_is_taken_as_it_is_said():
    """A run of another machine, or in a container, has a name and an endpoint."""
    with listed(a_run("a")):
        assert choose(None, "other", "tcp/far:7447") == LocalRun("other", "tcp/far:7447", "", "", tls=False)
        assert choose(None, None, "tcp/far:7447").run == "farm"
    assert choose(None, None, None) == LocalRun("farm", DEFAULT, "", "", tls=False)


def test_mistakes_name_what_is_there(tmp_path):
    """A directory where nothing trains, both ways at once, and an endpoint where nobody listens."""
    with pytest.raises(UsageError, match=r"no run is training in .*/x; none is training on this machine\.$"):
        choose(tmp_path / "x", None, None)
    with pytest.raises(UsageError, match="give a run directory, or --run and --connect, not both"):
        choose(tmp_path, "a", None)
    silent = str(free_endpoint())
    with listed(a_run("a")), pytest.raises(EndpointError) as nobody:
        reached(LocalRun("b", silent, "", "", tls=False), None, 0.0, lambda: True)
    assert str(nobody.value) == (
        f"nobody answers at {silent}; on this machine there are:\n  --run a --connect tcp/127.0.0.1:4000"
    )


def test_a_run_without_a_place_for_its_file_goes_on(tmp_path, monkeypatch, capsys):
    """No home directory, or one that cannot be written to: a line in the log, and no file."""
    (tmp_path / "state").write_text("a file")
    with listed(a_run()):
        assert local_runs() == []
    assert "monitors of this machine find this run by --run and --connect alone" in capsys.readouterr().err
    monkeypatch.delenv("XDG_STATE_HOME")
    monkeypatch.setattr(Path, "home", _homeless)
    with listed(a_run()):
        assert local_runs() == []


def _homeless():
    raise RuntimeError("Could not determine home directory.")


def test_a_run_that_has_begun_is_waited_for(tmp_path):
    """The supervisor holds its lock before the learner is there, whose name its banner has given."""
    directory = RunDirectory(tmp_path)
    directory.lock(TRAIN_LOCK)
    looks = []
    with ExitStack() as begun:

        def waiting():
            looks.append(len(looks))
            if len(looks) == 2:
                begun.enter_context(listed(a_run("a", run_dir=str(tmp_path))))
            return True

        assert chosen(tmp_path, None, None, 60.0, waiting) == a_run("a", run_dir=str(tmp_path))
    assert len(looks) == 2
    directory.unlock()
    with pytest.raises(UsageError, match="no run is training in"):
        chosen(tmp_path, None, None, 60.0, waiting)


def test_files_of_other_machines_are_left_alone(monkeypatch):
    """A home directory may be on the network: a lock of another machine is not seen here."""
    with listed(a_run()):
        kept = list(folder().iterdir())
        monkeypatch.setattr(socket, "gethostname", lambda: "elsewhere")
        assert local_runs() == []
        assert list(folder().iterdir()) == kept


def test_a_learner_and_its_successor_are_one_run():
    """At a router both live for a while."""
    with listed(a_run()), listed(a_run()):
        assert choose(None, None, None) == a_run()
