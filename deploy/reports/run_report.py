"""The report of a finished run: curves.png, trajectories.png, evaluation.json and a table on unseen farms."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich.console import Console

from eia_sec.common.config import RunConfig
from eia_sec.common.farm import farm_of
from eia_sec.common.policy_file import load_policy
from eia_sec.deploy.local.run_directory import METRICS, POLICY, RunDirectory
from eia_sec.deploy.reports.comparison_tables import comparison_table
from eia_sec.deploy.reports.plots import curves, trajectories
from eia_sec.rollout.evaluation import Evaluation, evaluate_run, record
from eia_sec.rollout.policies import ActorPolicy, SampledPolicy, reference_policies, run_policy

TRAINED = "this run"


def write_report(directory: RunDirectory, config: RunConfig, command: Sequence[str], console: Console) -> None:
    """Evaluate the run's policy and some heuristics on farms that training never saw, and draw plots.

    Args:
        directory: the run directory, which holds metrics.jsonl and policy.safetensors.
        config: the run.
        command: the command line of the run, for the record.
        console: prints the table.
    """
    path = directory.path
    first = config.evaluation.first_farm
    farms = range(first, first + config.evaluation.farms)
    farm = farm_of(config)
    scenarios = "scenario seeds" if farm is None else "farms"
    console.print(
        f"evaluating on {scenarios} {first}..{first + config.evaluation.farms - 1}, which training never saw ..."
    )
    results = evaluate_all(config, path / POLICY, farms)
    metrics = read_metrics(path / METRICS)
    references = reference_policies(config)
    levels = {result.policy: result.total.reward for result in results if result.policy in references}
    curves(metrics, path / "curves.png", levels, results[0].environment.episode_metrics)
    pictures = ["curves.png"]
    if farm is not None:
        policy = ActorPolicy(load_policy(path / POLICY)[0])
        trajectories(record(farm, policy, first, 0), path / "trajectories.png")
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
    """Return the evaluations of a policy file and of the environment's reference policies on the same episodes."""
    actors, episodes = load_policy(policy)[0], config.evaluation.episodes
    drawn = {f"{TRAINED}, sampled": SampledPolicy(actors)} if actors.draws and farm_of(config) is None else {}
    policies = {TRAINED: ActorPolicy(actors), **drawn} | {
        name: run_policy(name, config) for name in reference_policies(config)
    }
    return [evaluate_run(config, flown, farms, episodes, name=name) for name, flown in policies.items()]


def read_metrics(path: Path) -> list[dict[str, Any]]:
    """Return the records of metrics.jsonl.

    Lines that a crash cut short are left out. So are records after the checkpoint of a resume, because that part of the
    run was repeated.
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
