"""Fly every heuristic again on the farms of a kept run, and replace their lines in its evaluation.

    python -m research.experiments.heuristics_again research/results/instant

The heuristics grow better with the code, and a kept run must not look better for it than it is.
"""

import json
import sys
from pathlib import Path

from eia_sec.common.config.files import read_saved
from eia_sec.deploy.reports.provenance import provenance
from eia_sec.rollout.evaluation import evaluate
from eia_sec.rollout.heuristics.registry import HEURISTICS
from eia_sec.rollout.policies import policy_of


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
