"""Training from a program by processes of its own: watched, given other arguments, stopped, and evaluated."""

import os
import threading
from pathlib import Path

import pytest
from mytask.env import Cover

import eia_sec

EXAMPLES = Path(__file__).parents[2] / "docs" / "examples"
SETTINGS = {
    "algorithm.hidden": 8,
    "algorithm.iteration_steps": 160,
    "algorithm.minibatch_steps": 80,
    "algorithm.epochs": 1,
    "rollout.environments": 2,
    "rollout.chunk_steps": 20,
}


class Watcher(eia_sec.Callback):
    """Changes arguments at the first call, and stops once a worker has said that it has them."""

    def __init__(self, log):
        self.log, self.calls, self.ended = log, 0, 0

    def on_progress(self, training):
        self.calls += 1
        training.set_arguments(size=9)
        if '"size": 9' in self.log.read_text():
            training.stop("the curriculum has arrived")

    def on_end(self, training):
        self.ended += 1


@pytest.fixture
def _importable(monkeypatch):
    monkeypatch.setenv("PYTHONPATH", str(EXAMPLES), prepend=os.pathsep)


@pytest.mark.usefixtures("_importable")
def test_a_thread_trains_with_a_worker_and_a_curriculum(tmp_path):
    """From a thread, a run is begun with a worker; a callback's arguments reach it, and stopping keeps the policy."""
    found, watcher = [], Watcher(tmp_path / "run" / "logs" / "rollout-0.log")

    def work():
        found.append(
            eia_sec.train(
                Cover, workers=1, steps=10**9, settings=SETTINGS, callbacks=[watcher], run_dir=tmp_path / "run"
            )
        )

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    run = found[0]
    assert run.stopped == "the curriculum has arrived"
    assert watcher.ended == 1
    assert run.environment_steps > 0
    assert run.directory == tmp_path / "run"
    assert run.evaluate(scenarios=2).total.steps == 20.0
