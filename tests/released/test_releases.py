"""Files that releases wrote: a folder is an interrupted run of a release, which later versions read and go on with."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from eia_sec.common.farm import farm_team
from eia_sec.common.policy_file import POLICY, load_policy
from eia_sec.deploy.local.run_directory import RunDirectory
from eia_sec.deploy.monitor.audit import audit
from eia_sec.rollout.evaluation import evaluate
from eia_sec.rollout.policies import ActorPolicy

RELEASES = sorted(folder.name for folder in Path(__file__).parent.iterdir() if folder.name[0].isdigit())


@pytest.fixture(params=RELEASES)
def released(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """Return a copy of a release's run directory."""
    return Path(shutil.copytree(Path(__file__).parent / request.param, tmp_path / "run"))


def test_a_configuration_and_a_policy_of_a_release_are_read(released: Path) -> None:
    """The actors fit the farm that the configuration describes, and fly it."""
    config, (actors, _) = RunDirectory(released).configuration(), load_policy(released / POLICY)
    assert actors.team == farm_team(config.farm)
    found = evaluate(config.farm, ActorPolicy(actors), [1000], 1, name="released")
    assert found.total.steps == config.farm.world.steps


def test_the_history_of_a_release_is_audited(released: Path) -> None:
    """Nothing is unexplained, and the steps that the learner took are those of its last report."""
    found = audit(released)
    assert (found.unexplained, found.doubled) == ([], [])
    records = [json.loads(line) for line in (released / "metrics.jsonl").read_text(encoding="utf-8").splitlines()]
    assert found.steps["accepted"] == max(record.get("environment_steps", 0) for record in records) > 0


@pytest.mark.slow
def test_a_run_of_a_release_goes_on_to_its_end(released: Path) -> None:
    """It resumes from the release's checkpoint, and the ledger over both versions is exact."""
    before = audit(released).steps["accepted"]
    command = [
        sys.executable,
        "-m",
        "eia_sec.deploy.cli",
        "train",
        "--run-dir",
        str(released),
        "--resume",
        "--no-report",
    ]
    ended = subprocess.run(command, check=False, capture_output=True, text=True, timeout=240.0)
    assert ended.returncode == 0, ended.stdout + ended.stderr
    config, found = RunDirectory(released).configuration(), audit(released)
    assert (found.unexplained, found.doubled) == ([], [])
    assert found.steps["accepted"] >= config.episodes * config.farm.world.steps > before
