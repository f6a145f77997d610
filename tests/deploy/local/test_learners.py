"""Where a run cannot have several learners, and how torchrun's variables are read."""

import pytest

from eia_sec.common.config.files import with_values
from eia_sec.common.config.presets import preset
from eia_sec.common.errors import ConfigError, UsageError
from eia_sec.deploy.local.learners import Place, given_place, leaders_place, require_learners

DEFAULT = preset("default")
VARIABLES = {"RANK": "1", "WORLD_SIZE": "2", "MASTER_ADDR": "192.0.2.1", "MASTER_PORT": "29500"}


@pytest.fixture(autouse=True)
def _no_variables(monkeypatch):
    for name in VARIABLES:
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
    assert leaders_place(3, insecure=False) == Place(0, 3)


def test_a_learner_of_torchrun(monkeypatch):
    """With them it has the place that they say."""
    for name, value in VARIABLES.items():
        monkeypatch.setenv(name, value)
    assert given_place() == Place(1, 2, by_torchrun=True)
    monkeypatch.setenv("RANK", "0")
    place = Place(0, 2, by_torchrun=True)
    with pytest.raises(UsageError, match="without authentication or encryption"):
        leaders_place(1, insecure=False)
    assert leaders_place(1, insecure=True) == place
    monkeypatch.setenv("MASTER_ADDR", "localhost")
    assert leaders_place(1, insecure=False) == place
    with pytest.raises(UsageError, match="leave --learners out"):
        leaders_place(2, insecure=False)


@pytest.mark.parametrize(("rank", "size"), [("2", "2"), ("-1", "2"), ("0", "1000"), ("x", "2")])
def test_impossible_variables(monkeypatch, rank, size):
    """A rank outside of its group is refused."""
    for name, value in {**VARIABLES, "RANK": rank, "WORLD_SIZE": size}.items():
        monkeypatch.setenv(name, value)
    with pytest.raises(ConfigError, match="name no learner of a group"):
        given_place()
