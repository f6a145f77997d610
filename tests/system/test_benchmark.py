"""A benchmark as its user types it: stopped, continued, with a plug-in's algorithm and environment."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest

from tests.system.training import gone

EXAMPLES = Path(__file__).parents[2] / "docs" / "examples"
COMMAND = (
    *(sys.executable, "-m", "eia_sec.deploy.cli", "benchmark", "--plugin", "mytask", "--algorithms", "ippo,smooth"),
    *("--env", "cover", "--seeds", "1", "--steps", "1600", "--points", "2", "--scenarios", "2", "--jobs", "1", "--set"),
    *("algorithm.hidden=8", "algorithm.iteration_steps=200", "algorithm.minibatch_steps=100", "algorithm.epochs=1"),
    *("rollout.environments=2", "rollout.chunk_steps=20"),
)


@pytest.fixture
def benchmark(tmp_path):
    """Start the command in a folder; what is left of it is killed."""
    begun = []
    paths = [str(EXAMPLES), os.environ.get("PYTHONPATH", "")]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, paths))}

    def start():
        output = (tmp_path / "output.txt").open("ab")
        words = [*COMMAND, "--out", str(tmp_path / "out")]
        begun.append(subprocess.Popen(words, stdout=output, stderr=output, env=environment))
        return begun[-1]

    yield start
    for process in begun:
        if process.poll() is None:
            for child in psutil.Process(process.pid).children(recursive=True):
                child.kill()
            process.kill()
            process.wait(10.0)


def records(folder):
    """Return the finished records by name, with the times of their files."""
    found = [path for path in (folder / "records").glob("*.json") if not path.name.endswith(".job.json")]
    return {path.name: path.stat().st_mtime_ns for path in found}


def test_a_benchmark_goes_on_where_it_was_stopped(benchmark, tmp_path):
    """Ctrl-C leaves no process and exits with 130; the same command keeps what is there, and writes the comparison."""
    out = tmp_path / "out"
    process = benchmark()
    deadline = time.monotonic() + 300.0
    while not records(out):
        assert process.poll() is None, (tmp_path / "output.txt").read_text()
        assert time.monotonic() < deadline, "a run did not happen within 300 s"
        time.sleep(0.1)
    children = psutil.Process(process.pid).children(recursive=True)
    process.send_signal(signal.SIGINT)
    assert process.wait(30.0) == 130
    assert gone(children)
    before = records(out)
    assert 1 <= len(before) < 3
    assert not (out / "README.md").exists()
    again = benchmark()
    assert again.wait(300.0) == 0, (tmp_path / "output.txt").read_text()
    after = records(out)
    assert len(after) == 3
    assert {name: after[name] for name in before} == before
    said = (tmp_path / "output.txt").read_text()
    assert f"{3 - len(before)} runs to do, {len(before)} are there" in said
    found = json.loads((out / "marl_eval.json").read_text())["mytask.env"]["cover"]
    assert list(found) == ["ippo", "smooth"]
    assert all(list(runs) == ["seed_0"] for runs in found.values())
    page = (out / "README.md").read_text()
    assert "eia-sec benchmark --plugin mytask --algorithms ippo,smooth --env mytask.env:Cover" in page
    assert "| smooth |" in page
    assert all((out / name).stat().st_size > 10_000 for name in ("curves.png", "scores.png"))
