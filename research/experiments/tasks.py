"""Environments of other people, trained by the distributed system as it is: curves over several seeds.

    python -m research.experiments.tasks simple_spread --seeds 3
    python -m research.experiments.tasks half_cheetah --seeds 2

Each seed is one `eia-sec train`: learner, coordinator and worker as processes. Written to research/results/tasks/TASK:
results.json, curves.png and config.toml. `--redraw` makes the picture anew from results.json.
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
from matplotlib.ticker import EngFormatter

from eia_sec.deploy.local.run_directory import CONFIG, METRICS
from eia_sec.deploy.reports.plots import DPI, bare, smooth
from eia_sec.deploy.reports.provenance import provenance
from eia_sec.deploy.reports.run_report import read_metrics
from research.looks import LEVEL, WIDTH, algorithm_look, heading, legend_below, numbered_looks

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
    redraw: bool = False
    """Draw the picture from the results that are there, and train nothing."""


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
    """Return training reward against environment steps: the mean, and every seed in a panel of its own if several."""
    several = len(results) > 1
    figure = Figure(figsize=(WIDTH, 3.9), layout="constrained")
    panels = figure.subplots(1, 1 + several, sharey=True, squeeze=False)[0]
    end = min(result["curve"]["environment_steps"][-1] for result in results)
    grid = np.linspace(min(result["curve"]["environment_steps"][0] for result in results), end, POINTS)
    curves = [np.interp(grid, r["curve"]["environment_steps"], r["curve"]["reward"]) for r in results]
    colour = algorithm_look("eia-sec")["color"]
    panels[0].plot(grid, np.mean(curves, axis=0), color=colour, linewidth=2.0, label="training, with noise")
    panels[0].set_title(f"mean of {len(results)} seeds" if several else f"seed {results[0]['seed']}", fontsize=10)
    if several:
        panels[1].set_title("each seed", fontsize=10)
        for curve, result, style in zip(curves, results, numbered_looks(len(results)), strict=True):
            panels[1].plot(grid, curve, linewidth=1.4, label=f"training, seed {result['seed']}", **style)
    finals = [[e["reward"]["mean"] for e in r["evaluations"]] for r in results]
    trained, chance = np.mean(finals, axis=0)
    panels[0].axhline(
        trained, color=colour, linestyle="-.", linewidth=1.4, label="trained: without noise, unseen scenarios"
    )
    panels[0].axhline(chance, label="random actions", **LEVEL)
    for axes in panels:
        axes.set_xlabel("environment steps")
        axes.xaxis.set_major_formatter(EngFormatter(sep=""))
        bare(axes)
    panels[0].set_ylabel("reward per agent and episode")
    legend_below(figure, panels, 2 if several else 3)
    heading(figure, f"EIA-SEC on {task.title}")
    return figure


def main() -> None:
    """Train, and write data and picture."""
    arguments = tyro.cli(Arguments, prog="python -m research.experiments.tasks")
    if arguments.task not in TASKS:
        sys.exit(f"there is no task {arguments.task!r}; the tasks are {', '.join(TASKS)}.")
    task, output = TASKS[arguments.task], arguments.output / arguments.task
    if arguments.redraw:
        data = json.loads((output / "results.json").read_text(encoding="utf-8"))
        picture(task, data["results"]).savefig(output / "curves.png", dpi=DPI)
        return
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
