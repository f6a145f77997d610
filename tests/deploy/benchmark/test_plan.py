"""What a benchmark consists of, and what it refuses before any process starts."""

import os
import sys

import pytest

from eia_sec.common.config.presets import preset
from eia_sec.common.errors import UsageError
from eia_sec.deploy.benchmark.plan import Plan, task_of
from eia_sec.deploy.benchmark.trainings import Measuring
from eia_sec.deploy.commands.training import benchmark
from eia_sec.deploy.commands.training.benchmark import BenchmarkArguments, plan_of, train_options
from eia_sec.deploy.exit_codes import USAGE
from eia_sec.rollout.envs.registry import environment_spec
from tests.deploy.benchmark.examples import COVER, MEASURING, base, plan


def test_every_algorithm_meets_every_environment_and_seed():
    """Each combination is there once, with the seeds of one after another, and one reference for each environment."""
    found = plan(COVER, "mpe2:simple_spread_v3")
    named = [(one.config.seed, one.config.env.name, one.algorithm) for one in found.trainings]
    assert len(set(named)) == 8
    assert named == sorted(named, key=lambda one: one[0])
    assert [one.config.algorithm.name for one in found.trainings] == [one.algorithm for one in found.trainings]
    assert [one.config.env.name for one in found.references] == [COVER, "mpe2:simple_spread_v3"]
    assert [one.config.seed for one in found.of_algorithm("mappo", COVER)] == [0, 1]


def test_a_run_is_what_train_trains():
    """Preset, settings, algorithm, steps and seed give the configuration of `eia-sec train` with the same options."""
    options = BenchmarkArguments("eia-ppo", COVER, seeds=2, steps=5000, points=2, set=("algorithm.hidden=32",))
    run = plan_of(options).trainings[1].config
    assert (run.steps, run.episodes, run.seed, run.algorithm.name) == (5000, 0, 1, "eia-ppo")
    assert (run.algorithm.hidden, run.algorithm.normalise_returns) == (32, True)
    assert run.env.name == COVER


@pytest.mark.parametrize(
    ("algorithms", "env", "changes", "said"),
    [
        ("ippo,foo", COVER, {}, "not 'foo'"),
        ("ippo,", COVER, {}, "--algorithms is a list of names with commas between"),
        ("ippo,ippo", COVER, {}, "--algorithms has ippo twice"),
        ("ippo", f"{COVER}, {COVER}", {}, "--env has mytask.env:Cover twice"),
        ("ippo", "farm", {}, "end by episodes; give --steps"),
        ("ippo", "zenoh:site", {}, "served by others"),
        ("ippo", COVER, {"seeds": 0}, "seeds must be between"),
        ("ippo", COVER, {"points": 0}, "points must be between"),
        ("ippo", COVER, {"steps": -1}, "steps must be between"),
        ("ippo", COVER, {"steps": 999}, "--steps must be 1,000 at least"),
        ("ippo", COVER, {"steps": 5000}, "--points may be 5 at most"),
        ("ippo", COVER, {"preset": "none"}, "there is no preset 'none'"),
        ("ippo", COVER, {"set": ("algorithm.none=1",)}, "algorithm.none"),
        ("ippo", "a.b:C,a.B:c", {}, "have one name in the results"),
    ],
)
def test_what_cannot_be_compared_is_refused(algorithms, env, changes, said):
    """Each mistake is one sentence."""
    with pytest.raises(UsageError, match=said):
        plan_of(BenchmarkArguments(algorithms, env, **changes))


def test_an_environment_that_cannot_be_made_is_refused_before_any_run(monkeypatch, tmp_path, capfd):
    """A trial finds it, says so, and nothing is written or started."""
    monkeypatch.setattr(benchmark, "Supervisor", lambda *_: pytest.fail("a run was started"))
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(filter(None, sys.path)))
    asked = ["--algorithms", "ippo", "--env", COVER, "--steps", "10000", "--out", str(tmp_path / "out")]
    with pytest.raises(SystemExit) as ended:
        benchmark.command([*asked, "--set", """env.arguments='{"ghost": 1}'"""])
    assert ended.value.code == USAGE
    assert "ghost" in capfd.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("algorithms", [("eia-sec", "qmix", "ippo"), ("ippo", "qmix", "eia-sec")])
def test_each_algorithm_is_tried_with_the_actions_that_it_trains(monkeypatch, algorithms):
    """An environment that offers boxes and options is tried with both, once; one without boxes is refused for one."""
    asked = []

    def tried(config):
        asked.append(config.algorithm.name)
        return environment_spec(config)

    monkeypatch.setattr("eia_sec.deploy.benchmark.plan.tried", tried)

    def plan_in(name):
        bases = [preset("generic").with_environment(name)]
        return Plan.of(bases, (*algorithms, "vdn", "maddpg"), 1, Measuring(10, 32))

    plan_in("mpe2:simple_spread_v3").require_possible()
    assert asked == list(algorithms)
    with pytest.raises(UsageError, match=r"Cover has discrete actions \(walker\), which eia-sec cannot train"):
        plan_in(COVER).require_possible()


def test_settings_become_options_of_train():
    """Texts lose the quotes that a setting needs, because an option has none."""
    options = BenchmarkArguments("ippo", COVER, preset="quick", set=("env.arguments='{}'", "algorithm.hidden = 8"))
    assert train_options(options) == ["--preset", "quick", "--env.arguments={}", "--algorithm.hidden=8"]


def test_a_folder_of_something_else_is_refused(tmp_path, monkeypatch):
    """Nothing is written into a folder that holds other things."""
    (tmp_path / "thesis.tex").touch()
    monkeypatch.setattr(Plan, "require_possible", lambda self: None)
    with pytest.raises(UsageError, match="is not the folder of a benchmark"):
        benchmark.command(["--algorithms", "ippo", "--env", COVER, "--out", str(tmp_path)])


def test_names_of_tasks_are_those_that_marl_eval_takes():
    """Module and member in small letters; what has no module is ours."""
    assert task_of("mpe2:Simple_Spread_v3") == ("mpe2", "simple_spread_v3")
    assert task_of("farm") == ("eia-sec", "farm")


def test_a_preset_with_steps_needs_none():
    """`generic` has a budget in steps, which all take."""
    found = Plan.of([preset("generic").with_environment(COVER)], ("ippo",), 1, Measuring(10, 32))
    assert found.trainings[0].config.steps == 1_000_000
    assert MEASURING.points * base().rollout.environments * base().rollout.chunk_steps <= base().steps
