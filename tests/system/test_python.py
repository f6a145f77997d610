"""Training from a program by processes of its own: watched, given other arguments, stopped, and evaluated."""

import os
import subprocess
import sys
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


@pytest.mark.usefixtures("_importable")
def test_a_plugin_is_known_to_every_process(tmp_path):
    """Learner, coordinator and worker of a command train a plug-in's loss; others are told to name it."""
    command = [sys.executable, "-m", "eia_sec.deploy.cli"]
    options = [f"--{name.replace('_', '-')}={value}" for name, value in SETTINGS.items()]
    run = tmp_path / "run"
    trained = [*command, "train", "--plugin", "mytask", "--env", "cover", "--algorithm", "smooth", "--steps", "4000"]
    subprocess.run([*trained, *options, "--run-dir", str(run), "--no-report"], check=True, timeout=300)
    logs = {path.stem: path.read_text() for path in (run / "logs").glob("*.log")}
    assert "finished" in logs["learner"]
    assert not any("Traceback" in text for text in logs.values())
    evaluated = [*command, "evaluate", "--run-dir", str(run), "--env", "mytask.env:Cover", "--farms", "1000:1002"]
    refused = subprocess.run(evaluated, capture_output=True, text=True, check=False)
    assert refused.returncode == 2
    assert "add --plugin mytask to run its code" in refused.stderr
    subprocess.run([*evaluated, "--plugin", "mytask"], check=True)
    exported = [*command, "export", "--run-dir", str(run), "--format", "safetensors", "--plugin", "mytask"]
    subprocess.run(exported, check=True)
    assert (run / "export" / "actors.safetensors").is_file()


@pytest.mark.usefixtures("_importable")
def test_a_plugins_callback_says_why_it_stopped_a_run(tmp_path, monkeypatch):
    """The learner calls it; `Run.stopped` and the command's output have its reason, and the policy is kept."""
    (tmp_path / "stopping.py").write_text(
        "import eia_sec\n"
        "class Stop(eia_sec.Callback):\n"
        "    def on_progress(self, training):\n"
        "        if training.environment_steps:\n"
        "            training.stop('seen enough')\n"
        "plugin = eia_sec.Plugin(callbacks=['stopping:Stop'])\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=os.pathsep)
    run = eia_sec.train(
        Cover, workers=1, steps=10**9, settings=SETTINGS, plugins=["stopping"], run_dir=tmp_path / "run"
    )
    assert run.stopped == "seen enough"
    options = [f"--{name.replace('_', '-')}={value}" for name, value in SETTINGS.items()]
    command = [sys.executable, "-m", "eia_sec.deploy.cli", "train", "--plugin", "stopping", "--env", "mytask.env:Cover"]
    shown = subprocess.run(
        [*command, "--steps", "100000000", *options, "--run-dir", str(tmp_path / "again"), "--no-report"],
        check=True,
        timeout=300,
        capture_output=True,
        text=True,
    ).stdout
    assert "a callback stopped the run: seen enough" in shown
    assert "--env mytask.env:Cover" in shown.replace("\n", " ")
    assert "--plugin stopping" in shown.replace("\n", " ")
