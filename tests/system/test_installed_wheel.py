"""The wheel in somebody else's project."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.system.fleet import PRESET, TINY

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder that holds the installed wheel and nothing else; dependencies come from this environment."""
    folder = tmp_path_factory.mktemp("wheel")
    build = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)]
    subprocess.run(build, cwd=ROOT, check=True, capture_output=True)
    (wheel,) = folder.glob("*.whl")
    site = folder / "site"
    install = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-index", "--target", str(site)]
    subprocess.run([*install, str(wheel)], check=True, capture_output=True)
    return site


def test_it_trains_and_evaluates_beside_packages_of_the_same_names(installed: Path, tmp_path: Path) -> None:
    """A project with its own `common` and `deploy` keeps them, and `eia_sec` is the installed one."""
    for name in ("common", "rollout", "learner", "elite", "deploy"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "__init__.py").write_text('OWNER = "the project"\n', encoding="utf-8")
    (tmp_path / "tiny.toml").write_text(TINY, encoding="utf-8")

    def python(*arguments: str) -> str:
        environment = {**os.environ, "PYTHONPATH": str(installed)}
        done = subprocess.run(
            [sys.executable, *arguments], cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout

    where = python("-c", "import common, deploy, eia_sec; print(common.OWNER, deploy.OWNER, eia_sec.__file__, sep='|')")
    assert where.strip() == f"the project|the project|{installed / 'eia_sec' / '__init__.py'}"
    command = ["-m", "eia_sec.deploy.cli"]
    python(*command, "train", "--preset", PRESET, "--config", "tiny.toml", "--run-dir", "run", "--no-report")
    scores = json.loads(python(*command, "evaluate", "--run-dir", "run", "--farms", "1000:1002", "--json"))
    assert [farm["farm"] for farm in scores["per_farm"]] == [1000, 1001]
