"""Transfer: a policy of the default farm on fields from files and in teams of other sizes, beside the best heuristic.

    python -m research.experiments.transfer [--episodes 3200] [--seed 0] [--random-teams] [--farms 1020:1040]
        [--write research/results/transfer]

With `--random-teams` it trains in teams of 1 to 8 UAVs of each type, and not of four.
"""

import argparse
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import torch

from eia_sec.common.config import FailureConfig, FarmConfig, RunConfig, WorldConfig
from eia_sec.common.config.files import from_toml
from eia_sec.common.config.presets import preset
from eia_sec.deploy.local.in_process import train_in_process
from eia_sec.deploy.reports.provenance import provenance
from eia_sec.rollout.farm_files import read_farm
from eia_sec.rollout.policies import ActorPolicy
from research.experiments.conditions import Scores, best_heuristics, flown
from research.experiments.reporting import farm_range, filled, write_results
from research.studies.analysis.verdicts import shown

TEMPLATE: Final = Path(__file__).with_suffix(".md")
ANY_TEAM: Final = '[farm.world]\ndensity = "mixed"\n[farm.observation]\nidentity = false'
"""What the policy trains on, over the preset instant."""
RANDOM_TEAMS: Final = """
[farm.world]
communication_uavs = 8
monitoring_uavs = 8
collection_uavs = 8
[farm.failures]
missing = 0.5
"""
"""Teams of random sizes, from 1 to 8 UAVs of each type, over that."""
EXAMPLES: Final = Path(__file__).resolve().parents[2] / "docs" / "examples"
FIELDS: Final = ("orchard", "vineyard", "arable")
"""Files in docs/examples."""
TEAMS: Final = ((4, 4, 4), (2, 2, 2), (3, 4, 6), (8, 8, 8))
"""Relays, monitors and collectors on the farm of the training."""


def configuration(episodes: int, seed: int, random_teams: bool = False) -> RunConfig:
    """Return the run of the policy."""
    run = from_toml(ANY_TEAM, preset("instant"))
    return replace(from_toml(RANDOM_TEAMS, run) if random_teams else run, episodes=episodes, seed=seed)


def places(farm: FarmConfig) -> dict[str, FarmConfig]:
    """Return the farms to fly on by their names; nobody is missing there, and fields from files have the usual team."""
    usual = preset("instant").farm.world.counts
    farm, found = replace(farm, failures=FailureConfig(), world=with_team(farm.world, usual)), {}
    for name in FIELDS:
        given = read_farm(EXAMPLES / f"{name}.geojson").on(farm)
        size = f"{given.world.field_x:.0f} m x {given.world.field_y:.0f} m, {given.world.sensors} sensors"
        found[f"{name}, {size}"] = given
    for sizes in TEAMS:
        found[f"team {' + '.join(map(str, sizes))}"] = replace(farm, world=with_team(farm.world, sizes))
    return found


def with_team(world: WorldConfig, sizes: tuple[int, int, int]) -> WorldConfig:
    """Return the world with other numbers of relays, monitors and collectors."""
    relays, monitors, collectors = sizes
    return replace(world, communication_uavs=relays, monitoring_uavs=monitors, collection_uavs=collectors)


def page(data: dict[str, Any]) -> str:
    """Return the results as a page."""
    head = ("where", "best heuristic", "", "policy", "ratio", "c, m, d: heuristic", "policy", "AoI, VDF", "policy")
    rows = ["", "| " + " | ".join(head) + " |", "|---|---:|---|" + "---:|" * 6]
    for name, found in data["results"].items():
        bar, own = found["heuristic"], found["policy"]
        cells = [
            name,
            shown(bar["reward"]),
            bar["policy"],
            shown(own["reward"]),
            f"{own['reward'][0] / bar['reward'][0]:.3f}",
        ]
        cells += [", ".join(f"{value:.0f}" for value in scores["types"].values()) for scores in (bar, own)]
        cells += [f"{scores['aoi']:.2f}, {scores['vdf']:.2f}" for scores in (bar, own)]
        rows.append("| " + " | ".join(cells) + " |")
    numbers = {name: data[name] for name in ("episodes", "seed")}
    numbers["teams"] = "teams of random sizes, up to 8 + 8 + 8" if data["random_teams"] else "teams of 4 + 4 + 4"
    return filled(TEMPLATE, data, tables="\n".join([*rows, ""]), **numbers)


def main() -> None:
    """Train and fly, print what came out, and write it where asked after each place."""
    about = (__doc__ or "").partition("\n")[0]
    parser = argparse.ArgumentParser(prog="python -m research.experiments.transfer", description=about)
    parser.add_argument("--episodes", type=int, default=3200)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--random-teams", action="store_true", help="train in teams of random sizes")
    parser.add_argument("--farms", type=farm_range, default="1020:1040", help="farm seeds A:B, from A to B - 1")
    parser.add_argument("--write", type=Path, help="folder for results.json and README.md")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    results: dict[str, Scores] = {}
    data: dict[str, Any] = {**provenance("research.experiments.transfer"), "farms": list(arguments.farms)}
    data |= {"episodes": arguments.episodes, "seed": arguments.seed, "random_teams": arguments.random_teams}
    data["results"] = results
    config = configuration(arguments.episodes, arguments.seed, arguments.random_teams)
    policy = ActorPolicy(train_in_process(config).actors().noise_free())
    for name, farm in places(config.farm).items():
        bar = best_heuristics(farm, arguments.farms)[0]
        results[name] = {"heuristic": bar, "policy": flown(farm, policy, "transfer", arguments.farms)}
        write_results(data, page, arguments.write)


if __name__ == "__main__":
    main()
