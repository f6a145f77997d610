"""How monitors find the runs of this machine."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from eia_sec.common.errors import EndpointError, UsageError
from eia_sec.common.transport.endpoint import DEFAULT, free_endpoint
from eia_sec.deploy.commands.monitoring import watch
from eia_sec.deploy.local.local_runs import LocalRun, chosen, folder, listed, local_runs, reached

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
        assert chosen(None, None, None) == first
        with listed(second):
            assert chosen(tmp_path / "x" / ".." / "b", None, None) == second
            assert chosen(None, "a", None) == first
            assert chosen(None, None, second.endpoint) == second
            with pytest.raises(UsageError) as several:
                chosen(None, None, None)
    assert str(several.value) == (
        "several runs are training; name one of them; on this machine there are:\n"
        f"  --run a --connect tcp/127.0.0.1:4000   # {tmp_path}/a\n"
        f"  --run b --connect tcp/127.0.0.1:4002   # {tmp_path}/b."
    )


def test_what_is_not_listed_is_taken_as_it_is_said():
    """A run of another machine, or in a container, has a name and an endpoint."""
    with listed(a_run("a")):
        assert chosen(None, "other", "tcp/far:7447") == LocalRun("other", "tcp/far:7447", "", "", tls=False)
        assert chosen(None, None, "tcp/far:7447").run == "farm"
    assert chosen(None, None, None) == LocalRun("farm", DEFAULT, "", "", tls=False)


def test_mistakes_name_what_is_there(tmp_path):
    """A directory where nothing trains, both ways at once, and an endpoint where nobody listens."""
    with pytest.raises(UsageError, match=r"no run is training in .*/x; none is training on this machine\.$"):
        chosen(tmp_path / "x", None, None)
    with pytest.raises(UsageError, match="give a run directory, or --run and --connect, not both"):
        chosen(tmp_path, "a", None)
    silent = str(free_endpoint())
    with listed(a_run("a")), pytest.raises(EndpointError) as nobody:
        reached(LocalRun("b", silent, "", "", tls=False), None, 0.0, lambda: True)
    assert str(nobody.value) == (
        f"nobody answers at {silent}; on this machine there are:\n  --run a --connect tcp/127.0.0.1:4000."
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


def test_the_page_draws_farms_alone():
    """Of another environment the terminal's view is named, before anything is served."""
    with listed(a_run("a", environment="mytask.env:Cover")), pytest.raises(UsageError, match="eia-sec monitor --run a"):
        watch.command([])
