r"""Evaluate the policies of several finished runs of one preset, which differ in their seeds.

    python -m research.experiments.seeds RUN_DIR ... --commit abc1234 [--add] \
        --write research/results/instant/seeds.json
    python -m research.experiments.seeds RUN_DIR ... --commit abc1234 --preset long \
        --write research/results/long/seeds.json

Every policy flies without noise on the farms on which studies are reported. `reached` holds, for each share of the
lawnmower's reward, the seconds of training until the mean reward of the newest 64 episodes, noise included, got there.
`script` is what the relays earn that `search` flies in place of the policy's own, beside its monitors and collectors.
"""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import tyro

from eia_sec.common.config import FarmConfig
from eia_sec.common.errors import UsageError
from eia_sec.common.farm import COMMUNICATION
from eia_sec.common.policy_file import POLICY
from eia_sec.deploy.local.run_directory import METRICS, RunDirectory
from eia_sec.deploy.reports.run_report import read_metrics
from eia_sec.rollout.evaluation import evaluate
from eia_sec.rollout.policies import Policy, policy_of
from research.experiments.exchange import Exchange
from research.experiments.reporting import last_status
from research.studies.analysis.statistics import interval, mean
from research.studies.scales import FIRST_REPORTED

FARMS: Final = 80
"""Farms on which studies are reported."""
SHARES: Final = (0.5, 0.75, 0.9, 1.0)
"""Shares of the lawnmower's reward."""
WINDOW: Final = 64
"""Episodes whose mean counts."""
COMMAND: Final = "eia-sec train --preset {preset} --seed SEED"
"""What made the runs."""
SCRIPT: Final = "lawnmower+search"
"""A heuristic with the relays that are flown in place of a policy's own."""


def scripted_relays(policy: Policy, farm: FarmConfig) -> Exchange:
    """Return a policy whose relays a heuristic flies."""
    return Exchange(policy, policy_of(SCRIPT, farm), slice(0, 2 * farm.world.communication_uavs))


@dataclass(frozen=True)
class Arguments:
    """Evaluate the policies of several finished runs of one preset."""

    runs: tyro.conf.Positional[tuple[Path, ...]]
    """Their run directories."""
    commit: str
    """Commit that made them."""
    preset: str = "instant"
    """Preset of the runs."""
    at_once: int = 1
    """Runs that the machine trained at the same time, which makes their times longer."""
    add: bool = False
    """Keep what the file has of other seeds."""
    write: Path = Path("research/results/instant/seeds.json")
    """Where the results go."""


def reached(records: list[dict[str, Any]], goal: float) -> float | None:
    """Return the seconds until the mean reward of the newest WINDOW episodes reached a goal; None if it never did."""
    episodes = [record for record in records if record["kind"] == "episodes"]
    for at in range(len(episodes)):
        start = episodes[at]["episodes"] - WINDOW
        newest = [record["reward"]["mean"] for record in episodes[: at + 1] if record["episodes"] > start]
        if start >= 0 and float(np.mean(newest)) >= goal:
            return float(episodes[at]["time"])
    return None


def summary(path: Path, commit: str, goal: float, at_once: int = 1) -> dict[str, Any]:
    """Return what a run came to."""
    directory = RunDirectory(path)
    config, records = directory.configuration(), read_metrics(path / METRICS)
    policy = policy_of(str(path / POLICY), config.farm)
    farms = range(FIRST_REPORTED, FIRST_REPORTED + FARMS)
    found = evaluate(config.farm, policy, farms, 1, name=f"seed {config.seed}")
    scripted = evaluate(config.farm, scripted_relays(policy, config.farm), farms, 1, name=SCRIPT)
    last = last_status(path)
    plain = found.to_dict()
    return {
        "seed": config.seed,
        "commit": commit,
        "reward": plain["reward"],
        "script": scripted.total.types[COMMUNICATION],
        "aoi": plain["aoi"],
        "vdf": plain["vdf"],
        "seconds": records[-1]["time"],
        "at_once": at_once,
        "environment_steps": last["environment_steps"],
        "reached": {f"{share:g}": reached(records, share * goal) for share in SHARES},
    }


def merged(earlier: list[dict[str, Any]], runs: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return runs by seed; a newer one takes an earlier one's place."""
    by_seed = {run["seed"]: run for run in (*earlier, *runs)}
    return [by_seed[seed] for seed in sorted(by_seed)]


def intervals(runs: list[dict[str, Any]]) -> dict[str, list[float]]:
    """Return the mean over all runs of reward, AoI and VDF, each with its interval."""
    scores = {"reward": [run["reward"]["mean"] for run in runs]}
    scores |= {name: [run[name] for run in runs] for name in ("aoi", "vdf")}
    return {name: list(interval(np.array(values)[:, None], mean)) for name, values in scores.items()}


def _earlier(arguments: Arguments) -> list[dict[str, Any]]:
    """Return the runs that the file has; raise UsageError if they are of another preset or flew other farms."""
    data = json.loads(arguments.write.read_text(encoding="utf-8"))
    wanted = COMMAND.format(preset=arguments.preset), FIRST_REPORTED, FARMS
    if (data["command"], data["first_farm"], data["farms"]) != wanted:
        raise UsageError(f"{arguments.write} has runs of another preset or on other farms; write these elsewhere.")
    return list(data["runs"])


def main() -> None:
    """Evaluate all runs and write the results."""
    arguments = tyro.cli(Arguments, prog="python -m research.experiments.seeds")
    earlier = _earlier(arguments) if arguments.add else []
    farm = RunDirectory(arguments.runs[0]).configuration().farm
    farms = range(FIRST_REPORTED, FIRST_REPORTED + FARMS)
    lawnmower = evaluate(farm, policy_of("lawnmower", farm), farms, 1, name="lawnmower").total.reward
    runs = merged(earlier, [summary(path, arguments.commit, lawnmower, arguments.at_once) for path in arguments.runs])
    data = {
        "command": COMMAND.format(preset=arguments.preset),
        "commit": ", ".join(dict.fromkeys(run["commit"] for run in runs)),
        "first_farm": FIRST_REPORTED,
        "farms": FARMS,
        "lawnmower": lawnmower,
        "runs": runs,
        **intervals(runs),
    }
    arguments.write.write_text(json.dumps(data) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
