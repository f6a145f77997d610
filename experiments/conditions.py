"""Where learning pays: a policy trained for each of several farms, beside the best heuristic there.

    python -m experiments.conditions [NAME ...] [--episodes 1600] [--seed 0] [--write docs/results/conditions]

Farms that stand in the results already keep their numbers unless they are named.
"""

import argparse
import json
import time
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import torch

from common.config import FarmConfig, RunConfig
from common.config.files import from_toml
from common.config.presets import preset
from deploy.local.in_process import train_in_process
from deploy.reports.provenance import provenance
from experiments.heuristics import interval
from experiments.reporting import farm_range, filled, write_results
from rollout.evaluation import evaluate
from rollout.heuristics.registry import TASKS
from rollout.policies import ActorPolicy, Policy, policy_of

TEMPLATE: Final = Path(__file__).with_suffix(".md")
CONDITIONS: Final[dict[str, tuple[str, str]]] = {
    "default": ("default", ""),
    "links 150 m": ("connected", "[farm.relay]\nlink_range = 150.0"),
    "links 100 m": ("connected", ""),
    "links 70 m": ("connected", "[farm.relay]\nlink_range = 70.0"),
    "links 50 m": ("connected", "[farm.relay]\nlink_range = 50.0"),
    "failures, 2 an hour": ("default", "[farm.failures]\nper_hour = 2.0"),
    "failures, 6 an hour": ("default", "[farm.failures]\nper_hour = 6.0"),
    "links 70 m, failures, 2 an hour": (
        "connected",
        "[farm.relay]\nlink_range = 70.0\n[farm.failures]\nper_hour = 2.0",
    ),
    "team 2 + 2 + 2": (
        "default",
        "[farm.world]\ncommunication_uavs = 2\nmonitoring_uavs = 2\ncollection_uavs = 2",
    ),
    "team 8 + 8 + 8": (
        "default",
        "[farm.world]\ncommunication_uavs = 8\nmonitoring_uavs = 8\ncollection_uavs = 8",
    ),
    "clustered sensors": ("default", '[farm.world]\ndensity = "clustered"'),
}
"""Each farm by its name: a preset, and what differs from it."""
Scores = dict[str, Any]


def configuration(name: str, episodes: int, seed: int) -> RunConfig:
    """Return the run of a condition."""
    base, changes = CONDITIONS[name]
    return replace(from_toml(changes, preset(base)), episodes=episodes, seed=seed)


def own_reward(farm: FarmConfig) -> FarmConfig:
    """Return a farm on which relays are not paid for links."""
    return replace(farm, reward=replace(farm.reward, relayed=0.0))


def flown(farm: FarmConfig, policy: Policy, name: str, farms: range) -> Scores:
    """Return a policy's scores on some farms."""
    found = evaluate(own_reward(farm), policy, farms, 1, name=name)
    total = found.total
    return {
        "policy": name,
        "reward": interval([score.reward for score in found.per_farm]),
        "types": dict(total.types),
        "aoi": total.metrics["aoi"],
        "vdf": total.metrics["vdf"],
    }


def compare(name: str, episodes: int, seed: int, farms: range) -> Scores:
    """Train for a condition; return its scores and those of all heuristics, the best first."""
    config = configuration(name, episodes, seed)
    began = time.monotonic()
    trainer = train_in_process(config)
    seconds = time.monotonic() - began
    learned = flown(config.farm, ActorPolicy(trainer.actors().noise_free()), "learned", farms)
    others = [flown(config.farm, policy_of(task, config.farm), task, farms) for task in TASKS]
    others.sort(key=lambda scores: -float(scores["reward"][0]))
    steps = trainer.environment_steps
    return {"seconds": round(seconds, 1), "steps": steps, "learned": learned, "heuristics": others}


def page(data: dict[str, Any]) -> str:
    """Return the results as a page."""
    head = ("farm", "learned", "best heuristic", "", "ratio", "c, m, d learned", "c, m, d heuristic", "minutes")
    rows = ["", "| " + " | ".join(head) + " |", "|---|---:|---:|---|---:|---:|---:|---:|"]
    for name, found in data["results"].items():
        learned, best = found["learned"], found["heuristics"][0]
        reward, bar = (f"{s['reward'][0]:.0f} ({s['reward'][1]:.0f}..{s['reward'][2]:.0f})" for s in (learned, best))
        ratio = f"{learned['reward'][0] / best['reward'][0]:.2f}"
        types = [", ".join(f"{value:.0f}" for value in scores["types"].values()) for scores in (learned, best)]
        cells = (name, reward, bar, best["policy"], ratio, *types, f"{found['seconds'] / 60.0:.1f}")
        rows.append("| " + " | ".join(cells) + " |")
    return filled(TEMPLATE, data, tables="\n".join([*rows, ""]), episodes=data["episodes"], seed=data["seed"])


def kept(folder: Path | None) -> dict[str, Scores]:
    """Return the results that a folder holds, by condition."""
    path = folder / "results.json" if folder else None
    if path is None or not path.is_file():
        return {}
    found: dict[str, Scores] = json.loads(path.read_text(encoding="utf-8"))["results"]
    return found


def main() -> None:
    """Train and fly, print what came out, and write it where asked after each condition."""
    about = (__doc__ or "").partition("\n")[0]
    parser = argparse.ArgumentParser(prog="python -m experiments.conditions", description=about)
    parser.add_argument("name", nargs="*", help="conditions; by default all that the results do not hold")
    parser.add_argument("--episodes", type=int, default=1600)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--farms", type=farm_range, default="1020:1100", help="farm seeds A:B, from A to B - 1")
    parser.add_argument("--write", type=Path, help="folder for results.json and README.md")
    arguments = parser.parse_args()
    if unknown := [name for name in arguments.name if name not in CONDITIONS]:
        parser.error(f"there is no condition {unknown[0]!r}; they are {', '.join(CONDITIONS)}")
    torch.set_num_threads(1)
    results = kept(arguments.write)
    wanted = arguments.name or [name for name in CONDITIONS if name not in results]
    data: dict[str, Any] = {**provenance("experiments.conditions"), "farms": list(arguments.farms)}
    # The command for all farms, whichever were measured last.
    data["command"] = f"python -m experiments.conditions --episodes {arguments.episodes} --seed {arguments.seed}"
    data |= {"episodes": arguments.episodes, "seed": arguments.seed, "results": results}
    for name in wanted:
        results[name] = compare(name, arguments.episodes, arguments.seed, arguments.farms)
        data["results"] = {key: results[key] for key in CONDITIONS if key in results}
        write_results(data, page, arguments.write)


if __name__ == "__main__":
    main()
