"""SIGTERM and Ctrl-C to `eia-sec train`: drained, checkpointed, exit 0, and no process is left."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import psutil
import pytest

from eia_sec.deploy.monitor.audit import audit
from eia_sec.learner.checkpoint import files
from tests.faults.tools.harness import LONG, record_result, spread
from tests.system.fleet import PRESET, until


def stop_training(directory: Path, number: int, running: bool) -> float:
    """Start training, stop it with a signal, once chunks flow or at once; return the seconds to the end."""
    config = directory / "wanted.toml"
    config.write_text(LONG, encoding="utf-8")
    command = [
        sys.executable,
        "-m",
        "eia_sec.deploy.cli",
        "train",
        "--preset",
        PRESET,
        "--config",
        str(config),
        "--run-dir",
        str(directory / "run"),
    ]
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"}
    with (directory / "train.log").open("wb") as log:
        process = subprocess.Popen([*command, "--no-report"], stdout=log, stderr=log, env=environment)
    history = directory / "run" / "history" / "learner.jsonl"
    try:
        until(lambda: history.exists() and (not running or '"accepted"' in history.read_text()), "training", 120.0)
        children = psutil.Process(process.pid).children(recursive=True)
        started = time.monotonic()
        process.send_signal(number)
        assert process.wait(60.0) == 0, (directory / "train.log").read_text()
        seconds = time.monotonic() - started
        assert not [child for child in children if child.is_running() and child.status() != psutil.STATUS_ZOMBIE]
        if running:
            assert files.load_latest(directory / "run" / "checkpoints") is not None
            assert audit(directory / "run").clean
        return seconds
    finally:
        if process.poll() is None:
            process.kill()
            process.wait(10.0)


def test_a_stop_in_the_middle(tmp_path):
    """Ctrl-C in the middle of training ends with a checkpoint, exit code 0, a clean ledger and no orphan."""
    assert stop_training(tmp_path, signal.SIGINT, running=True) < 60


@pytest.mark.nightly
@pytest.mark.timeout(3600)
def test_fifty_stops(tmp_path):
    """Fifty stops, by both signals and at different moments, each within ten seconds."""
    seconds: list[float] = []
    for index in range(50):
        folder = tmp_path / str(index)
        folder.mkdir()
        number = (signal.SIGINT, signal.SIGTERM)[index % 2]
        seconds.append(stop_training(folder, number, running=index % 5 != 0))
    measured: dict[str, Any] = {"stops": len(seconds), "seconds_to_end": spread(seconds)}
    record_result("stops", **measured)
    assert max(seconds) <= 10
