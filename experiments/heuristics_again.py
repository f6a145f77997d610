"""Fly every heuristic again on the farms of a kept run, and replace their lines in its evaluation.

    python -m experiments.heuristics_again docs/results/default

The heuristics grow better with the code, and a kept run must not look better for it than it is.
"""

import json
import sys
from pathlib import Path

from common.config.presets import read_saved
from deploy.reports.provenance import provenance
from rollout.evaluation import evaluate
from rollout.heuristics.registry import HEURISTICS
from rollout.policies import policy_of


def main() -> None:
    """Replace the heuristics' lines."""
    folder = Path(sys.argv[1])
    path = folder / "evaluation.json"
    outcome = json.loads(path.read_text(encoding="utf-8"))
    farm = read_saved(folder / "config.toml").farm
    farms, episodes = outcome["evaluations"][0]["farms"], outcome["evaluations"][0]["episodes"]
    kept = [result for result in outcome["evaluations"] if result["policy"] not in HEURISTICS]
    flown = [evaluate(farm, policy_of(name, farm), farms, episodes, name=name).to_dict() for name in HEURISTICS]
    outcome |= {"evaluations": kept + flown, "heuristics_commit": provenance("")["commit"]}
    path.write_text(json.dumps(outcome) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
