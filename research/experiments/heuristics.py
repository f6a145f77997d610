"""Every heuristic and the policy that ships, on farms that nothing was trained on.

    python -m research.experiments.heuristics

Writes results.json and figure.png. `--redraw` makes the picture anew from results.json.
"""

import json
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import tyro
from matplotlib.figure import Figure
from scipy.stats import bootstrap

from eia_sec.common.config.presets import PRESETS
from eia_sec.common.errors import UsageError
from eia_sec.common.seeds import stream
from eia_sec.deploy.commands.policies.evaluate import parse_farms
from eia_sec.deploy.reports.plots import DPI, OTHER_COLOURS, TEXT, bare
from eia_sec.deploy.reports.provenance import provenance
from eia_sec.rollout.evaluation import Evaluation, Score, evaluate
from eia_sec.rollout.heuristics.registry import HEURISTICS, RELAYS
from eia_sec.rollout.policies import policy_of
from research.looks import WIDTH, heading, legend_below
from research.pages.interval_tables import COLUMNS, ranked

RESAMPLES: Final = 10_000
LEVEL: Final = 0.95
LEARNED: Final = "trained:instant"
"""The policy that is no heuristic."""


@dataclass(frozen=True)
class Arguments:
    """Fly every named policy over the same farms."""

    farms: str = "1000:1100"
    """Farm seeds A:B, from A to B - 1; one episode on each."""
    output: Path = Path("research/results/heuristics")
    """Where the results go."""
    redraw: bool = False
    """Make table and figure from the results that are there, and fly nothing."""
    only: tuple[str, ...] = ()
    """Fly only these policies; the others keep their results, which must be of the same farms."""


def contenders() -> list[str]:
    """Return every named policy, and one with the other relays."""
    others = list(RELAYS)[1:]
    return [*HEURISTICS, LEARNED, *(f"lawnmower+{relays}" for relays in others)]


def interval(values: list[float]) -> list[float]:
    """Return mean, lower and upper end of its bootstrap interval (percentiles) over the farms."""
    data = np.array(values)
    if np.ptp(data) == 0.0:
        return [float(data[0])] * 3
    found = bootstrap(
        (data,),
        np.mean,
        n_resamples=RESAMPLES,
        confidence_level=LEVEL,
        method="percentile",
        rng=stream("bootstrap"),
    ).confidence_interval
    return [float(data.mean()), float(found.low), float(found.high)]


def summarised(evaluation: Evaluation, seconds: float) -> dict[str, Any]:
    """Return the intervals of every shown field, and every farm's reward."""
    per_farm = evaluation.per_farm
    return {
        "policy": evaluation.policy,
        "cpu_seconds": round(seconds, 1),
        **{name: interval([_field(score, name) for score in per_farm]) for name in COLUMNS},
        "per_farm": [round(score.reward, 2) for score in per_farm],
    }


def _field(score: Score, name: str) -> float:
    return score.reward if name == "reward" else {**score.types, **score.metrics}[name]


def draw(data: dict[str, Any], path: Path) -> None:
    """Draw the mean reward of each policy and its interval; who stays far below the others is left to the table."""
    shown = [result for result in ranked(data) if result["reward"][0] > 0.0][::-1]
    figure = Figure(figsize=(WIDTH, 0.36 * len(shown) + 1.9), layout="constrained")
    axes = figure.subplots()
    for row, result in enumerate(shown):
        mean, low, high = result["reward"]
        learned = result["policy"] == LEARNED
        colour, mark, label = (OTHER_COLOURS[0], "D", "learned") if learned else ("0.45", "o", "heuristic")
        axes.plot([low, high], [row, row], "|-", color=colour, markersize=11)
        axes.plot(mean, row, mark, color=colour, markersize=4.5, label=label)
        axes.annotate(f"{mean:.0f}", (high, row), xytext=(6, 0), textcoords="offset points", va="center", **TEXT)
    axes.set_yticks(range(len(shown)), [result["policy"] for result in shown])
    axes.margins(x=0.1)
    axes.set_xlabel("reward per agent and episode")
    bare(axes)
    axes.grid(False, axis="y")
    legend_below(figure, [axes], 2)
    rest = ", ".join(result["policy"] for result in ranked(data) if result["reward"][0] <= 0.0)
    heading(
        figure,
        f"One episode on each of the farms {data['first_farm']}..{data['last_farm']}. Mark: mean; bar: {LEVEL:.0%} "
        "bootstrap interval." + (f"\nBelow 0 and not shown: {rest}." if rest else ""),
    )
    figure.savefig(path, dpi=DPI)


def fly(arguments: Arguments) -> dict[str, Any]:
    """Return every policy's results."""
    made = provenance("research.experiments.heuristics")
    farms, config, results = parse_farms(arguments.farms), PRESETS["instant"].farm, _kept(arguments)
    for name in arguments.only or contenders():
        start = time.process_time()
        evaluation = evaluate(config, policy_of(name, config), farms, 1, name=name)
        results.append({**summarised(evaluation, time.process_time() - start), "commit": made["commit"]})
        sys.stdout.write(f"{name}: {evaluation.total.reward:.0f}\n")
        sys.stdout.flush()
    seeds = {"first_farm": farms.start, "last_farm": farms.stop - 1, "farms": len(farms), "level": LEVEL}
    made["commit"] = ", ".join(dict.fromkeys(result.get("commit", "unknown") for result in results))
    return {**made, **seeds, "results": results}


def _kept(arguments: Arguments) -> list[dict[str, Any]]:
    """Return the results of the policies that are not flown again."""
    if not arguments.only:
        return []
    data, farms = (
        json.loads((arguments.output / "results.json").read_text(encoding="utf-8")),
        parse_farms(arguments.farms),
    )
    if (data["first_farm"], data["farms"]) != (farms.start, len(farms)):
        raise UsageError("the results that are there are of other farms; fly all policies.")
    return [result for result in data["results"] if result["policy"] not in arguments.only]


def main() -> None:
    """Fly, write, and draw."""
    arguments = tyro.cli(Arguments, prog="python -m research.experiments.heuristics")
    path = arguments.output / "results.json"
    if not arguments.redraw:
        text = json.dumps(fly(arguments), indent=1)
        arguments.output.mkdir(parents=True, exist_ok=True)
        path.write_text(text + "\n", encoding="utf-8")
    data = json.loads(path.read_text(encoding="utf-8"))
    draw(data, arguments.output / "figure.png")


if __name__ == "__main__":
    main()
