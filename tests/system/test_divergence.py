"""Training that diverges ends once, and says what is left."""

import subprocess
import sys


def test_training_that_diverges_ends_once_with_one_sentence(tmp_path):
    """A learning rate of 1e30 ends the run with exit code 2; nothing is restarted to diverge again."""
    run = tmp_path / "run"
    words = ["train", "--preset", "quick", "--algorithm.actor-rate", "1e30", "--run-dir", str(run), "--no-report"]
    done = subprocess.run(
        [sys.executable, "-m", "eia_sec.deploy.cli", *words], capture_output=True, text=True, check=False, timeout=300
    )
    assert done.returncode == 2, done.stderr
    said = (run / "logs" / "learner.log").read_text()
    assert said.count("the training has diverged after") == 1
    assert "checkpoint" in said.splitlines()[-1]
