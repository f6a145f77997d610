"""Keep a finished run: its curves, pictures and evaluation under docs/results, its policy inside the package.

With `--condition` a run becomes a policy `longer` of where learning pays (`experiments.conditions`). It takes the place
of those that are there, or with `--add` joins them.

python -m experiments.keep_run runs/default-... --commit abc1234 --ship
python -m experiments.keep_run runs/long-... --commit abc1234 --ship --policy trained:long --output docs/results/long
python -m experiments.keep_run runs/battery-... --commit abc1234 --condition batteries --ship --policy trained:battery
"""

import json
import shutil
import sys
from dataclasses import dataclass
from pathlib import Path

import tyro

from common.errors import UsageError
from common.policy_file import load_policy, save_policy
from deploy.exit_codes import run_command
from deploy.local.run_directory import METRICS, POLICY, RunDirectory
from deploy.reports.provenance import provenance
from deploy.reports.run_report import read_metrics
from experiments.conditions import CONDITIONS, configuration, flown, page, with_another, without_longer
from rollout.evaluation import evaluate
from rollout.policies import SHIPPED, policy_of

CURVE_POINTS = 400
"""Episode records of a curve that are kept."""


@dataclass(frozen=True)
class Arguments:
    """Keep a finished run."""

    run_dir: tyro.conf.Positional[Path]
    """The run directory."""
    commit: str
    """Commit that made the run."""
    output: Path | None = None
    """Where its results go: docs/results/default, or docs/results/conditions with a condition."""
    condition: str = ""
    """Name of the condition of which it becomes a policy."""
    add: bool = False
    """Keep the condition's policies of other seeds beside it."""
    ship: bool = False
    """Make its policy one that ships with the package, in 16-bit numbers."""
    policy: str = "trained"
    """Name of the policy that it then is; trained:long for a run of the preset long."""


def main() -> int:
    """Keep a run as a page of its own or as a condition's policy, and ship the policy where asked for; return 0."""
    arguments = tyro.cli(Arguments, prog="python -m experiments.keep_run")
    if arguments.condition:
        keep_for_condition(arguments)
    else:
        keep_page(arguments, arguments.output or Path("docs/results/default"))
    return 0


def keep_for_condition(arguments: Arguments) -> None:
    """Write the scores of a run's policy into the results of a condition; ship the policy where asked for.

    Raises:
        UsageError: there is no such condition, or the run is of another farm.
    """
    name, folder = arguments.condition, arguments.output or Path("docs/results/conditions")
    if name not in CONDITIONS:
        raise UsageError(f"there is no condition {name!r}; they are {', '.join(CONDITIONS)}.")
    config, records = RunDirectory(arguments.run_dir).configuration(), read_metrics(arguments.run_dir / METRICS)
    if config.farm != configuration(name, config.episodes, config.seed).farm:
        raise UsageError(f"the run {arguments.run_dir} is of another farm than {name!r}.")
    data = json.loads((folder / "results.json").read_text(encoding="utf-8"))
    farms = range(data["farms"][0], data["farms"][-1] + 1)
    last = [record for record in records if record["kind"] == "status"][-1]
    policy = policy_of(str(arguments.run_dir / POLICY), config.farm)
    scores = flown(config.farm, policy, "longer", farms)
    scores |= {"seed": config.seed, "seconds": round(last["elapsed"], 1), "steps": last["environment_steps"]}
    found = data["results"][name]
    if arguments.add:
        found = with_another(found, "longer", {**scores, "commit": arguments.commit})
    else:
        found = {**without_longer(found), "longer": scores}
        found["commit"] = f"{found['commit']}, longer {arguments.commit}"
    data["results"][name] = found
    (folder / "results.json").write_text(json.dumps(data, indent=1) + "\n", encoding="utf-8")
    (folder / "README.md").write_text(page(data), encoding="utf-8")
    sys.stdout.write(f"{name}: {scores['reward'][0]:.0f} with seed {config.seed}\n")
    if arguments.ship:
        command = f"eia-sec train --preset {CONDITIONS[name][0]} --seed {config.seed}"
        origin = {"command": command, "commit": arguments.commit, "seed": config.seed, "episodes": last["episodes"]}
        ship(arguments, {key: str(value) for key, value in origin.items()})


def ship(arguments: Arguments, metadata: dict[str, str]) -> None:
    """Write the run's policy into the package, in 16-bit numbers."""
    save_policy(SHIPPED[arguments.policy][1], load_policy(arguments.run_dir / POLICY)[0], metadata, half=True)


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
    records = read_metrics(source / METRICS)
    last = [record for record in records if record["kind"] == "status"][-1]
    outcome |= {key: last[key] for key in ("episodes", "environment_steps", "updates", "ledger")}
    if arguments.ship:
        config = RunDirectory(source).configuration()
        ship(arguments, {key: str(outcome[key]) for key in ("command", "commit", "seed", "episodes", "updates")})
        first, count = config.evaluation.first_farm, config.evaluation.farms
        shipped = evaluate(
            config.farm, policy_of(arguments.policy, config.farm), range(first, first + count), 1, name="trained"
        )
        outcome["evaluations"].append(shipped.to_dict())
    (output / "evaluation.json").write_text(json.dumps(outcome) + "\n", encoding="utf-8")
    episodes = [record for record in records if record["kind"] == "episodes"]
    thinned = episodes[:: max(1, len(episodes) // CURVE_POINTS)]
    events = [record for record in records if record["kind"] == "imitation"]
    lines = [json.dumps(record) for record in [*thinned, *events]]
    (output / "curves.jsonl").write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    sys.exit(run_command(main))
