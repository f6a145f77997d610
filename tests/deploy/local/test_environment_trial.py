"""The trial of an environment in a process of its own: what it may do there, and what is left of it."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import psutil
import pytest

from eia_sec.common.config import EnvConfig, IppoConfig, RunConfig
from eia_sec.common.errors import EnvironmentFaultError
from eia_sec.deploy.local.environment_trial import tried
from tests.system.fleet import until

TOYS = Path(__file__).resolve().parents[2] / "rollout" / "envs"
BEGIN = """
from eia_sec.common.config import EnvConfig, IppoConfig, RunConfig
from eia_sec.deploy.local.environment_trial import tried
tried(RunConfig(env=EnvConfig("hanging:Hanging"), algorithm=IppoConfig()))
"""
HANGING = "import time\nprint('imported', flush=True)\ntime.sleep(600)\n"


@pytest.fixture(autouse=True)
def toys(monkeypatch):
    """Let the other process find the toys, as PYTHONPATH of a user does."""
    before = os.environ.get("PYTHONPATH")  # an empty part would be the working directory
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(TOYS), before] if before else [str(TOYS)]))


def attempt(name, arguments="{}"):
    return tried(RunConfig(env=EnvConfig(name, arguments), algorithm=IppoConfig()))


def test_a_trial_that_has_reported_counts_whatever_its_process_does_then():
    """A thread that never ends and a library that ends the process with its own code hold nobody up."""
    assert attempt("toy_faults:Lingering").team == attempt("toy_env:Relay").team


def test_who_ends_the_process_is_named():
    """By the exit code, also where it is that of success."""
    with pytest.raises(EnvironmentFaultError, match=r"toy_faults:Exiting ended its process .* with exit code 0; what"):
        attempt("toy_faults:Exiting", '{"after": 2, "code": 0}')


def test_what_the_trial_says_is_said_once(capfd):
    """This process ends with its code, and adds nothing."""
    with pytest.raises(SystemExit) as ended:
        attempt("toy_faults:Raising")
    assert ended.value.code == 2
    assert capfd.readouterr().err.count("eia-sec: ") == 1


def test_modules_of_the_working_directory_are_not_found(tmp_path, monkeypatch, capfd):
    """The other processes of a run do not find them, so the trial must not: neither the environment nor a library."""
    (tmp_path / "only_here.py").write_text("from toy_env import Relay\n")
    (tmp_path / "pettingzoo.py").write_text("raise SystemExit('the wrong one')\n")
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit):
        attempt("only_here:Relay")
    said = capfd.readouterr().err
    assert "there is no environment only_here:Relay" in said
    assert "the wrong one" not in said


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGHUP, signal.SIGTERM])
def test_a_trial_ends_with_the_command(number, tmp_path, monkeypatch):
    """However the command ends, a hanging trial ends too, and its folder is gone."""
    (tmp_path / "hanging.py").write_text(HANGING)
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(tmp_path), os.environ["PYTHONPATH"]]))
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    command = subprocess.Popen([sys.executable, "-c", BEGIN], stdout=subprocess.PIPE, text=True)
    assert command.stdout is not None
    assert command.stdout.readline() == "imported\n"
    children = psutil.Process(command.pid).children(recursive=True)
    command.send_signal(number)
    command.wait(30)
    until(lambda: not any(child.is_running() for child in children), "the end of the trial", 30.0)
    if number != signal.SIGTERM:  # which this program, unlike the command, does not handle
        until(lambda: not list(tmp_path.glob("eia-sec-trial-*")), "the end of its folder", 30.0)
