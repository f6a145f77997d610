"""`start = "systemd"`: a keeper is a transient unit of the user's systemd, which gives it almost no environment."""

import os
import sys

import pytest

from eia_sec.common.errors import EiaSecError
from eia_sec.deploy.hosts import agent, keeper
from tests.system.fleet import until

SYSTEMD_RUN = """#!{python}
# As systemd-run does: the command runs apart from its caller, with the variables that were named and no others.
import os, subprocess, sys
with open({said!r}, "a") as file:
    file.write("\\n".join(sys.argv[1:]) + "\\n")
options, command = sys.argv[1 : sys.argv.index("--")], sys.argv[sys.argv.index("--") + 1 :]
given = dict(o.removeprefix("--setenv=").split("=", 1) for o in options if o.startswith("--setenv="))
log = next(o.rpartition("append:")[2] for o in options if o.startswith("--property=StandardError=append:"))
with open(log, "ab") as output:
    subprocess.Popen(command, env={{"HOME": "/", **given}}, cwd="/", stdin=subprocess.DEVNULL, stdout=output,
                     stderr=output, start_new_session=True)
"""


@pytest.fixture
def systemd_run(tmp_path, monkeypatch):
    """A fake `systemd-run`, and the file in which it records its arguments."""
    tools, said = tmp_path / "tools", tmp_path / "said"
    tools.mkdir()
    program = tools / "systemd-run"
    program.write_text(SYSTEMD_RUN.format(python=sys.executable, said=str(said)))
    program.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tools}:{os.environ['PATH']}")
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(p for p in sys.path if p))
    yield program, said
    for folder in (tmp_path / "host", tmp_path / "other"):
        if folder.exists():
            agent.down(folder, ["rollout"], 10.0, kill=True)
            until(lambda folder=folder: not keeper.is_kept(folder), "the keeper's end")


def test_a_keeper_is_a_unit_of_its_own(systemd_run, tmp_path, monkeypatch):
    """It comes up with the plan, under a name that the folder decides, and writes into the folder's log.

    One with an empty plan ends at once, and nobody waits for it; nor does the torn state of an earlier one matter.
    """
    folder = tmp_path / "host"
    process = {"arguments": ["farm", "--help"], "threads": 1}
    agent.up(folder, {"rollout.here-0": process}, {}, "systemd")
    words = systemd_run[1].read_text().splitlines()
    assert words[:3] == ["--user", "--quiet", "--collect"]
    assert words[3].startswith("--unit=eia-sec-")
    # Only the keeper gets SIGTERM; five roles have half a minute each.
    assert {"--property=KillMode=process", "--property=TimeoutStopSec=180"} <= set(words)
    assert words[words.index("--") + 1] == sys.executable
    log = folder / agent.LOG
    until(lambda: log.exists() and "rollout.here-0" in log.read_text(), "the keeper's log")
    agent.down(folder, ["rollout"], 30.0, kill=True)
    until(lambda: not keeper.is_kept(folder), "the keeper's end")
    (folder / keeper.STATE).write_text("")
    monkeypatch.setattr(agent, "START_SECONDS", 3600.0)
    agent.up(folder, {}, {}, "systemd")
    agent.up(tmp_path / "other", {}, {}, "systemd")
    units = [word for word in systemd_run[1].read_text().splitlines() if word.startswith("--unit=")]
    assert len(units) >= 3
    assert len(set(units[:2])) == 1
    assert units[-1] != units[0]


def test_why_a_unit_did_not_start_is_said(systemd_run, tmp_path):
    """Without a session's bus `systemd-run --user` fails, and its error is reported."""
    systemd_run[0].write_text("#!/bin/sh\necho 'Failed to connect to bus' >&2\nexit 1\n")
    with pytest.raises(EiaSecError, match="did not start the keeper: Failed to connect to bus"):
        agent.up(tmp_path / "host", {}, {}, "systemd")


def test_a_host_without_systemd_says_so(tmp_path, monkeypatch):
    """The sentence names what to write instead."""
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(EiaSecError, match='set start = "detached"'):
        agent.up(tmp_path / "host", {}, {}, "systemd")
