"""Teams that learned to fly with inertia, beside an untrained team and the heuristics.

    python -m research.experiments.inertia [POLICY ...] [--seeds 0 1] [--algorithms eia-ppo ippo]
        [--farms 2000:2100] [--keep FOLDER] [--ship] [--write research/results/inertia]

Each seed trains the preset `inertial` in one process, with each algorithm. These teams, and the policies that are named
(`untrained`, heuristics, files), fly without noise on farms on which nothing was chosen. Results of others that are
there stay.
"""

import itertools
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import tyro

from eia_sec.common.actors import TeamActors
from eia_sec.common.config import RunConfig
from eia_sec.common.config.files import with_values
from eia_sec.common.config.presets import preset
from eia_sec.common.farm import farm_team
from eia_sec.common.policy_file import save_policy
from eia_sec.common.transitions import Chunk
from eia_sec.deploy.commands.policies.evaluate import parse_farms
from eia_sec.deploy.local.in_process import train_in_process
from eia_sec.deploy.reports.provenance import provenance
from eia_sec.learner.trainer import Trainer
from eia_sec.learner.trainers import make_trainer
from eia_sec.rollout.evaluation import evaluate
from eia_sec.rollout.policies import ActorPolicy, Policy, policy_of
from eia_sec.rollout.shipped_policies import TRAINED
from research.experiments.heuristics import summarised
from research.experiments.reporting import store_results
from research.pages.blocks import read_json
from research.pages.inertia_table import ALGORITHM_LABELS, UNTRAINED, page

EVERY: Final = 200
"""Episodes between two lines on a training."""


@dataclass(frozen=True)
class Arguments:
    """Train teams with inertia; fly them and others over farms on which nothing was chosen."""

    policies: tyro.conf.Positional[tuple[str, ...]] = ()
    """Policies to fly: untrained, heuristics or files."""
    seeds: tuple[int, ...] = ()
    """Seeds to train."""
    algorithms: tuple[str, ...] = ("eia-ppo",)
    """Algorithms to train each seed with."""
    farms: str = "2000:2100"
    """Farm seeds A:B, from A to B - 1; one episode on each."""
    keep: Path | None = None
    """Folder for the policies of the seeds, or none."""
    ship: bool = False
    """Make the last policy the one that ships with the package, in 16-bit numbers."""
    write: Path = Path("research/results/inertia")
    """Where the results go."""


def main() -> None:
    """Train, fly, and write after each policy."""
    arguments = tyro.cli(Arguments, prog="python -m research.experiments.inertia")
    config, made = preset("inertial"), provenance("research.experiments.inertia")
    for name in arguments.policies:
        policy = ActorPolicy(untrained(config)) if name == UNTRAINED else policy_of(name, config.farm)
        stored(arguments.write, made, flown(config, policy, Path(name).stem, arguments.farms))
    for seed, algorithm in itertools.product(arguments.seeds, arguments.algorithms):
        actors, costs = trained(with_values(config, {"seed": seed, "algorithm.name": algorithm}))
        origin = {"command": f"{made['command']} --seeds {seed} --algorithms {algorithm}", "commit": made["commit"]}
        if arguments.keep:
            arguments.keep.mkdir(parents=True, exist_ok=True)
            save_policy(arguments.keep / f"{algorithm}-{seed}.safetensors", actors, origin)
        if arguments.ship:
            save_policy(TRAINED, actors, {**origin, "seed": str(seed)}, half=True)
        label = f"{ALGORITHM_LABELS[algorithm]}, seed {seed}"
        stored(arguments.write, made, {**flown(config, ActorPolicy(actors), label, arguments.farms), **costs})


def untrained(config: RunConfig) -> TeamActors:
    """Return the actors with which a run begins."""
    return make_trainer(config, farm_team(config.farm)).actors().noise_free()


def trained(config: RunConfig) -> tuple[TeamActors, dict[str, Any]]:
    """Train; return the actors and what they cost."""
    began, next_line = time.process_time(), 0

    def watch(trainer: Trainer, chunk: Chunk) -> None:
        nonlocal next_line
        if trainer.episodes >= next_line:
            next_line = trainer.episodes + EVERY
            sys.stderr.write(f"seed {config.seed}: {trainer.episodes} episodes, {time.process_time() - began:.0f} s\n")

    trainer = train_in_process(config, watch)
    cost = {
        "algorithm": config.algorithm.name,
        "seed": config.seed,
        "episodes": trainer.episodes,
        "steps": trainer.environment_steps,
    }
    return trainer.actors().noise_free(), {**cost, "training_cpu_seconds": round(time.process_time() - began, 1)}


def flown(config: RunConfig, policy: Policy, name: str, farms: str) -> dict[str, Any]:
    """Return a policy's scores, see `research.experiments.heuristics`, and on how many farms it flew."""
    seeds, began = parse_farms(farms), time.process_time()
    found = evaluate(config.farm, policy, seeds, 1, name=name)
    sys.stderr.write(f"{name}: {found.total.reward:.0f}\n")
    scores = summarised(found, time.process_time() - began)
    return {**scores, "first_farm": seeds.start, "farms": len(seeds)}


def stored(folder: Path, made: dict[str, Any], result: dict[str, Any]) -> None:
    """Write one more result, in place of an earlier one of the same policy."""
    earlier = (read_json(folder / "results.json") or {"results": []})["results"]
    results = [other for other in earlier if other["policy"] != result["policy"]]
    results.append({**result, "command": made["command"], "commit": made["commit"]})
    store_results({"results": results}, page, folder)


if __name__ == "__main__":
    main()
