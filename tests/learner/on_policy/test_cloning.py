"""Cloned actors do what demonstrations did, and a run that begins as them does not fall below."""

import json

import numpy as np
import pytest

import eia_sec
from eia_sec.common.config import RunConfig
from eia_sec.common.config.files import with_values
from eia_sec.common.config.presets import preset
from eia_sec.common.errors import ConfigError, UsageError
from eia_sec.common.policy_file import load_policy
from eia_sec.common.team import GroupSpec, TeamSpec
from eia_sec.deploy.cli import dispatch
from eia_sec.deploy.local.cloning import FILE, Clones
from eia_sec.learner.on_policy.cloning import LEAST_DEVIATION, cloned
from eia_sec.rollout.demonstrations import recorded, save_demonstrations
from eia_sec.rollout.policies import run_policy

COVER = preset("generic").with_environment("mytask.env:Cover")
NEAREST = "mytask.heuristics:Nearest"


@pytest.fixture
def demonstrations(tmp_path):
    """A file with what the example's heuristic does."""
    save_demonstrations(path := tmp_path / "demos.safetensors", recorded(COVER, run_policy(NEAREST, COVER), 64, "n"))
    return path


def test_choices_and_numbers_are_cloned():
    """From observations of other scales, which published actors read as they are."""
    team = TeamSpec((GroupSpec("chooser", 1, 3, 1, choices=(3,)), GroupSpec("walker", 2, 2, 1)))
    seen = np.random.default_rng(0).standard_normal((512, 7)).astype(np.float32) * np.float32(20.0) + np.float32(5.0)
    option = seen[:, :3].argmax(axis=1, keepdims=True).astype(np.float32)
    number = np.tanh(seen[:, 3:].reshape(-1, 2, 2).mean(axis=2) / np.float32(20.0)).astype(np.float32)
    config = with_values(RunConfig(), {"algorithm.normalise_observations": True})
    actors, _ = cloned(config, team, seen, np.concatenate([option, number], axis=1))
    done = actors.act(seen)
    assert (done[:, :1] == option).mean() > 0.95
    assert np.abs(done[:, 1:] - number).mean() < 0.05
    draw = np.random.default_rng(1)
    sampled, _ = actors.sample(seen, draw.standard_normal((512, 3), np.float32), draw.random((512, 3), np.float32))
    apart = np.arctanh(sampled[:, 1:].clip(-0.999, 0.999)) - np.arctanh(done[:, 1:].clip(-0.999, 0.999))
    assert np.sqrt((apart**2).mean()) > LEAST_DEVIATION / 2


def test_a_run_begins_as_the_clones(tmp_path, demonstrations):
    """They act as the heuristic; value functions learn first, unless the run says for how long."""
    team = recorded(COVER, run_policy(NEAREST, COVER), 1, "n").team
    clones = Clones(COVER, team, demonstrations, resume=False)
    config = clones.settings(tmp_path)
    assert config.on_policy.start_policy["all"] == str(tmp_path / FILE)
    assert config.on_policy.value_steps == config.on_policy.iteration_steps
    assert "cloned from 1,280 steps" in clones.save(tmp_path)
    actors, metadata = load_policy(tmp_path / FILE)
    assert metadata["environment"] == "mytask.env:Cover"
    again = recorded(COVER, run_policy(NEAREST, COVER), 20, "n")
    assert (actors.act(again.observation) == again.action).mean() > 0.97


def test_what_cannot_begin_is_refused(demonstrations):
    """Before anything is cloned: a run that resumes, another policy to begin as, an algorithm off policy, memory."""
    team = recorded(COVER, run_policy(NEAREST, COVER), 1, "n").team
    with pytest.raises(UsageError, match="--demonstrations begin a run"):
        Clones(COVER, team, demonstrations, resume=True)
    with pytest.raises(UsageError, match="both say what actors begin as"):
        Clones(with_values(COVER, {"algorithm.start_policy.all": "x"}), team, demonstrations, resume=False)
    with pytest.raises(ConfigError, match="need an algorithm on policy, and masac is none"):
        Clones(COVER.with_algorithm("masac"), team, demonstrations, resume=False)
    memory = {"algorithm.memory": "gru", "algorithm.sequence_steps": 25}
    with pytest.raises(ConfigError, match="cloned by actors without memory"):
        Clones(with_values(COVER, memory), team, demonstrations, resume=False)


@pytest.mark.slow
def test_ppo_does_not_fall_below_what_was_cloned(tmp_path, demonstrations):
    """After 20,000 steps the policy is at least as good as the heuristic."""
    team = recorded(COVER, run_policy(NEAREST, COVER), 1, "n").team
    clones = Clones(COVER, team, demonstrations, resume=False)
    clones.save(tmp_path)
    run = eia_sec.train(clones.settings(tmp_path), steps=20_000)
    known = eia_sec.evaluate(NEAREST, "mytask.env:Cover", farms=range(1000, 1100)).total.reward
    assert run.evaluate(scenarios=100).total.reward > known - 0.3


def test_commands_record_and_compare(tmp_path, capsys):
    """A heuristic by its place is recorded, and evaluated against a run on the same scenarios."""
    path = tmp_path / "demos.safetensors"
    named = ["--policy", NEAREST, "--env", "mytask.env:Cover"]
    assert dispatch(["record", *named, "--episodes", "2", "--out", str(path)]) == 0
    assert "40 steps of 2 episodes, reward -" in capsys.readouterr().out
    run = tmp_path / "run"
    eia_sec.train("mytask.env:Cover", steps=2000, run_dir=run)
    words = ["evaluate", *named, "--against", str(run), "--farms", "1000:1010"]
    assert dispatch(words) == 0
    assert "mytask.heuristics:Nearest minus against run: +" in capsys.readouterr().out
    assert dispatch([*words, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["policy"], found["against"]["policy"]) == (NEAREST, "against run")
    with pytest.raises(UsageError, match="policies cannot be recorded on the farm"):
        dispatch(["record", "--policy", "greedy", "--env", "farm", "--out", str(path)])
