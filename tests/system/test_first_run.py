"""A whole short training with its processes: the one that `make test` runs."""

import json

from tests.system.fleet import until
from tests.system.training import Training, gone


def test_a_run_ends_with_pictures_and_a_table(training: Training) -> None:
    """Two workers, learner and coordinator are processes of their own; the results are there and nobody is left."""
    training.start("--workers", "2")
    roles = until(lambda: len(training.children()) >= 4 and training.children(), "four processes")
    assert training.wait() == 0, training.output.read_text()
    assert gone(roles)
    for name in ("curves.png", "trajectories.png", "policy.safetensors", "config.toml", "metrics.jsonl"):
        assert (training.run_dir / name).stat().st_size > 0
    evaluation = json.loads((training.run_dir / "evaluation.json").read_text())
    policies = [result["policy"] for result in evaluation["evaluations"]]
    assert policies == ["this run", "untrained", "lawnmower", "greedy", "static", "random"]
    said = training.output.read_text()
    assert "untrained" in said
    assert f"eia-sec evaluate --run-dir {training.run_dir}" in said
