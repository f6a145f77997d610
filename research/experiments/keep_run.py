r"""Keep a finished run: its curves, pictures and evaluation under research/results, its policy inside the package.

With `--condition` its policy becomes the one that learned longer on a farm of `research.experiments.conditions`. It
takes the place of those that are there, or with `--add` joins them.

python -m research.experiments.keep_run runs/default-... --commit abc1234 --ship
python -m research.experiments.keep_run runs/long-... --commit abc1234 --ship --policy trained:long \
    --output research/results/long
python -m research.experiments.keep_run runs/battery-... --commit abc1234 --condition batteries --ship
"""

import json
import shutil
import sys
from dataclasses import dataclass, replace
from pathlib import Path

import tyro

from eia_sec.common.config import RunConfig
from eia_sec.common.errors import UsageError
from eia_sec.common.policy_file import POLICY, load_policy, save_policy
from eia_sec.deploy.exit_codes import run_command
from eia_sec.deploy.local.run_directory import RunDirectory
from eia_sec.deploy.reports.provenance import provenance
from eia_sec.rollout.evaluation import evaluate
from eia_sec.rollout.policies import policy_of
from eia_sec.rollout.shipped_policies import SHIPPED
from research.experiments.condition_farms import CONDITIONS, longer_configuration, longer_preset
from research.experiments.conditions import (
    Scores,
    flown,
    kept,
    page,
    require_another,
    with_another,
    without_longer,
)
from research.experiments.reporting import last_status, store_results


@dataclass(frozen=True)
class Arguments:
    """Keep a finished run."""

    run_dir: tyro.conf.Positional[Path]
    """The run directory."""
    commit: str
    """Commit that made the run."""
    output: Path | None = None
    """Where its results go: research/results/instant, or research/results/conditions with a condition."""
    condition: str = ""
    """Name of the condition of which it becomes a policy."""
    add: bool = False
    """Keep the condition's policies of other seeds beside it."""
    at_once: int = 1
    """Runs that the machine trained at the same time, which makes their times longer."""
    ship: bool = False
    """Make its policy one that ships with the package, in 16-bit numbers."""
    policy: str = "trained:instant"
    """Name of the policy that it then is; trained:long for a run of the preset long. With a condition it is that of the
    preset of its longer policy."""


def main() -> int:
    """Keep a run as a page of its own or as a condition's policy, and ship the policy where asked for; return 0."""
    arguments = tyro.cli(Arguments, prog="python -m research.experiments.keep_run")
    if arguments.add and not arguments.condition:
        raise UsageError("--add joins a condition's policies; name it with --condition.")
    if arguments.condition:
        keep_for_condition(arguments, arguments.output or Path("research/results/conditions"))
    else:
        keep_page(arguments, arguments.output or Path("research/results/instant"))
    return 0


def keep_for_condition(arguments: Arguments, folder: Path) -> None:
    """Write the scores of a run's policy into the results of a condition; ship the policy where asked for.

    Raises:
        UsageError: see `require_fitting`.
    """
    name, run = arguments.condition, arguments.run_dir
    config, last = RunDirectory(run).configuration(), last_status(run)
    require_fitting(arguments, config, kept(folder))
    farms = json.loads((folder / "results.json").read_text(encoding="utf-8"))["farms"]
    policy = policy_of(str(run / POLICY), config.farm)
    scores = flown(config.farm, policy, "longer", range(farms[0], farms[-1] + 1))
    scores |= {"seed": config.seed, "seconds": round(last["elapsed"], 1), "steps": last["environment_steps"]}
    # Another call may have written more meanwhile.
    data = json.loads((folder / "results.json").read_text(encoding="utf-8"))
    found = data["results"][name]
    if arguments.add:
        found = with_another(found, "longer", {**scores, "commit": arguments.commit})
    else:
        found = {**without_longer(found), "longer": scores}
        found["commit"] = f"{found['commit']}, longer {arguments.commit}"
    data["results"][name] = found
    store_results(data, page, folder)
    sys.stdout.write(f"{name}: {scores['reward'][0]:.0f} with seed {config.seed}\n")
    if arguments.ship:
        base = longer_preset(name)
        command = f"eia-sec train --preset {base} --seed {config.seed} --episodes {config.episodes}"
        origin = {"command": command, "commit": arguments.commit, "seed": config.seed, "episodes": last["episodes"]}
        metadata = {key: str(value) for key, value in origin.items()}
        ship("trained" if base == "inertial" else f"trained:{base}", run, metadata)


def require_fitting(arguments: Arguments, config: RunConfig, results: dict[str, Scores]) -> None:
    """Refuse what cannot be kept for a condition.

    Raises:
        UsageError: the results do not hold the condition; the run has other settings than it; there are no policies to
            join, or one of its seed; or its policy is to ship, and the farm is not a preset's own.
    """
    name, run = arguments.condition, arguments.run_dir
    if name not in CONDITIONS or name not in results:
        raise UsageError(f"the results hold no condition {name!r}; they hold {', '.join(results) or 'none'}.")
    if config != replace(longer_configuration(name, config.seed), episodes=config.episodes):
        raise UsageError(f"the run {run} has other settings than {name!r}.")
    if arguments.add:
        require_another(name, results[name], "longer", config.seed)
    if arguments.ship and CONDITIONS[name][1]:
        raise UsageError(f"the farm of {name!r} is not a preset's own, so no policy of it ships.")


def ship(name: str, run: Path, metadata: dict[str, str]) -> None:
    """Write a run's policy into the package as the one of this name, in 16-bit numbers."""
    save_policy(SHIPPED[name][1], load_policy(run / POLICY)[0], metadata, half=True)


def keep_page(arguments: Arguments, output: Path) -> None:
    """Copy results into a folder of their own, and ship the policy where asked for."""
    source = arguments.run_dir
    output.mkdir(parents=True, exist_ok=True)
    for name in ("curves.png", "trajectories.png", "config.toml"):
        shutil.copyfile(source / name, output / name)
    outcome = json.loads((source / "evaluation.json").read_text(encoding="utf-8"))
    # The folder of the run is of no use to anybody else.
    words = outcome["command"].split()
    if "--run-dir" in words:
        del words[words.index("--run-dir") : words.index("--run-dir") + 2]
    outcome |= {"command": " ".join(words), "commit": arguments.commit, "packages": provenance("")["packages"]}
    outcome["at_once"] = arguments.at_once
    last = last_status(source)
    outcome |= {key: last[key] for key in ("episodes", "environment_steps", "updates", "ledger")}
    if arguments.ship:
        config = RunDirectory(source).configuration()
        metadata = {key: str(outcome[key]) for key in ("command", "commit", "seed", "episodes", "updates")}
        ship(arguments.policy, source, metadata)
        farms, policy = config.unseen(config.evaluation.farms), policy_of(arguments.policy, config.farm)
        shipped = evaluate(config.farm, policy, farms, 1, name="trained")
        outcome["evaluations"].append(shipped.to_dict())
    (output / "evaluation.json").write_text(json.dumps(outcome) + "\n", encoding="utf-8")


if __name__ == "__main__":
    sys.exit(run_command(main))
