"""Readings A7 and A8 put to the test: the printed shared ensemble critic against the default, one change at a time.

    python -m research.experiments.critic_forms --episodes 160

Every form trains the same run (study preset, same seed, same farms, same noise) inside one process. Written to
research/results/critic_forms: forms.json with every curve, and forms.png. `--redraw` makes the picture anew from
forms.json.
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
from eia_sec.deploy.reports.plots import DPI, bare, look
from eia_sec.deploy.reports.provenance import provenance
from eia_sec.learner.trainer import Trainer
from research.looks import WIDTH, heading, legend_below

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
    redraw: bool = False
    """Draw the picture from the results that are there, and train nothing."""
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


def figure(results: list[dict[str, Any]]) -> Figure:
    """Return the picture of every form's reward, whole and enlarged, and critic loss against episodes."""
    drawn = Figure(figsize=(WIDTH, 8.4), layout="constrained")
    whole, enlarged, lower = drawn.subplots(3, 1, sharex=True, height_ratios=(1.0, 1.3, 1.0))
    names = list(dict.fromkeys(result["form"] for result in results))
    for result in results:
        index = names.index(result["form"])
        # Curves that coincide show their marks by turns.
        style: dict[str, Any] = look(index) | {"markersize": 5, "markevery": (index % 2, 2)}
        episodes, rewards = zip(*((point["episodes"], point["reward"]) for point in result["curve"]), strict=True)
        label = result["form"] + (" (diverged)" if result["diverged"] else "")
        for axes in (whole, enlarged):
            axes.plot(episodes, rewards, label=label, **style)
        learnt = [point for point in result["curve"] if point["loss"] > 0]
        lower.plot([point["episodes"] for point in learnt], [min(point["loss"], 1e12) for point in learnt], **style)
    enlarged.set_ylim(0.0, 1.05 * max(point["reward"] for result in results for point in result["curve"]))
    lower.set_yscale("log")
    whole.set_title("reward, from the first episode on", loc="left", fontsize=10)
    enlarged.set_title("reward, enlarged above 0", loc="left", fontsize=10)
    lower.set_title("critic loss, the largest of all agents", loc="left", fontsize=10)
    for axes in (whole, enlarged):
        axes.set_ylabel("reward per agent\nand episode")
    lower.set_ylabel("scaled reward squared,\nlogarithmic")
    lower.set_xlabel("training episodes")
    for axes in (whole, enlarged, lower):
        bare(axes)
    legend_below(drawn, [whole], 2)
    seeds = ", ".join(str(seed) for seed in dict.fromkeys(result["seed"] for result in results))
    heading(drawn, f"Forms of the shared ensemble critic: preset study, seed {seeds}, while training, with noise.")
    return drawn


def main() -> None:
    """Train all forms and write what came of it."""
    arguments = tyro.cli(Arguments, prog="python -m research.experiments.critic_forms")
    jobs = [(name, seed, arguments.episodes) for seed in arguments.seeds for name in arguments.forms]
    if arguments.alone:
        sys.stdout.write(json.dumps(train_form(*jobs[0])))
        return
    path = arguments.output / "forms.json"
    if not arguments.redraw:
        with ThreadPoolExecutor(arguments.processes) as pool:
            results = list(pool.map(lambda job: train_apart(*job), jobs))
        arguments.output.mkdir(parents=True, exist_ok=True)
        data = {**provenance("research.experiments.critic_forms"), "results": results}
        path.write_text(json.dumps(data) + "\n", encoding="utf-8")
    results = json.loads(path.read_text(encoding="utf-8"))["results"]
    figure(results).savefig(arguments.output / "forms.png", dpi=DPI)


if __name__ == "__main__":
    main()
