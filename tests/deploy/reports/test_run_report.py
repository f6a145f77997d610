"""The report at a run's end."""

import io
from dataclasses import replace
from pathlib import Path

import pytest
from rich.console import Console

from eia_sec.common.actors import TeamActors
from eia_sec.common.config import EnvConfig, RunConfig
from eia_sec.common.config.files import with_values
from eia_sec.common.config.presets import preset
from eia_sec.common.environment import EnvironmentSpec
from eia_sec.common.errors import PolicyError, UsageError
from eia_sec.common.farm import farm_team
from eia_sec.common.policy_file import POLICY, UNTRAINED, save_policy
from eia_sec.common.team import GroupSpec, TeamSpec
from eia_sec.deploy.local.run_directory import METRICS, RunDirectory
from eia_sec.deploy.reports import run_report
from eia_sec.rollout.evaluation import Evaluation, Score

ENVIRONMENT = EnvironmentSpec(TeamSpec((GroupSpec("scout", 2, 4, 1),)), (1, 9))
SMALL = {"farm.world.steps": 5, "farm.world.sensors": 30, "evaluation.farms": 1}


def row(name: str, reward: float) -> Evaluation:
    """Return a policy's evaluation."""
    score = Score(reward, {"scout": reward}, 9.0, {})
    return Evaluation(name, (1000,), 1, score, (score,), ENVIRONMENT)


def test_a_run_elsewhere_is_compared_with_its_beginning_and_random_actions(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The table has the rows of the run too, drawn actions included; the picture compares its curve with others."""
    rows = [row("this run", 1.0), row("this run, sampled", 2.0), row("untrained", 3.0), row("random", 4.0)]
    drawn: dict[str, float] = {}
    monkeypatch.setattr(run_report, "evaluate_all", lambda *arguments: rows)
    monkeypatch.setattr(run_report, "curves", lambda metrics, path, levels, shown, title: drawn.update(levels))
    (tmp_path / METRICS).write_text("")
    said = io.StringIO()
    config = RunConfig(env=EnvConfig("toy_env:Relay"))
    run_report.write_report(RunDirectory(tmp_path), config, ["eia-sec", "train"], Console(file=said, width=80))
    assert drawn == {"random": 4.0}
    lines = said.getvalue().splitlines()
    assert lines[0].startswith("evaluating on 20 scenarios ")
    assert any(line.split() == ["reward", "per", "agent", "3.00", "1.00", "2.00", "4.00"] for line in lines)
    heading = "untrained trained trained, sampled random actions"
    assert any(" ".join(line.split()).endswith(heading) for line in lines)
    assert "replay" not in said.getvalue()
    assert lines[-1].split("#")[0].strip() == f"eia-sec evaluate --run-dir {tmp_path} --env toy_env:Relay"


def test_the_table_has_the_best_heuristic_alone() -> None:
    """Of several references the best one stands beside the run, by its name."""
    rows = [row("this run", 5.0), row("untrained", 4.0), row("greedy", 2.0), row("lawnmower", 3.0)]
    found = run_report.shown(rows, ("greedy", "lawnmower"))
    assert [one.policy for one in found] == ["untrained", "trained", "best of 2 heuristics:\nlawnmower"]


def test_what_the_run_began_as_is_evaluated_where_it_was_kept(tmp_path: Path) -> None:
    """On the same farms as the run's policy, by what it was; without its file, as on a full disk, the others remain."""
    config = with_values(preset("quick"), SMALL)
    for seed, name in enumerate((POLICY, UNTRAINED)):
        save_policy(tmp_path / name, TeamActors.initial(farm_team(config.farm), 8, seed), {})
    found = run_report.evaluate_all(config, tmp_path, [1000])
    assert [one.policy for one in found][:2] == ["this run", "untrained"]
    assert found[0].total != found[1].total
    begun = with_values(config, {"algorithm.start_policy.all": "long"})
    as_policy = run_report.evaluate_all(begun, tmp_path, [1000])
    assert as_policy[1].policy == "at the beginning"
    shown = run_report.shown(as_policy, [one.policy for one in as_policy[2:]])
    assert [one.policy for one in shown][:2] == ["at the beginning", "trained"]
    (tmp_path / UNTRAINED).unlink()
    assert [one.policy for one in run_report.evaluate_all(config, tmp_path, [1000])] == [
        one.policy for one in found if one.policy != "untrained"
    ]


@pytest.mark.parametrize("name", ["farm", "toy_env:Relay"])
def test_a_run_without_its_policy_is_not_reported(tmp_path: Path, name: str) -> None:
    """What the run began as would be taken for what it has learned."""
    config = replace(RunConfig(), env=EnvConfig(name))
    save_policy(tmp_path / UNTRAINED, TeamActors.initial(ENVIRONMENT.team, 8, 0), {})
    with pytest.raises(PolicyError, match=r"policy\.safetensors"):
        run_report.evaluate_all(config, tmp_path, [1000])


def test_only_commands_that_work_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """A film needs ffmpeg; names of folders are quoted."""

    def none() -> str:
        raise UsageError("films need ffmpeg.")

    monkeypatch.setattr(run_report, "find_ffmpeg", lambda: "ffmpeg")
    assert "--film" not in "".join(run_report.next_commands(Path("my run"), preset("quick")))
    monkeypatch.setattr(run_report, "find_ffmpeg", none)
    replay, evaluate = run_report.next_commands(Path("my run"), preset("quick"))
    assert replay.split("#")[0].strip() == "eia-sec replay 'my run' --film none"
    assert evaluate.split("#")[0].strip() == "eia-sec evaluate --run-dir 'my run'"
