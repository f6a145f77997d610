"""What MADDPG and MATD3 reach on simple_spread: ours, run as the distributed system, beside AgileRL and BenchMARL.

    python -m research.benchmarks.peers.learning [--write research/results/spread [--redraw]] [--seeds 5] [--json]

Every program gets the same environment (mpe2 simple_spread_v3, three agents), environment steps, updates, batch,
width, discount, target rate and exploration noise, and the same tuning: the learning rate of actors and critics is the
best of RATES on a seed that is not used again; when it stands at an end of them, the next one there is tried too. What
FOLDER/results.json already holds is not run again. Environments of the peers are those of `make bench-peers`.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import EngFormatter
from scipy.stats import bootstrap

from eia_sec.common.errors import EiaSecError
from eia_sec.common.seeds import derive
from eia_sec.deploy.local.run_directory import METRICS
from eia_sec.deploy.local.threads import thread_environment
from eia_sec.deploy.reports.plots import DPI, bare
from eia_sec.deploy.reports.provenance import provenance
from eia_sec.deploy.reports.run_report import read_metrics
from eia_sec.rollout.evaluation import episode_seed
from research.benchmarks.peers.catalogue import ROOT, Program
from research.benchmarks.peers.report import table
from research.benchmarks.peers.spread import EPISODE_STEPS, NOISE, curve
from research.benchmarks.peers.venvs import interpreter, provide
from research.looks import WIDTH, heading, legend_below, program_look

RATES: Final = (5e-4, 1e-3, 2e-3)
"""Learning rates that are tried for every program at first."""
FURTHER: Final = 2
"""Rates beyond RATES that are tried at most: half the smallest or twice the largest, while that end is the best."""
TUNING_SEED: Final = 100
SCENARIOS: Final = 200
PEERS: Final = (
    (Program("learner", "AgileRL", "research.benchmarks.peers.scripts.learn_agilerl", "agilerl"), ("matd3",)),
    (Program("learner", "BenchMARL", "research.benchmarks.peers.scripts.learn_benchmarl", "benchmarl"), ("maddpg",)),
)
OURS: Final = {"EIA-SEC": (), "EIA-SEC, team": ("--algorithm.others", "team")}
"""Options of our lines: as published, where each actor maximises its own critic and the others act as in the batch, and
where all actors maximise the sum of all critics, which is how BenchMARL has it."""
Line = dict[str, Any]


@dataclass(frozen=True)
class Budget:
    """What every program gets.

    Attributes:
        steps: environment steps; of ours a multiple of a chunk's, which are 8 episodes.
        every: environment steps for each update.
        warmup: environment steps of random actions at first.
    """

    steps: int
    every: int
    warmup: int


@dataclass(frozen=True)
class Case:
    """One training."""

    software: str
    algorithm: str
    rate: float
    seed: int


def scenarios() -> list[int]:
    """Return the environment seeds of the evaluation: those that our evaluation uses on farms 1000..."""
    return [derive(farm, episode_seed(farm, 0), "reset") % 2**31 for farm in range(1000, 1000 + SCENARIOS)]


def options_of_ours(case: Case, budget: Budget) -> list[str]:
    """Return the command line of `eia-sec` for a case."""
    return [
        *("train", "--preset", "eia-sec", "--algorithm", case.algorithm, "--env", "mpe2:simple_spread_v3"),
        *("--episodes", str(budget.steps // EPISODE_STEPS), "--seed", str(case.seed)),
        *("--replay.updates-per-step", str(1.0 / budget.every), "--replay.warmup-steps", str(budget.warmup)),
        *("--algorithm.actor-rate", str(case.rate), "--algorithm.critic-rate", str(case.rate)),
        *("--algorithm.discount", "0.95", "--algorithm.target-rate", "0.005", "--algorithm.reward-scale", "1.0"),
        *("--exploration.noise-std-start", str(NOISE), "--exploration.noise-std-end", str(NOISE)),
        *("--rollout.chunk-steps", str(EPISODE_STEPS), "--evaluation.farms", str(SCENARIOS)),
        *OURS[case.software],
    ]


def run_ours(case: Case, budget: Budget) -> Line:
    """Train with learner, coordinator and worker as processes of their own."""
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch) / "run"
        command = [sys.executable, "-m", "eia_sec.deploy.cli", *options_of_ours(case, budget), "--run-dir", str(folder)]
        done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
        if done.returncode:
            raise EiaSecError(f"eia-sec train failed: {done.stderr.strip().rpartition(chr(10))[2]}")
        outcome = json.loads((folder / "evaluation.json").read_text(encoding="utf-8"))
        metrics = read_metrics(folder / METRICS)
    found = outcome["evaluations"][0]
    if len(found["farms"]) != SCENARIOS:
        raise EiaSecError(f"our run was evaluated on {len(found['farms'])} scenarios, not {SCENARIOS}.")
    updates = [line["updates"] for line in metrics if line["kind"] == "status"][-1]
    if updates != updates_of(budget):
        raise EiaSecError(f"our run did {updates} updates, not {updates_of(budget)}.")
    # What was under way at the end is taken in and counted, and no update sees it.
    flown = each_episode([line for line in metrics if line["kind"] == "episodes"])[: budget.steps // EPISODE_STEPS]
    result = {"reward": found["reward"]["mean"], "seconds": outcome["seconds"], "updates": updates}
    return {**result, "curve": curve(flown)}


def updates_of(budget: Budget) -> int:
    """Return the updates of all agents that a budget gives."""
    return (budget.steps - budget.warmup) // budget.every


def each_episode(records: Sequence[Line]) -> list[float]:
    """Return a reward for every episode of a run of ours, whose records hold the mean of those that ended together."""
    counts = np.diff([0, *(record["episodes"] for record in records)])
    rewards: list[float] = np.repeat([record["reward"]["mean"] for record in records], counts).tolist()
    return rewards


def run_peer(program: Program, case: Case, budget: Budget, venvs: Path) -> Line:
    """Train with a peer in its own environment; raise EiaSecError if it fails."""
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    environment |= thread_environment(1)
    asked = {**vars(case), **vars(budget)}
    del asked["software"]
    command = [str(interpreter(program, venvs)), "-m", program.module]
    command += [text for name, value in asked.items() for text in (f"--{name}", str(value))]
    command += ["--scenarios", *map(str, scenarios())]
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    if done.returncode:
        raise EiaSecError(f"{program.module} failed: {done.stderr.strip().rpartition(chr(10))[2]}")
    result = json.loads(done.stdout.strip().rpartition("\n")[2])
    line: Line = {**result["lines"][0], "versions": result["versions"]}
    return line


class Session:
    """Cases, run at most once each.

    Args:
        budget: what every program gets.
        venvs: where the peers' environments lie.
        path: the file that holds what was run, if any.
    """

    def __init__(self, budget: Budget, venvs: Path, path: Path | None) -> None:
        self.budget, self.venvs, self.path = budget, venvs, path
        # Of the start: what is written on the way changes the tree.
        self.origin = provenance("research.benchmarks.peers.learning")
        self.runs: list[Line] = []
        self._others: list[Line] = []
        if path is not None and path.is_file():
            for run in json.loads(path.read_text(encoding="utf-8"))["runs"]:
                (self.runs if run["budget"] == vars(budget) else self._others).append(run)

    def run(self, case: Case, program: Program | None) -> float:
        """Return the reward that a case reaches."""
        for line in self.runs:
            if all(line[name] == value for name, value in vars(case).items()):
                return float(line["reward"])
        sys.stderr.write(f"{case.software} {case.algorithm}, rate {case.rate}, seed {case.seed}\n")
        found = run_ours(case, self.budget) if program is None else run_peer(program, case, self.budget, self.venvs)
        kept = {"commit": self.origin["commit"], "budget": vars(self.budget), "same_scenarios": True}
        self.runs.append({**vars(case), **found, **kept})
        self.save()
        return float(found["reward"])

    def save(self) -> None:
        """Write what was run so far."""
        if self.path is not None:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            data = {**self.origin, "runs": [*self._others, *self.runs]}
            self.path.write_text(json.dumps(data) + "\n", encoding="utf-8")

    def compare(self, software: str, algorithm: str, program: Program | None, seeds: int) -> None:
        """Tune a program's rate, and train it with that rate."""
        rate = tuned(lambda candidate: self.run(Case(software, algorithm, candidate, TUNING_SEED), program))
        for seed in range(seeds):
            self.run(Case(software, algorithm, rate, seed), program)


def tuned(reward: Callable[[float], float]) -> float:
    """Return the rate with the best reward; the grid grows by at most FURTHER rates at an end that is the best."""
    tried = {rate: reward(rate) for rate in RATES}
    for _ in range(FURTHER):
        best = max(tried, key=lambda rate: tried[rate])
        if best not in (min(tried), max(tried)):
            break
        further = best / 2 if best == min(tried) else best * 2
        tried[further] = reward(further)
    return max(tried, key=lambda rate: tried[rate])


def reported(runs: Sequence[Line], software: str, algorithm: str) -> list[Line]:
    """Return the runs of a program with the rate that it was tuned to, without those that tuned it."""
    mine = [run for run in runs if (run["software"], run["algorithm"]) == (software, algorithm)]
    tuning = [run for run in mine if run["seed"] == TUNING_SEED]
    rate = max(tuning, key=lambda run: float(run["reward"]), default={"rate": None})["rate"]
    return [run for run in mine if run["seed"] != TUNING_SEED and run["rate"] == rate]


def summary(runs: Sequence[Line]) -> list[Line]:
    """Return mean and 95 % bootstrap interval over the seeds of every program and algorithm, best first."""
    found = []
    for name in dict.fromkeys((run["software"], run["algorithm"]) for run in runs):
        mine = reported(runs, *name)
        rewards = np.array([run["reward"] for run in mine])
        if len(rewards) < 2:
            continue
        interval = bootstrap((rewards,), np.mean, rng=np.random.default_rng(0)).confidence_interval
        found.append(
            {
                **{"software": name[0], "algorithm": name[1], "rate": mine[0]["rate"], "seeds": len(mine)},
                **{"reward": float(rewards.mean()), "low": float(interval.low), "high": float(interval.high)},
                "minutes": float(np.median([run["seconds"] for run in mine])) / 60,
            }
        )
    return sorted(found, key=lambda line: (line["algorithm"], -line["reward"]))


def page(runs: Sequence[Line]) -> str:
    """Return the results as Markdown."""
    rows = [
        [
            *(line["algorithm"].upper(), line["software"], f"{line['rate']:g}", str(line["seeds"])),
            *(f"{line['reward']:.2f}", f"{line['low']:.2f} to {line['high']:.2f}", f"{line['minutes']:.1f}"),
        ]
        for line in summary(runs)
    ]
    head = ["algorithm", "program", "rate", "seeds", "reward", "95 % interval", "minutes a seed"]
    budget, rates = Budget(**runs[0]["budget"]), ", ".join(f"{rate:g}" for rate in RATES)
    setting = (
        f"{budget.steps:,} environment steps and {updates_of(budget):,} updates of all agents, one for each\n"
        f"{budget.every} steps after {budget.warmup:,} steps of random actions. Reward of an episode without noise,\n"
        f"mean over agents and {SCENARIOS} unseen scenarios, then over seeds. The rate is the best of {rates}\n"
        "on another seed; when that was the smallest or largest, its half or double was tried too, "
        f"{FURTHER} times at most.\n"
        "`EIA-SEC` has the published form, in which each actor maximises its own critic; `EIA-SEC, team` is\n"
        "`--algorithm.others team`, in which all maximise the sum of all critics, as in BenchMARL.\n"
        "Episodes that ours has under way when its last update is done are trained on by none and left out.\n"
        "Minutes are of one seed on cores shared with other work; ours runs learner and worker side by side.\n"
    )
    if not all(run.get("same_scenarios") for run in runs):
        setting += "The scenarios of ours and of the peers differ here, so a small difference means nothing.\n"
    return "\n".join(
        ["# simple_spread beside other projects", "", setting, *table(head, rows, 3), "", "![Curves](curves.png)", ""]
    )


def picture(runs: Sequence[Line]) -> Figure:
    """Return training reward, with exploration noise, against environment steps: mean over seeds and their range."""
    figure = Figure(figsize=(WIDTH, 4.1), layout="constrained")
    algorithms = sorted({run["algorithm"] for run in runs})
    panels = figure.subplots(1, len(algorithms), sharey=True, squeeze=False)[0]
    counts = set()
    for axes, algorithm in zip(panels, algorithms, strict=True):
        for software in (*OURS, *(program.name for program, _ in PEERS)):
            mine = [run["curve"] for run in reported(runs, software, algorithm)]
            if not mine:
                continue
            counts.add(len(mine))
            grid, style = np.array(mine[0]["environment_steps"]), program_look(software)
            values = np.array([np.interp(grid, c["environment_steps"], c["reward"]) for c in mine])
            axes.plot(grid, values.mean(0), label=software, markersize=4.5, markevery=5, **style)
            axes.fill_between(grid, values.min(0), values.max(0), color=style["color"], alpha=0.15, linewidth=0)
        axes.set_xlabel("environment steps")
        axes.set_title(algorithm.upper(), fontsize=10)
        axes.xaxis.set_major_formatter(EngFormatter(sep=""))
        bare(axes)
    panels[0].set_ylabel("reward per agent and episode")
    legend_below(figure, panels, 4)
    seeds = " or ".join(str(count) for count in sorted(counts))
    heading(figure, f"MPE's simple_spread, while training, with noise. Line: mean of {seeds} seeds; band: their range.")
    return figure


def show(runs: Sequence[Line], folder: Path) -> None:
    """Write page and picture."""
    (folder / "README.md").write_text(page(runs), encoding="utf-8")
    picture(runs).savefig(folder / "curves.png", dpi=DPI)


def options() -> argparse.Namespace:
    """Return the command line."""
    parser = argparse.ArgumentParser(
        prog="python -m research.benchmarks.peers.learning", description=(__doc__ or "").partition("\n")[0]
    )
    parser.add_argument("--json", action="store_true", help="print JSON instead of a table")
    parser.add_argument("--write", type=Path, metavar="FOLDER", help="keep and continue data, page and picture here")
    parser.add_argument("--redraw", action="store_true", help="with --write: only page and picture, from results.json")
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--steps", type=int, default=50_000)
    parser.add_argument("--every", type=int, default=4)
    parser.add_argument("--warmup", type=int, default=4_000)
    parser.add_argument("--only", nargs="+", metavar="NAME", help="only these programs")
    parser.add_argument("--venvs", type=Path, default=ROOT / "research" / "benchmarks" / ".venvs")
    parser.add_argument("--pip-args", default="", help="added to pip install")
    return parser.parse_args()


def main() -> None:
    """Train whatever is missing, then print or write; exit with 2 when something failed."""
    asked = options()
    session = Session(
        Budget(asked.steps, asked.every, asked.warmup), asked.venvs, asked.write and asked.write / "results.json"
    )
    if asked.redraw:
        if not asked.write or not session.runs:
            sys.exit("--redraw needs --write FOLDER with a results.json of this budget in it.")
        show(session.runs, asked.write)
        return
    wanted: list[tuple[str, str, Program | None]] = [
        (name, algorithm, None) for name in OURS for algorithm in ("maddpg", "matd3")
    ]
    wanted += [(program.name, algorithm, program) for program, algorithms in PEERS for algorithm in algorithms]
    try:
        for software, algorithm, program in wanted:
            if not asked.only or software in asked.only:
                if program is not None:
                    provide(program, asked.venvs, asked.pip_args)
                session.compare(software, algorithm, program, asked.seeds)
    except EiaSecError as error:
        sys.stderr.write(f"{error}\n")
        sys.exit(2)
    if asked.write:
        session.save()
        show(session.runs, asked.write)
    sys.stdout.write(json.dumps(summary(session.runs), indent=1) + "\n" if asked.json else page(session.runs))


if __name__ == "__main__":
    main()
