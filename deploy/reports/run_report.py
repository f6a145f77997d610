"""What a finished run leaves behind: curves.png, trajectories.png, evaluation.json and a table on unseen farms."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich.console import Console

from common.config import RunConfig
from common.policy_file import load_policy
from deploy.local.run_directory import METRICS, POLICY, RunDirectory
from deploy.reports.comparison_tables import comparison_table
from deploy.reports.plots import curves, trajectories
from rollout.evaluation import Evaluation, evaluate, evaluate_run, record
from rollout.heuristics.random import RandomPolicy
from rollout.policies import ActorPolicy, policy_of

TRAINED = "EIA-SEC (this run)"
SHOWN = ("lawnmower", "greedy", "static", "random")
"""The other policies of the report; those that plan ahead take minutes, and `eia-sec evaluate --policy` flies them."""


def write_report(directory: RunDirectory, config: RunConfig, command: Sequence[str], console: Console) -> None:
    """Evaluate the run's policy and every heuristic on farms that training never saw, and draw the pictures.

    Args:
        directory: the run directory, which holds metrics.jsonl and policy.safetensors.
        config: the run.
        command: the command line that made it, for the record.
        console: where the table goes.
    """
    path = directory.path
    first = config.evaluation.first_farm
    farms = range(first, first + config.evaluation.farms)
    what = "farms" if config.env.is_farm else "scenario seeds"
    console.print(f"evaluating on {what} {first}..{first + config.evaluation.farms - 1}, which training never saw ...")
    results = evaluate_all(config, path / POLICY, farms)
    metrics = read_metrics(path / METRICS)
    levels = {result.policy: result.total.reward for result in results if result.policy != TRAINED}
    curves(metrics, path / "curves.png", levels)
    pictures = ["curves.png"]
    if config.env.is_farm:
        policy = ActorPolicy(load_policy(path / POLICY)[0])
        trajectories(record(config.farm, policy, first, 0), path / "trajectories.png")
        pictures.append("trajectories.png")
    outcome = {
        "command": " ".join(command),
        "seed": config.seed,
        "seconds": metrics[-1]["time"] if metrics else 0.0,
        "evaluations": [result.to_dict() for result in results],
    }
    (path / "evaluation.json").write_text(json.dumps(outcome, indent=1) + "\n", encoding="utf-8")
    console.print(comparison_table(results))
    console.print(f"written to {path}: {', '.join(pictures)}, evaluation.json, {METRICS}, {POLICY}")


def evaluate_all(config: RunConfig, policy: Path, farms: Sequence[int]) -> list[Evaluation]:
    """Return the evaluations of a policy file and of every other policy there is on the same farms and episodes.

    The other policies are the heuristics; on environments other than the farm, random actions.
    """
    trained, episodes = ActorPolicy(load_policy(policy)[0]), config.evaluation.episodes
    results = [evaluate_run(config, trained, farms, episodes, name=TRAINED)]
    if not config.env.is_farm:
        return [*results, evaluate_run(config, RandomPolicy(), farms, episodes, name="random")]
    others = ((name, policy_of(name, config.farm)) for name in SHOWN)
    return results + [evaluate(config.farm, other, farms, episodes, name=name) for name, other in others]


def read_metrics(path: Path) -> list[dict[str, Any]]:
    """Return the records of metrics.jsonl.

    A line that was cut by a crash is left out, and so are records of what came after the checkpoint from which the run
    was resumed: it was lost and done again.
    """
    records: list[dict[str, Any]] = []
    for line in path.read_text(encoding="utf-8").splitlines():
        try:
            record = json.loads(line)
        except ValueError:
            continue
        if record["kind"] == "resume":
            records = [earlier for earlier in records if not _undone(earlier, record)]
        records.append(record)
    return records


def _undone(record: dict[str, Any], resume: dict[str, Any]) -> bool:
    if record["kind"] == "imitation":
        return bool(record["event"] > resume["events"])
    return any(record.get(name, 0) > resume[name] for name in ("episodes", "environment_steps", "updates"))
