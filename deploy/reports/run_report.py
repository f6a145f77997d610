"""The report of a finished run: curves.png, trajectories.png, evaluation.json and a table on unseen farms."""

import json
import shlex
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

from rich.console import Console

from eia_sec.common.config import RunConfig
from eia_sec.common.errors import UsageError
from eia_sec.common.farm import farm_of
from eia_sec.common.policy_file import POLICY, UNTRAINED, load_policy
from eia_sec.common.protocol.metrics import scalars
from eia_sec.deploy.local.code_options import code_options
from eia_sec.deploy.local.run_directory import METRICS, RunDirectory
from eia_sec.deploy.program import program
from eia_sec.deploy.progress import part, progress
from eia_sec.deploy.reports.comparison_tables import comparison_table, counted, scenario_word
from eia_sec.deploy.reports.film import find_ffmpeg
from eia_sec.deploy.reports.plots import curves, trajectories
from eia_sec.learner.process.tensorboard import TensorBoardWriter
from eia_sec.rollout.evaluation import Evaluation, evaluate_run, record
from eia_sec.rollout.policies import ActorPolicy, BatchPolicy, SampledPolicy, reference_policies, run_policy
from eia_sec.rollout.shipped_policies import is_file

TRAINED: Final = "this run"
BEGINNINGS: Final = ("untrained", "at the beginning")
"""What the actors are called with which a run began: fresh ones, and those of a policy or of demonstrations."""
SAMPLED: Final = ", sampled"


def write_report(
    directory: RunDirectory, config: RunConfig, command: Sequence[str], console: Console
) -> dict[str, float]:
    """Evaluate the run's policy and some others on farms that training never saw, draw plots, and say what comes next.

    Args:
        directory: the run directory, which holds metrics.jsonl and policy.safetensors.
        config: the run.
        command: the command line of the run, for the record.
        console: prints the table.

    Returns:
        The evaluation of the run's policy, by the names of scalars.
    """
    path = directory.path
    farms = config.unseen(config.evaluation.farms)
    farm, word = farm_of(config), scenario_word(config)
    console.print(f"evaluating on {counted(len(farms), word)} that training never saw ...", highlight=False)
    results = evaluate_all(config, path, farms)
    metrics = read_metrics(path / METRICS)
    references = reference_policies(config)
    title = f"{path.name}: {config.algorithm.name}, seed {config.seed}"
    levels = {result.policy: result.total.reward for result in results if result.policy in references}
    console.print("drawing pictures ...", highlight=False)
    curves(metrics, path / "curves.png", levels, results[0].environment.episode_metrics, title)
    pictures = ["curves.png"]
    if farm is not None:
        policy = ActorPolicy(load_policy(path / POLICY)[0])
        trajectories(record(farm, policy, farms.start, 0), path / "trajectories.png", title)
        pictures.append("trajectories.png")
    outcome = {
        "command": " ".join(command),
        "seed": config.seed,
        "seconds": metrics[-1]["time"] if metrics else 0.0,
        "evaluations": [result.to_dict() for result in results],
    }
    (path / "evaluation.json").write_text(json.dumps(outcome, indent=1) + "\n", encoding="utf-8")
    found, written = evaluation_scalars(results[0]), TensorBoardWriter(path)
    steps = (record["environment_steps"] for record in reversed(metrics) if "environment_steps" in record)
    written.write(next(steps, 0), found)
    written.close()
    console.print(comparison_table(shown(results, references), word), highlight=False)
    if len(references) > 1:
        console.print(f"heuristics: {', '.join(references)}", highlight=False)
    console.print(f"written to {path}: {', '.join(pictures)}, evaluation.json, {METRICS}, {POLICY}", soft_wrap=True)
    console.print("\n".join(["next:", *next_commands(path, config)]), highlight=False, markup=False, soft_wrap=True)
    return found


def evaluate_all(config: RunConfig, folder: Path, farms: Sequence[int]) -> list[Evaluation]:
    """Return evaluations on the same episodes: of the run's policy, of what it began as, and of the references.

    Outside the farm, policies with a distribution are evaluated by drawn actions, too.
    """
    policies: dict[str, BatchPolicy[Any]] = {}
    begun = config.learns_on_policy and bool(config.on_policy.start_policy)
    files = {TRAINED: POLICY}
    if is_file(folder / UNTRAINED):  # a full disk may have kept it away
        files[BEGINNINGS[begun]] = UNTRAINED
    for name, file in files.items():
        actors = load_policy(folder / file)[0]
        policies[name] = ActorPolicy(actors)
        if actors.draws and farm_of(config) is None:
            policies[f"{name}{SAMPLED}"] = SampledPolicy(actors)
    policies |= {name: run_policy(name, config) for name in reference_policies(config)}
    with progress("evaluating") as tell:
        return [
            evaluate_run(config, flown, farms, 1, name=name, tell=part(tell, done, len(policies)))
            for done, (name, flown) in enumerate(policies.items())
        ]


def shown(results: Sequence[Evaluation], references: Sequence[str]) -> list[Evaluation]:
    """Return the columns of the table: before training, after it, and the best reference."""
    order = [f"{name}{drawn}" for name in (*BEGINNINGS, TRAINED) for drawn in ("", SAMPLED)]
    own = sorted((one for one in results if one.policy in order), key=lambda one: order.index(one.policy))
    best = max((one for one in results if one.policy in references), key=lambda one: one.total.reward)
    heading = f"best of {len(references)} heuristics:\n{best.policy}"
    named = replace(best, policy="random actions" if len(references) == 1 else heading)
    return [*(replace(one, policy=one.policy.replace(TRAINED, "trained")) for one in own), named]


def next_commands(path: Path, config: RunConfig) -> list[str]:
    """Return what to type after a run, each with what it is for."""
    run, code = shlex.quote(str(path)), " ".join(shlex.quote(word) for word in code_options(config))
    end, called = f" {code}" if code else "", shlex.quote(program())
    found = [(f"{called} evaluate --run-dir {run}{end}", f"on more {scenario_word(config)}s: --farms 1000:1100")]
    if farm_of(config) is not None:
        try:
            find_ffmpeg()
            found.insert(0, (f"{called} replay {run}{end}", "a film, in about a minute of processor time"))
        except UsageError:
            found.insert(0, (f"{called} replay {run}{end} --film none", "a picture of all paths"))
    width = max(len(typed) for typed, _ in found)
    return [f"  {typed:<{width}}   # {why}" for typed, why in found]


def evaluation_scalars(evaluation: Evaluation) -> dict[str, float]:
    """Return an evaluation by the names of scalars."""
    total, types = evaluation.total, evaluation.environment.team.types
    named = {"reward": total.reward, "types": total.types, "steps": total.steps}
    return scalars({"evaluation": {**total.metrics, **named}}, types)


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
