"""Where a run cannot have several learners, and how torchrun's variables are read."""

import os
import subprocess
import sys

import pytest

from eia_sec.common.config.files import with_values
from eia_sec.common.config.presets import preset
from eia_sec.common.errors import ConfigError, UsageError
from eia_sec.deploy.commands.training import learner, train
from eia_sec.deploy.local.learners import (
    INTERFACE,
    LEADER,
    STORE,
    Place,
    chosen_place,
    given_place,
    meet_on_loopback,
    require_learners,
)

DEFAULT = preset("instant")
VARIABLES = {"RANK": "1", "WORLD_SIZE": "2", "MASTER_ADDR": "192.0.2.1", "MASTER_PORT": "29500"}


@pytest.fixture(autouse=True)
def _no_variables(monkeypatch):
    for name in (*VARIABLES, INTERFACE):
        monkeypatch.delenv(name, raising=False)


@pytest.mark.parametrize(
    ("config", "learners", "lockstep", "said"),
    [
        (DEFAULT, 2, True, "a lockstep run has one learner"),
        (preset("eia-sec"), 2, False, "eia-sec learns from a replay buffer"),
        (with_values(DEFAULT, {"learner.device": "cuda"}), 2, False, "not on cuda"),
        (with_values(DEFAULT, {"algorithm.memory": "gru"}), 2, False, "networks without memory only"),
        (with_values(DEFAULT, {"algorithm.minibatch_steps": 3}), 2, False, "must be at least"),
        (DEFAULT, 0, False, "learners"),
        (DEFAULT, 65, False, "learners"),
    ],
)
def test_refused(config, learners, lockstep, said):
    """What several learners cannot do is refused in one sentence."""
    with pytest.raises(ConfigError, match=said):
        require_learners(config, learners, lockstep=lockstep)


@pytest.mark.parametrize(("config", "learners", "lockstep"), [(preset("eia-sec"), 1, True), (DEFAULT, 8, False)])
def test_accepted(config, learners, lockstep):
    """One learner may do everything, and several may learn on policy."""
    assert require_learners(config, learners, lockstep=lockstep) is None


def test_a_leader_of_this_machine():
    """Without torchrun's variables a process leads as many as it was told."""
    assert given_place() is None
    assert chosen_place(3, insecure=False) == Place(0, 3)


def test_a_learner_of_torchrun(monkeypatch):
    """With them it has the place that they say."""
    started(monkeypatch)
    assert given_place() == Place(1, 2, by_torchrun=True)
    monkeypatch.setenv("RANK", "0")
    place = Place(0, 2, by_torchrun=True)
    with pytest.raises(UsageError, match="without authentication or encryption"):
        chosen_place(1, insecure=False)
    assert chosen_place(1, insecure=True) == place
    monkeypatch.setenv("MASTER_ADDR", "localhost")
    assert chosen_place(1, insecure=False) == place
    with pytest.raises(UsageError, match="leave --learners out"):
        chosen_place(2, insecure=False)


def test_a_learner_of_torchrun_is_refused_what_the_leader_is(monkeypatch):
    """A mistake in the command is said by each learner, before it waits for others."""
    started(monkeypatch)
    monkeypatch.setattr(learner, "following", lambda _: pytest.fail("it follows"))
    with pytest.raises(UsageError, match="nonsense"):
        learner.command(["--nonsense", "7"])
    with pytest.raises(UsageError, match="with --insecure"):
        learner.command([])
    with pytest.raises(ConfigError, match="learns from a replay buffer"):
        learner.command(["--insecure", "--preset", "eia-sec"])


def test_torchrun_starts_learners_only(monkeypatch, tmp_path):
    """Several `eia-sec train` would be several runs in one folder."""
    started(monkeypatch)
    with pytest.raises(UsageError, match=r"not eia-sec train; give train --learners N\.$"):
        train.command(["--run-dir", str(tmp_path / "run")])
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("place", "host", "near"),
    [
        (Place(0, 2), "", True),
        (Place(1, 2, by_torchrun=True), "127.0.0.1", True),
        (Place(0, 2, by_torchrun=True), "localhost", True),
        (Place(0, 2, by_torchrun=True), "192.0.2.1", False),
    ],
)
def test_learners_that_meet_on_this_machine_listen_on_loopback(monkeypatch, place, host, near):
    """Gloo would listen where the host's name points, which may be a network."""
    monkeypatch.setenv("MASTER_ADDR", host)
    monkeypatch.setenv(INTERFACE, "eth0")
    meet_on_loopback(place)
    assert (os.environ[INTERFACE] in ("lo", "lo0")) == near


@pytest.mark.slow
def test_a_follower_whose_leader_has_ended_does_not_wait(tmp_path):
    """It ends at once with the code of a broken group."""
    places = {"RANK": "1", "WORLD_SIZE": "2", STORE: str(tmp_path / "store"), LEADER: str(2**30)}
    command = [sys.executable, "-m", "eia_sec.deploy.cli", "learner"]
    done = subprocess.run(
        command, env={**os.environ, **places}, capture_output=True, text=True, timeout=60, check=False
    )
    assert (done.returncode, "the leader has ended." in done.stderr) == (3, True)


def started(monkeypatch):
    """Let this process be a learner of torchrun."""
    for name, value in VARIABLES.items():
        monkeypatch.setenv(name, value)


@pytest.mark.parametrize(("rank", "size"), [("2", "2"), ("-1", "2"), ("0", "1000"), ("x", "2")])
def test_impossible_variables(monkeypatch, rank, size):
    """A rank outside of its group is refused."""
    for name, value in {**VARIABLES, "RANK": rank, "WORLD_SIZE": size}.items():
        monkeypatch.setenv(name, value)
    with pytest.raises(ConfigError, match="name no learner of a group"):
        given_place()
