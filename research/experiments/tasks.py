"""Environments of other people, trained by the distributed system as it is: curves over several seeds.

    python -m research.experiments.tasks simple_spread --seeds 3
    python -m research.experiments.tasks half_cheetah --seeds 2

Each seed is one `eia-sec train`: learner, coordinator and worker as processes. Written to research/results/tasks/TASK:
results.json, curves.png and config.toml.
"""

import json
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import tyro
from matplotlib.figure import Figure

from eia_sec.deploy.local.run_directory import CONFIG, METRICS
from eia_sec.deploy.reports.plots import DPI, OTHER_COLOURS, smooth
from eia_sec.deploy.reports.provenance import provenance
from eia_sec.deploy.reports.run_report import read_metrics

POINTS: Final = 200
"""Points of a curve that are kept."""


@dataclass(frozen=True)
class Task:
    """One environment and the settings that it is trained with.

    Attributes:
        title: what it is, for the picture.
        options: the options of `eia-sec train`.
    """

    title: str
    options: tuple[str, ...]


TASKS: Final = {
    "simple_spread": Task(
        "MPE2 simple_spread_v3: three agents cover three landmarks",
        (
            *("--preset", "eia-sec", "--env", "mpe2:simple_spread_v3", "--episodes", "4500", "--elite.cycle", "250"),
            *("--algorithm.discount", "0.95", "--algorithm.reward-scale", "0.3", "--algorithm.actor-rate", "5e-4"),
            *("--replay.updates-per-step", "0.5", "--replay.warmup-steps", "4000"),
            *("--exploration.noise-std-start", "0.3", "--rollout.chunk-steps", "25", "--evaluation.farms", "200"),
        ),
    ),
    "half_cheetah": Task(
        "MaMuJoCo HalfCheetah 2x3: two agents of three joints each",
        (
            *("--preset", "eia-sec", "--env", "gymnasium_robotics:mamujoco_v1"),
            *("--episodes", "100", "--elite.cycle", "25"),
            *("--env.arguments", '{"scenario": "HalfCheetah", "agent_conf": "2x3"}'),
            *("--algorithm.hidden", "128", "--algorithm.discount", "0.99", "--algorithm.actor-rate", "3e-4"),
            *("--replay.updates-per-step", "0.5", "--replay.capacity", "262144", "--exploration.noise-std-end", "0.1"),
            *("--rollout.chunk-steps", "50", "--evaluation.farms", "20"),
        ),
    ),
}


@dataclass(frozen=True)
class Arguments:
    """Train a task with several seeds."""

    task: tyro.conf.Positional[str]
    """simple_spread or half_cheetah."""
    seeds: int = 3
    """Seeds, from 0 on."""
    output: Path = Path("research/results/tasks")
    """Folder under which the task's own folder is made."""


def train(task: Task, seed: int, folder: Path) -> dict[str, Any]:
    """Train one seed in a folder; return its evaluations and its curve."""
    command = [
        sys.executable,
        "-m",
        "eia_sec.deploy.cli",
        "train",
        *task.options,
        "--seed",
        str(seed),
        "--run-dir",
        str(folder),
    ]
    subprocess.run(command, check=True)
    outcome = json.loads((folder / "evaluation.json").read_text(encoding="utf-8"))
    records = [record for record in read_metrics(folder / METRICS) if record["kind"] == "episodes"]
    reward = smooth(np.array([record["reward"]["mean"] for record in records]))
    steps = np.array([record["environment_steps"] for record in records])
    kept = np.unique(np.linspace(0, len(records) - 1, POINTS).astype(int))
    return {
        "seed": seed,
        "seconds": outcome["seconds"],
        "evaluations": [{k: v for k, v in e.items() if k != "per_farm"} for e in outcome["evaluations"]],
        "curve": {"environment_steps": steps[kept].tolist(), "reward": reward[kept].round(3).tolist()},
    }


def picture(task: Task, results: list[dict[str, Any]]) -> Figure:
    """Return training reward against environment steps: every seed, their mean, and what random actions earn."""
    figure = Figure(figsize=(7.2, 4.0), layout="constrained")
    axes = figure.subplots()
    end = min(result["curve"]["environment_steps"][-1] for result in results)
    grid = np.linspace(min(result["curve"]["environment_steps"][0] for result in results), end, POINTS)
    curves = [np.interp(grid, r["curve"]["environment_steps"], r["curve"]["reward"]) for r in results]
    for curve in curves:
        axes.plot(grid, curve, color=OTHER_COLOURS[0], alpha=0.35, linewidth=1.0)
    axes.plot(
        grid, np.mean(curves, axis=0), color=OTHER_COLOURS[0], linewidth=2.2, label=f"mean of {len(curves)} seeds"
    )
    finals = [[e["reward"]["mean"] for e in r["evaluations"]] for r in results]
    trained, chance = np.mean(finals, axis=0)
    axes.axhline(trained, color=OTHER_COLOURS[2], linestyle="-.", label="trained, without noise, unseen scenarios")
    axes.axhline(chance, color="0.4", linestyle="--", label="random actions")
    axes.set(xlabel="environment steps", ylabel="reward of an episode, per agent", title=task.title)
    axes.grid(True, color="0.9")
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(frameon=False, fontsize=9, loc="lower right")
    return figure


def main() -> None:
    """Train, and write data and picture."""
    arguments = tyro.cli(Arguments, prog="python -m research.experiments.tasks")
    if arguments.task not in TASKS:
        sys.exit(f"there is no task {arguments.task!r}; the tasks are {', '.join(TASKS)}.")
    task, output = TASKS[arguments.task], arguments.output / arguments.task
    output.mkdir(parents=True, exist_ok=True)
    record, results = provenance("research.experiments.tasks"), []
    with tempfile.TemporaryDirectory() as scratch:
        for seed in range(arguments.seeds):
            folder = Path(scratch) / str(seed)
            results.append(train(task, seed, folder))
            shutil.copyfile(folder / CONFIG, output / CONFIG)
            trained = " ".join(["eia-sec", "train", *task.options])
            data = {**record, "task": arguments.task, "train": trained, "results": results}
            (output / "results.json").write_text(json.dumps(data) + "\n", encoding="utf-8")
            picture(task, results).savefig(output / "curves.png", dpi=DPI)


if __name__ == "__main__":
    main()
