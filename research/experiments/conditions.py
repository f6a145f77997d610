"""Where learning pays: a policy trained for each of several farms, beside the best heuristic there.

    python -m research.experiments.conditions [NAME ...] [--episodes 1600] [--longer] [--seed 0] [--another SEED]
        [--write research/results/conditions] [--keep FOLDER]

`--longer` trains a second policy for all episodes of its preset, which is `long` where the farm is like the default
one. What stands in the results already stays as it is, unless its farm is named; with `--longer` or `--heuristics`,
only that part is measured anew.
`--another SEED` adds a policy of another seed to those of the named farms: a longer one with `--longer`. Policies of
other seeds go with the first one when that is trained anew.
"""

import argparse
import json
import re
import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from statistics import fmean
from typing import Any, Final, NamedTuple

import torch

from eia_sec.common.config import FarmConfig, RunConfig
from eia_sec.common.errors import UsageError
from eia_sec.common.policy_file import save_policy
from eia_sec.deploy.exit_codes import run_command
from eia_sec.deploy.local.in_process import train_in_process
from eia_sec.deploy.reports.provenance import provenance
from eia_sec.rollout.evaluation import evaluate
from eia_sec.rollout.heuristics.registry import TASKS
from eia_sec.rollout.policies import ActorPolicy, Policy, policy_of
from research.experiments.condition_farms import CONDITIONS, configuration, longer_configuration
from research.experiments.heuristics import interval
from research.experiments.reporting import farm_range, filled, write_results
from research.studies.analysis.verdicts import shown

TEMPLATE: Final = Path(__file__).with_suffix(".md")
FREE: Final = ("links 150 m", "links 100 m", "links 70 m", "links 50 m", "batteries", "wind 3 m/s", "no-fly zones")
"""Conditions that a good enough policy might not feel: nobody is lost, and the task is the default farm's."""
POLICIES: Final = ("learned", "longer")
"""Policies of a condition as far as they were trained, in the page's order."""
Scores = dict[str, Any]


class Episodes(NamedTuple):
    """Episodes of each of a condition's policies; 0 for one that is not trained.

    Attributes:
        learned: of the policy that learns from nothing.
        longer: of the one that learns for as long as its preset says, see LONGER.
    """

    learned: int
    longer: int


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


def trained(config: RunConfig, farms: range, name: str, keep: Path | None = None) -> Scores:
    """Train; return the scores of the policy, and what it took.

    Args:
        config: the run.
        farms: seeds of the farms to score on.
        name: of the policy.
        keep: where to write the policy as it would ship, with 16-bit numbers, or None.
    """
    began = time.monotonic()
    trainer = train_in_process(config)
    seconds = round(time.monotonic() - began, 1)
    actors = trainer.actors().noise_free()
    if keep:
        keep.parent.mkdir(parents=True, exist_ok=True)
        origin = {"seed": config.seed, "episodes": config.episodes, **provenance("research.experiments.conditions")}
        metadata = {key: str(origin[key]) for key in ("command", "commit", "seed", "episodes")}
        save_policy(keep, actors, metadata, half=True)
    scores = flown(config.farm, ActorPolicy(actors), name, farms)
    return {**scores, "seed": config.seed, "seconds": seconds, "steps": trainer.environment_steps}


def policy_file(condition: str, policy: str) -> str:
    """Return the name of the file of one of a condition's policies."""
    return f"{re.sub(r'[^a-z0-9]+', '-', condition)}-{policy}.safetensors"


def best_heuristics(farm: FarmConfig, farms: range) -> list[Scores]:
    """Return the scores of all heuristics, the best first. They charge by themselves, without autopilots."""
    farm = replace(farm, battery=replace(farm.battery, failsafe=0.0))
    scores = [flown(farm, policy_of(task, farm), task, farms) for task in TASKS]
    return sorted(scores, key=lambda found: -float(found["reward"][0]))


def compare(name: str, found: Scores, episodes: Episodes, seed: int, farms: range, keep: Path | None = None) -> Scores:
    """Return what was found for a condition, with what is missing measured.

    Args:
        name: the condition.
        found: scores of POLICIES by their names, "heuristics", scores of all heuristics, the best first, and "commit",
            which measured them; as far as they are known.
        episodes: of each policy.
        seed: of the runs.
        farms: seeds of the farms to score on.
        keep: folder for the policies, or None.
    """
    files = {policy: keep / policy_file(name, policy) if keep else None for policy in POLICIES}
    found, config = dict(found), configuration(name, episodes.learned, seed)
    if "heuristics" not in found:
        found["heuristics"] = best_heuristics(config.farm, farms)
    if "learned" not in found:
        found["learned"] = trained(config, farms, "learned", files["learned"])
    if "longer" not in found and episodes.longer > 0:
        run = replace(longer_configuration(name, seed), episodes=episodes.longer)
        found["longer"] = trained(run, farms, "longer", files["longer"])
    return found


def with_new_bar(found: Scores, measuring: str) -> Scores:
    """Return what holds of a condition's results when the heuristics have changed: the policies."""
    commits = [part for part in found["commit"].split(", ") if not part.startswith("heuristics")]
    alone = {policy: found[policy] for policy in POLICIES if policy in found}
    return {**alone, "commit": ", ".join([*commits, f"heuristics {measuring}"])}


def without_longer(found: Scores) -> Scores:
    """Return a condition's results but for the policy that learns longer, which is to be trained anew."""
    commits = [part for part in found["commit"].split(", ") if not part.startswith("longer")]
    others = {name: scores for name, scores in found.items() if name != "longer"}
    return {**others, "commit": ", ".join(commits)}


def renewed(found: Scores, measuring: str, bar: bool, longer: bool) -> Scores:
    """Return what stays of a condition's results when it is measured anew.

    Args:
        found: the results.
        measuring: the commit that measures.
        bar: whether only heuristics are.
        longer: whether only the policy that learns longer is.
    """
    if not found or not (bar or longer):
        return {}
    found = with_new_bar(found, measuring) if bar else found
    return without_longer(found) if longer else found


def require_another(name: str, found: Scores, policy: str, seed: int) -> None:
    """Raise UsageError unless a condition has a policy of that kind, and it is of another seed."""
    if policy not in found:
        raise UsageError(f"the results hold no policy {policy!r} of {name!r}; train it first, without --another.")
    # Older results do not name the seed, which was 0.
    if seed == found[policy].get("seed", 0):
        raise UsageError(f"the policy {policy!r} of {name!r} has seed {seed} already.")


def with_another(found: Scores, policy: str, scores: Scores) -> Scores:
    """Return a condition's results with the scores of one more seed, in place of earlier ones of that seed."""
    others = [other for other in found[policy].get("others", []) if other["seed"] != scores["seed"]]
    others = sorted([*others, scores], key=lambda other: int(other["seed"]))
    return {**found, policy: {**found[policy], "others": others}}


def reward_of(scores: Scores) -> float:
    """Return the mean reward of a policy's seeds."""
    return fmean(each["reward"][0] for each in (scores, *scores.get("others", [])))


def types_of(scores: Scores) -> str:
    """Return the mean rewards of the types, over a policy's seeds."""
    seeds = [each["types"].values() for each in (scores, *scores.get("others", []))]
    return ", ".join(str(round(fmean(values))) for values in zip(*seeds, strict=True))


def cells_of(found: Scores, policy: str) -> list[str]:
    """Return the two cells about a kind of policy: its reward, further seeds after a comma, and its ratio."""
    if policy not in found:
        return ["-", "-"]
    scores = found[policy]
    rewards = [shown(scores["reward"]), *(f"{other['reward'][0]:.0f}" for other in scores.get("others", []))]
    return [", ".join(rewards), f"{reward_of(scores) / found['heuristics'][0]['reward'][0]:.3f}"]


def page(data: dict[str, Any]) -> str:
    """Return the results as a page."""
    policies = [policy for policy in POLICIES if any(policy in found for found in data["results"].values())]
    ratios = [word for policy in policies for word in (policy, "ratio")]
    head = ("farm", "best heuristic", "", "free", *ratios, "c, m, d: heuristic", "best policy", "commit")
    rows = ["", "| " + " | ".join(head) + " |", "|---|---:|---|" + "---:|" * (len(ratios) + 3) + "---|"]
    plain = data["results"].get("instant")
    for name, found in data["results"].items():
        bar, known = found["heuristics"][0], [found[policy] for policy in policies if policy in found]
        free = plain["heuristics"][0]["reward"][0] / bar["reward"][0] if plain and name in FREE else None
        cells = [name, shown(bar["reward"]), bar["policy"], "" if free is None else f"{free:.3f}"]
        for policy in policies:
            cells += cells_of(found, policy)
        for scores in (bar, max(known, key=reward_of)):
            cells.append(types_of(scores))
        others = [(policy, other) for policy in POLICIES for other in found.get(policy, {}).get("others", [])]
        commits = [found["commit"], *(f"{policy} {other['seed']} {other['commit']}" for policy, other in others)]
        rows.append("| " + " | ".join([*cells, ", ".join(commits)]) + " |")
    longer = " --longer" if any("longer" in found for found in data["results"].values()) else ""
    data = {**data, "command": data["command"] + longer}
    numbers = {name: data[name] for name in ("episodes", "seed")}
    return filled(TEMPLATE, data, tables="\n".join([*rows, ""]), **numbers)


def kept(folder: Path | None) -> dict[str, Scores]:
    """Return the results that a folder holds, by condition."""
    path = folder / "results.json" if folder else None
    if path is None or not path.is_file():
        return {}
    found: dict[str, Scores] = json.loads(path.read_text(encoding="utf-8"))["results"]
    return found


def require_farms(folder: Path | None, farms: Sequence[int]) -> None:
    """Raise UsageError for results of other farms, beside which those of these would stand as if they were alike."""
    path = folder / "results.json" if folder else None
    if path is not None and path.is_file() and json.loads(path.read_text(encoding="utf-8"))["farms"] != list(farms):
        raise UsageError(f"the results in {folder} are of other farms; write these elsewhere.")


def options() -> argparse.Namespace:
    """Return the command line."""
    about = (__doc__ or "").partition("\n")[0]
    parser = argparse.ArgumentParser(prog="python -m research.experiments.conditions", description=about)
    parser.add_argument("name", nargs="*", help="conditions; by default all that the results do not hold")
    parser.add_argument("--episodes", type=int, default=1600)
    parser.add_argument("--longer", action="store_true", help="train one for all episodes of its preset")
    parser.add_argument("--heuristics", action="store_true", help="fly heuristics anew beside policies that are known")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--another", type=int, metavar="SEED", help="add a policy of this seed to the named conditions")
    parser.add_argument("--farms", type=farm_range, default="1020:1100", help="farm seeds A:B, from A to B - 1")
    parser.add_argument("--write", type=Path, help="folder for results.json and README.md")
    parser.add_argument("--keep", type=Path, help="folder for the policies")
    arguments = parser.parse_args()
    if arguments.another is not None and (not arguments.name or not arguments.write):
        parser.error("--another needs the names of conditions, and --write with their results")
    if arguments.another is not None and (arguments.keep or arguments.heuristics):
        parser.error("--another trains and adds a policy; --keep and --heuristics do not go with it")
    if unknown := [name for name in arguments.name if name not in CONDITIONS]:
        parser.error(f"there is no condition {unknown[0]!r}; they are {', '.join(CONDITIONS)}")
    return arguments


def another(name: str, arguments: argparse.Namespace, commit: str) -> Scores:
    """Return the results of a condition with a policy of one more seed."""
    policy, seed = "longer" if arguments.longer else "learned", arguments.another
    config = longer_configuration(name, seed) if arguments.longer else configuration(name, arguments.episodes, seed)
    scores = trained(config, arguments.farms, policy)
    # Another call may have written more about the condition meanwhile.
    return with_another(kept(arguments.write)[name], policy, {**scores, "commit": commit})


def measured(name: str, arguments: argparse.Namespace, commit: str) -> Scores:
    """Return the results of a condition with all that the command line asks for."""
    if arguments.another is not None:
        return another(name, arguments, commit)
    found = kept(arguments.write).get(name, {})
    longer = longer_configuration(name, 0).episodes if arguments.longer else 0
    episodes = Episodes(arguments.episodes, longer)
    if name in arguments.name:
        found = renewed(found, commit, arguments.heuristics, arguments.longer)
    found = {"commit": commit, **found}
    result = compare(name, found, episodes, arguments.seed, arguments.farms, arguments.keep)
    if "longer" in result and "longer" not in found and found["commit"] != commit:
        result["commit"] = f"{found['commit']}, longer {commit}"
    return result


def main() -> int:
    """Train and fly, print what came out, and write it where asked after each condition; return 0."""
    arguments = options()
    torch.set_num_threads(1)
    require_farms(arguments.write, arguments.farms)
    results = kept(arguments.write)
    if arguments.another is not None:
        for name in arguments.name:
            require_another(name, results.get(name, {}), "longer" if arguments.longer else "learned", arguments.another)
    data: dict[str, Any] = {**provenance("research.experiments.conditions"), "farms": list(arguments.farms)}
    # The command for all farms, whichever were measured last.
    data["command"] = (
        f"python -m research.experiments.conditions --episodes {arguments.episodes} --seed {arguments.seed}"
    )
    data |= {"episodes": arguments.episodes, "seed": arguments.seed, "results": results}
    for name in arguments.name or CONDITIONS:
        result = measured(name, arguments, data["commit"])
        # Another call may have written other conditions meanwhile.
        results = {**results, **kept(arguments.write), name: result}
        data["results"] = {key: results[key] for key in CONDITIONS if key in results}
        write_results(data, page, arguments.write)
    return 0


if __name__ == "__main__":
    sys.exit(run_command(main))
