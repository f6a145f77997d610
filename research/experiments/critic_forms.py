"""Readings A7 and A8 put to the test: the printed shared ensemble critic against the default, one change at a time.

    python -m research.experiments.critic_forms --episodes 160

Every form trains the same run (study preset, same seed, same farms, same noise) inside one process. Written to
research/results/critic_forms: forms.json with every curve, and forms.png.
"""

import json
import math
import os
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

import torch
import tyro
from matplotlib.figure import Figure

from eia_sec.common.config import RunConfig
from eia_sec.common.config.presets import PRESETS
from eia_sec.common.transitions import Chunk
from eia_sec.deploy.local.in_process import train_in_process
from eia_sec.deploy.reports.provenance import provenance
from eia_sec.learner.trainer import Trainer

PRINTED: Final = {"ensemble_loss": "mixture", "bootstrap": "local", "actor_objective": "local"}
FORMS: Final[dict[str, dict[str, Any]]] = {
    "default: member losses, mixture target, no copy": {},
    "no SEC": {"ensemble": False},
    "printed target, copy + gradient": {**PRINTED, "ensemble_copy_rate": 0.1},
    "printed target, copy only": {**PRINTED, "ensemble_copy_rate": 0.1, "ensemble_gradient": False},
    "printed, at the printed rates": {
        **PRINTED,
        "ensemble_copy_rate": 0.1,
        "actor_rate": 1e-4,
        "critic_rate": 1e-5,
    },
    "mixture target, mixture loss, copy + gradient": {"ensemble_loss": "mixture", "ensemble_copy_rate": 0.1},
    "default + copy at tau = 0.1": {"ensemble_copy_rate": 0.1},
}
DIVERGED: Final = 1e6
"""A critic loss beyond this, in units of scaled reward squared, counts as diverged; such a run is cut short."""
LARGEST: Final = 1e30
"""What a loss that is no longer a number is drawn as."""


@dataclass(frozen=True)
class Arguments:
    """Compare the forms of the shared ensemble critic."""

    episodes: int = 160
    """Training episodes of each form."""
    seeds: tuple[int, ...] = (0,)
    """Seeds of the runs."""
    processes: int = 2
    """Forms that train side by side, one thread each."""
    output: Path = Path("research/results/critic_forms")
    """Folder of the results."""
    forms: tuple[str, ...] = field(default_factory=lambda: tuple(FORMS))
    """The forms."""
    alone: bool = False
    """Train only the first form and seed, in this process, and print its curves."""


class DivergedError(Exception):
    """Ends a run whose critics have left all bounds."""


def train_form(name: str, seed: int, episodes: int) -> dict[str, Any]:
    """Train one form and return its curves."""
    torch.set_num_threads(1)
    base = PRESETS["study"]
    algorithm = replace(base.algorithm, **FORMS[name])
    config: RunConfig = replace(base, seed=seed, episodes=episodes, algorithm=algorithm)
    curve: list[dict[str, float]] = []

    def watch(trainer: Trainer, chunk: Chunk) -> None:
        if not chunk.episodes:
            return
        rewards = [sum(e.reward) / len(e.reward) for e in chunk.episodes]
        losses = [value for key, value in trainer.statistics().items() if key.startswith("critic_loss")]
        whole = all(math.isfinite(value) for value in losses)
        loss = max(losses, default=0.0) if whole else LARGEST
        curve.append({"episodes": trainer.episodes, "reward": sum(rewards) / len(rewards), "loss": min(loss, LARGEST)})
        if loss > DIVERGED:
            raise DivergedError

    started, diverged = time.monotonic(), False
    try:
        train_in_process(config, watch)
    except DivergedError:
        diverged = True
    return {"form": name, "seed": seed, "diverged": diverged, "seconds": time.monotonic() - started, "curve": curve}


def train_apart(name: str, seed: int, episodes: int) -> dict[str, Any]:
    """Train one form in a process of its own and return its curves."""
    options = ["--episodes", str(episodes), "--seeds", str(seed), "--forms", name, "--alone"]
    threads = {"OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"}
    done = subprocess.run(
        [sys.executable, "-m", "research.experiments.critic_forms", *options],
        stdout=subprocess.PIPE,
        env={**os.environ, **threads},
        check=True,
    )
    result: dict[str, Any] = json.loads(done.stdout)
    return result


def draw(results: list[dict[str, Any]], path: Path) -> None:
    """Draw reward and critic loss of every form against episodes."""
    figure = Figure(figsize=(9.0, 7.0), layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True)
    colours = ("#000000", "#0072B2", "#D55E00", "#E69F00", "#CC79A7", "#009E73", "#56B4E9", "#F0E442")
    names = list(dict.fromkeys(result["form"] for result in results))
    for result in results:
        index = names.index(result["form"])
        style = {"color": colours[index % len(colours)], "linewidth": 2.4 if index == 0 else 1.4}
        episodes = [point["episodes"] for point in result["curve"]]
        end = " (diverged)" if result["diverged"] else ""
        upper.plot(episodes, [p["reward"] for p in result["curve"]], label=result["form"] + end, **style)
        learnt = [point for point in result["curve"] if point["loss"] > 0]
        lower.plot([point["episodes"] for point in learnt], [point["loss"] for point in learnt], **style)
        if result["diverged"] and episodes:
            lower.plot(episodes[-1:], [min(result["curve"][-1]["loss"], 1e12)], "x", color=style["color"], markersize=9)
    lower.set_yscale("log")
    upper.set_ylabel("training reward per agent")
    lower.set_ylabel("critic loss")
    lower.set_xlabel("episodes")
    figure.legend(*upper.get_legend_handles_labels(), loc="outside lower center", ncols=2, fontsize=8)
    for axes in (upper, lower):
        axes.grid(alpha=0.25)
    figure.savefig(path, dpi=150)


def main() -> None:
    """Train all forms and write what came of it."""
    arguments = tyro.cli(Arguments, prog="python -m research.experiments.critic_forms")
    jobs = [(name, seed, arguments.episodes) for seed in arguments.seeds for name in arguments.forms]
    if arguments.alone:
        sys.stdout.write(json.dumps(train_form(*jobs[0])))
        return
    with ThreadPoolExecutor(arguments.processes) as pool:
        results = list(pool.map(lambda job: train_apart(*job), jobs))
    arguments.output.mkdir(parents=True, exist_ok=True)
    data = {**provenance("research.experiments.critic_forms"), "results": results}
    (arguments.output / "forms.json").write_text(json.dumps(data) + "\n", encoding="utf-8")
    draw(results, arguments.output / "forms.png")


if __name__ == "__main__":
    main()
