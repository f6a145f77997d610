"""The best policies and heuristics on farms on which no setting was chosen.

    python -m research.studies.unseen RUN_DIR ... [--farms 2000:2100] [--write research/results/unseen]

The settings of the presets `default` and `long` were chosen by rewards on farms 1000..1099, on which results are
reported. Here the two policies that ship, the runs (seeds of the preset instant) and the two best heuristics fly other
farms.
"""

import json
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import tyro

from eia_sec.common.config import FarmConfig
from eia_sec.common.config.presets import preset
from eia_sec.common.policy_file import POLICY
from eia_sec.deploy.commands.policies.evaluate import parse_farms
from eia_sec.deploy.local.run_directory import RunDirectory
from eia_sec.deploy.reports.provenance import provenance
from eia_sec.rollout.evaluation import evaluate
from eia_sec.rollout.policies import policy_of
from research.studies.analysis.statistics import interval, mean

FLOWN: Final = {"trained:long": "long", "horizon": "instant", "trained:instant": "instant", "lawnmower": "instant"}
"""Policies and heuristics, and the preset on whose farm each flies; only what UAVs observe differs."""
COLUMNS: Final = {"reward": 0, "aoi": 3, "vdf": 3}
"""Fields of a score, and their decimals."""


@dataclass(frozen=True)
class Arguments:
    """Fly policies, heuristics and finished runs over farms on which nothing was chosen."""

    runs: tyro.conf.Positional[tuple[Path, ...]] = ()
    """Run directories of the preset instant, of different seeds."""
    farms: str = "2000:2100"
    """Farm seeds A:B, from A to B - 1; one episode on each."""
    write: Path | None = None
    """Where the results go."""


def scores(name: str, path: str, farm: FarmConfig, farms: range) -> dict[str, Any]:
    """Return each field's values, one for each farm."""
    found = evaluate(farm, policy_of(path, farm), farms, 1, name=name)
    sys.stderr.write(f"{name}: {found.total.reward:.0f}\n")
    return {
        "reward": [score.reward for score in found.per_farm],
        **{field: [score.metrics[field] for score in found.per_farm] for field in ("aoi", "vdf")},
    }


def row(name: str, found: list[dict[str, Any]], *, over_seeds: bool) -> dict[str, Any]:
    """Return mean and 95 % interval of each field, over seeds if there are several, else over farms."""
    result: dict[str, Any] = {"policy": name, "over": "seeds" if over_seeds else "farms"}
    for field in COLUMNS:
        values = np.array([np.mean(score[field]) for score in found] if over_seeds else found[0][field])
        result[field] = list(interval(values[:, None], mean))
    return result


def page(data: dict[str, Any]) -> str:
    """Return the results as Markdown."""
    first, last = data["first_farm"], data["last_farm"]
    lines = [
        "# Farms on which nothing was chosen",
        "",
        f"`{data['command']}`, commit {data['commit']}: mean without noise over farms {first}..{last}, with a 95 %",
        "interval over seeds, or over farms where there is one policy. Settings of the presets were chosen by rewards",
        "on farms 1000..1099, on which results are reported elsewhere; nothing was chosen on these.",
        "",
        "| policy | interval over | reward per agent | AoI | VDF |",
        "|---|---|---:|---:|---:|",
    ]
    for result in sorted(data["results"], key=lambda result: -result["reward"][0]):
        cells = [result["policy"], result["over"]]
        for field, digits in COLUMNS.items():
            middle, low, high = (f"{value:.{digits}f}" for value in result[field])
            cells.append(f"{middle} ({low}..{high})")
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join([*lines, ""])


def main() -> None:
    """Fly all, print the page and write the results where asked."""
    arguments = tyro.cli(Arguments, prog="python -m research.studies.unseen")
    farms, data = parse_farms(arguments.farms), provenance("research.studies.unseen")
    data["command"] = "python -m research.studies.unseen RUN_DIR ..." if arguments.runs else data["command"]
    results = [
        row(name, [scores(name, name, preset(kind).farm, farms)], over_seeds=False) for name, kind in FLOWN.items()
    ]
    if arguments.runs:
        held = [(path, RunDirectory(path).configuration()) for path in arguments.runs]
        flown = [scores(f"seed {config.seed}", str(path / POLICY), config.farm, farms) for path, config in held]
        results.append(row(f"preset `instant`, {len(flown)} seeds", flown, over_seeds=True))
    data |= {"first_farm": farms.start, "last_farm": farms.stop - 1, "results": results}
    text = page(data)
    sys.stdout.write(text)
    if arguments.write is not None:
        arguments.write.mkdir(parents=True, exist_ok=True)
        (arguments.write / "results.json").write_text(json.dumps(data, indent=1) + "\n", encoding="utf-8")
        (arguments.write / "README.md").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
