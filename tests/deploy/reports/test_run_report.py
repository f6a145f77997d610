"""The report at a run's end."""

import io
from pathlib import Path

import pytest
from rich.console import Console

from eia_sec.common.config import EnvConfig, RunConfig
from eia_sec.common.environment import EnvironmentSpec
from eia_sec.common.team import GroupSpec, TeamSpec
from eia_sec.deploy.local.run_directory import METRICS, RunDirectory
from eia_sec.deploy.reports import run_report
from eia_sec.rollout.evaluation import Evaluation, Score


def test_levels_in_the_picture_are_those_of_the_references(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The table has the rows of the run too, drawn actions included; the picture compares its curve with others."""
    environment = EnvironmentSpec(TeamSpec((GroupSpec("scout", 2, 4, 1),)), (1, 9))
    score = Score(1.0, {"scout": 1.0}, 9.0, {})
    rows = [Evaluation(name, (1000,), 1, score, (score,), environment) for name in ("this run", "this run, sampled")]
    rows.append(Evaluation("random", (1000,), 1, score, (score,), environment))
    drawn: dict[str, float] = {}
    monkeypatch.setattr(run_report, "evaluate_all", lambda *arguments: rows)
    monkeypatch.setattr(run_report, "curves", lambda metrics, path, levels, shown: drawn.update(levels))
    (tmp_path / METRICS).write_text("")
    said = io.StringIO()
    config = RunConfig(env=EnvConfig("toy_env:Relay"))
    run_report.write_report(RunDirectory(tmp_path), config, ["eia-sec", "train"], Console(file=said))
    assert drawn == {"random": 1.0}
    assert "this run, sampled" in said.getvalue()
