"""Keeping finished runs."""

import json
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from eia_sec.common.config import RunConfig
from eia_sec.common.config.files import to_toml
from eia_sec.common.config.presets import PRESETS, preset
from eia_sec.common.errors import UsageError
from eia_sec.common.farm import farm_team
from eia_sec.common.policy_file import POLICY, load_policy, save_policy
from eia_sec.deploy.local.run_directory import METRICS
from eia_sec.learner.on_policy.trainer import OnPolicyTrainer
from eia_sec.rollout.shipped_policies import SHIPPED
from research.experiments import keep_run
from research.experiments.condition_farms import CONDITIONS, configuration, longer_configuration


def scores(policy, reward):
    """Return scores as a page has them."""
    types = {"communication": 0.0, "monitoring": reward, "collection": reward}
    return {"policy": policy, "reward": [reward, reward, reward], "types": types, "seed": 0}


@pytest.fixture
def results(tmp_path, monkeypatch):
    """Return the folder of results of one small condition, with policies of two seeds."""
    monkeypatch.setitem(CONDITIONS, "tiny", ("instant", "[farm.world]\nsteps = 20"))
    longer = {**scores("longer", 2.0), "others": [{**scores("longer", 3.0), "seed": 1, "commit": "old"}]}
    tiny = {"commit": "old, longer old", "heuristics": [scores("greedy", 4.0)], "longer": longer}
    data = {"command": "made", "commit": "old", "farms": [1000, 1001], "episodes": 1, "seed": 0}
    (tmp_path / "results.json").write_text(json.dumps({**data, "results": {"tiny": tiny}}), encoding="utf-8")
    return tmp_path


def finished_run(folder: Path, config: RunConfig) -> Path:
    """Return a run directory as far as it is read."""
    folder.mkdir()
    (folder / "config.toml").write_text(to_toml(config), encoding="utf-8")
    save_policy(folder / POLICY, OnPolicyTrainer(config, farm_team(config.farm)).actors().noise_free(), {})
    record = {"kind": "status", "elapsed": 7.0, "environment_steps": 40, "episodes": 2}
    (folder / METRICS).write_text(json.dumps(record) + "\n", encoding="utf-8")
    return folder


def call(monkeypatch, *words):
    """Run the command."""
    monkeypatch.setattr(sys, "argv", ["keep_run", *map(str, words)])
    return keep_run.main()


def test_a_run_takes_the_place_of_a_conditions_policies_and_others_join_it(results, tmp_path, monkeypatch):
    """First seed 4 alone, then seed 5 beside it; the page and the policy that ships are of these runs."""
    shipped = tmp_path / "shipped.safetensors"
    monkeypatch.setitem(PRESETS, "tiny", configuration("tiny", 2, 0))
    monkeypatch.setitem(CONDITIONS, "tiny", ("tiny", ""))
    monkeypatch.setitem(SHIPPED, "trained:tiny", ("tiny", shipped))
    for seed in (4, 5):
        run = finished_run(tmp_path / str(seed), configuration("tiny", 2, seed))
        words = run, "--commit", f"new{seed}", "--condition", "tiny", "--output", results
        assert call(monkeypatch, *words, "--ship" if seed == 4 else "--add") == 0
    found = json.loads((results / "results.json").read_text(encoding="utf-8"))["results"]["tiny"]
    assert (found["longer"]["seed"], found["commit"]) == (4, "old, longer new4")
    assert [(other["seed"], other["commit"]) for other in found["longer"]["others"]] == [(5, "new5")]
    assert found["longer"]["seconds"] == 7.0
    assert "longer 5 new5" in (results / "README.md").read_text(encoding="utf-8")
    assert load_policy(shipped)[1]["command"] == "eia-sec train --preset tiny --seed 4 --episodes 2"


REFUSED = {
    "no condition": (["--condition", "huge"], 4, "no condition 'huge'"),
    "not in the results": (["--condition", "no-fly zones"], 4, "no condition 'no-fly zones'"),
    "another farm": (["--condition", "tiny"], None, "other settings"),
    "the seed is there": (["--condition", "tiny", "--add"], 0, "has seed 0 already"),
    "no preset's farm": (["--condition", "tiny", "--ship"], 4, "not a preset's own"),
    "nothing to join": (["--add"], 4, "name it with --condition"),
}


@pytest.mark.parametrize(("words", "seed", "sentence"), REFUSED.values(), ids=REFUSED)
def test_mistakes_are_one_sentence_and_change_nothing(results, tmp_path, monkeypatch, words, seed, sentence):
    """The results stay as they are, and no policy ships."""
    before = (results / "results.json").read_bytes()
    tiny = replace(longer_configuration("tiny", seed or 0), episodes=2)
    config = configuration("instant", 2, 0) if seed is None else tiny
    run = finished_run(tmp_path / "run", config)
    with pytest.raises(UsageError, match=sentence):
        call(monkeypatch, run, "--commit", "new", "--output", results, *words)
    assert (results / "results.json").read_bytes() == before


def test_where_the_farm_is_the_defaults_the_longer_policy_has_the_preset_long(results, tmp_path, monkeypatch):
    """A run of the preset long becomes it, and one of the preset instant is refused."""
    found = longer_configuration("tiny", 4)
    assert found == replace(preset("long"), farm=replace(preset("long").farm, world=found.farm.world), seed=4)
    for config, fits in ((replace(found, episodes=2), True), (configuration("tiny", 2, 4), False)):
        run = finished_run(tmp_path / str(fits), config)
        words = run, "--commit", "new", "--condition", "tiny", "--output", results
        if fits:
            assert call(monkeypatch, *words) == 0
        else:
            with pytest.raises(UsageError, match="other settings"):
                call(monkeypatch, *words)


def test_a_run_that_has_recorded_nothing_is_refused(results, tmp_path, monkeypatch):
    """Its metrics are empty, or there are none."""
    run = finished_run(tmp_path / "run", configuration("tiny", 2, 4))
    for spoil in (lambda: (run / METRICS).write_text("", encoding="utf-8"), (run / METRICS).unlink):
        spoil()
        with pytest.raises(UsageError, match="recorded nothing"):
            call(monkeypatch, run, "--commit", "new", "--condition", "tiny", "--output", results)
