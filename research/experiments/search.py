"""What a harder search gives: the best heuristic, `horizon`, as it flies and with many times its effort.

    python -m research.experiments.search [--preset study] [--farms 1000:1008] [--write research/results/search]

It plans with the farm's own dynamics and sees all of it. How much it gains by planning harder says how far above it a
policy may be hoped to get; a bound, which is further off, is counted by `research.experiments.bound`.
"""

import argparse
import sys
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Final

from eia_sec.common.config import FarmConfig
from eia_sec.common.config.presets import preset
from eia_sec.deploy.exit_codes import run_command
from eia_sec.deploy.reports.provenance import provenance
from eia_sec.rollout.evaluation import evaluate
from eia_sec.rollout.heuristics.composite import COLLECTORS, MONITORS, CompositePolicy
from eia_sec.rollout.heuristics.registry import RELAYS, default_relays
from eia_sec.rollout.heuristics.tasks import horizon
from eia_sec.rollout.heuristics.tasks.horizon import Effort, HorizonGroupPolicy
from eia_sec.rollout.policies import policy_of
from research.experiments.conditions import own_reward
from research.experiments.reporting import farm_range, filled, write_results

TEMPLATE: Final = Path(__file__).with_suffix(".md")
WIDE: Final = Effort(width=256, last_width=256, same=8)
"""The usual steps ahead and many more paths."""
FAR: Final = Effort(horizon=40, width=512, last_horizon=40, last_width=512, same=8, discount=0.99)
"""More steps ahead, too."""
FORMS: Final = {
    "as it flies": {},
    "256 paths": {"collectors": WIDE},
    "512 paths, 40 steps ahead": {"collectors": FAR},
    "the same, monitors too": {"collectors": FAR, "monitors": FAR},
}
"""Who searches harder, and how hard; monitors otherwise fly as usual."""


def forms(config: FarmConfig) -> list[str]:
    """Return the forms that search harder on a farm than the heuristic does there, after it as it flies."""
    width = horizon.effort_of(config).width
    return [form for form, efforts in FORMS.items() if not efforts or efforts["collectors"].width > width]


def fly(config: FarmConfig, form: str, farms: range) -> dict[str, Any]:
    """Fly a form on farms; return its rewards and metrics."""
    efforts, policy = FORMS[form], policy_of("horizon", config)
    if efforts:
        collectors = partial(HorizonGroupPolicy, kind=COLLECTORS, effort=efforts["collectors"])
        sweep = (
            partial(HorizonGroupPolicy, kind=MONITORS, effort=efforts["monitors"]) if "monitors" in efforts else None
        )
        policy = CompositePolicy(config, RELAYS[default_relays(config)], sweep or horizon.monitors, collectors)
    total = evaluate(config, policy, farms, 1, name=form).total
    means = {"reward": total.reward, **total.types, **total.metrics}
    return {"form": form, **{name: round(value, 4) for name, value in means.items()}}


def page(data: dict[str, Any]) -> str:
    """Return the results as a page."""
    rows = [
        f"| {found['form']} | {found['reward']:.0f} | {round(found['communication'])} | {found['monitoring']:.0f} | "
        f"{found['collection']:.0f} | {found['aoi']:.2f} | {found['vdf']:.2f} |"
        for found in data["results"]
    ]
    first, most = data["results"][0]["reward"], max(found["reward"] for found in data["results"])
    return filled(TEMPLATE, data, preset=data["preset"], rows="\n".join(rows), ratio=most / first)


def main() -> int:
    """Fly every form, print what came out, and write it where asked; return 0."""
    about = (__doc__ or "").partition("\n")[0]
    parser = argparse.ArgumentParser(prog="python -m research.experiments.search", description=about)
    parser.add_argument("--preset", default="study", help="whose farms they are")
    parser.add_argument("--farms", type=farm_range, default="1000:1008", help="farm seeds A:B, from A to B - 1")
    parser.add_argument("--write", type=Path, help="folder for results.json and README.md")
    arguments = parser.parse_args()
    farms, farm = arguments.farms, own_reward(preset(arguments.preset).farm)
    farm = replace(farm, battery=replace(farm.battery, failsafe=0.0))  # heuristics charge by themselves
    data = {**provenance("research.experiments.search"), "preset": arguments.preset, "farms": list(farms)}
    data["results"] = [fly(farm, form, farms) for form in forms(farm)]
    write_results(data, page, arguments.write)
    return 0


if __name__ == "__main__":
    sys.exit(run_command(main))
