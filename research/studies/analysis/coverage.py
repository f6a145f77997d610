"""How often intervals and probabilities of the studies are right where the truth is known.

    python -m research.studies.analysis.coverage [--write research/results/reproduce/coverage.json] [--experiments 2000]

Seeds of a method are drawn whose scores on fixed farms are known in distribution, and are put through the functions
that the studies use. A bootstrap over few seeds sees no more than these, so its interval is too narrow; by how much
follows from the number of seeds, and hardly from the sizes of the effects below.
"""

import argparse
import json
import sys
from pathlib import Path
from statistics import NormalDist
from typing import Any, Final

import numpy as np

from eia_sec.common.errors import RunDirError
from eia_sec.deploy.exit_codes import run_command
from eia_sec.deploy.reports.intervals import Numbers
from eia_sec.deploy.reports.provenance import provenance
from research.studies.analysis.statistics import improvement_interval, interval

SEEDS: Final = (3, 5, 10)
"""Seeds of each method: those of the side studies, of `training`, and of twice as many."""
FARMS: Final = 20
FARM_SPREAD: Final = 3.0
"""Standard deviation of the farms' effects, in units of that of the seeds' effects."""
REST: Final = 1.0
"""Standard deviation of what is neither the seed's nor the farm's, in the same units."""


def coverage(seeds: int, experiments: int, draw: np.random.Generator) -> dict[str, float]:
    """Return how often an interval holds the truth, and how often equal methods are distinguished.

    Args:
        seeds: seeds of each method.
        experiments: pairs of equal methods that are drawn.
        draw: where they are drawn from.

    Returns:
        `interval`: share of intervals of the interquartile mean over seeds and farms that hold the true one, 0.
        `told_apart`: share of pairs of equal methods that the interval of the probability of improvement calls
        different, one way or the other. `told_apart_by_one`: the same with one number for each seed, as convergence is.
    """
    held = apart = by_one = 0
    for _ in range(experiments):
        one, other = _scores(seeds, draw), _scores(seeds, draw)
        _, low, high = interval(one)
        held += low <= 0.0 <= high
        apart += _decided(one, other)
        by_one += _decided(one.mean(axis=1, keepdims=True), other.mean(axis=1, keepdims=True))
    shares = {"interval": held, "told_apart": apart, "told_apart_by_one": by_one}
    return {name: count / experiments for name, count in shares.items()}


def _scores(seeds: int, draw: np.random.Generator) -> Numbers:
    """Return scores [seeds, FARMS] of a method: the seed's effect, the farm's, always the same, and the rest."""
    normal = NormalDist(0.0, FARM_SPREAD)
    farms = np.array([normal.inv_cdf((farm + 0.5) / FARMS) for farm in range(FARMS)])
    scores: Numbers = draw.normal(size=(seeds, 1)) + farms + REST * draw.normal(size=(seeds, FARMS))
    return scores


def _decided(one: Numbers, other: Numbers) -> bool:
    _, low, high = improvement_interval(one, other)
    return low > 0.5 or high < 0.5


def block(data: dict[str, Any] | None) -> str:
    """Return what docs/explanation/reproduce.md says of it."""
    if data is None:
        return "How often they are right has not been counted.\n"
    lines = ["| seeds of each | interval holds the truth | equal methods distinguished | by one number a seed |"]
    lines += ["|---:|---:|---:|---:|"]
    for seeds, found in data["seeds"].items():
        shares = (found["interval"], found["told_apart"], found["told_apart_by_one"])
        lines.append(f"| {seeds} | " + " | ".join(f"{share:.0%}" for share in shares) + " |")
    made = f"`{data['command']}`, commit {data['commit']}:"
    count = f"{data['experiments']:,} experiments with a known truth for each row."
    return "\n".join([made, count, "", *lines, ""])


def measure() -> int:
    """Count, and write or print what was found; return 0."""
    parser = argparse.ArgumentParser(
        prog="python -m research.studies.analysis.coverage", description=(__doc__ or "").partition("\n")[0]
    )
    parser.add_argument("--write", type=Path, help="file for the result; printed when left out")
    parser.add_argument("--experiments", type=int, default=2000)
    asked = parser.parse_args()
    draw = np.random.default_rng(0)
    found = {str(seeds): coverage(seeds, asked.experiments, draw) for seeds in SEEDS}
    record = json.dumps(
        {**provenance("research.studies.analysis.coverage"), "experiments": asked.experiments, "seeds": found}
    )
    if asked.write is None:
        sys.stdout.write(record + "\n")
        return 0
    try:
        asked.write.write_text(record + "\n", encoding="utf-8")
    except OSError as error:
        raise RunDirError(f"cannot write {asked.write}: {error.strerror}.") from error
    return 0


if __name__ == "__main__":
    sys.exit(run_command(measure))
