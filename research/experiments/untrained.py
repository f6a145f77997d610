"""What a team earns before it learns anything: `python -m research.experiments.untrained`.

A fresh policy of the preset instant prefers the moves of the routes that it observes, so it is no random policy.
"""

import json
from pathlib import Path
from typing import Final

from eia_sec.common.config.presets import preset
from eia_sec.deploy.reports.provenance import provenance
from eia_sec.rollout.evaluation import evaluate
from eia_sec.rollout.policies import ActorPolicy
from research.experiments.inertia import untrained
from research.studies.scales import FIRST_REPORTED

FARMS: Final = 80
WRITE: Final = Path("research/results/instant/untrained.json")


def main() -> None:
    """Fly the actors with which a run of seed 0 begins, without noise, on the farms of the README's table."""
    config, farms = preset("instant"), range(FIRST_REPORTED, FIRST_REPORTED + FARMS)
    found = {**provenance("research.experiments.untrained"), "first_farm": FIRST_REPORTED, "farms": FARMS, "seed": 0}
    reward = evaluate(config.farm, ActorPolicy(untrained(config)), farms, 1, name="untrained").total.reward
    WRITE.write_text(json.dumps({**found, "reward": reward}, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
