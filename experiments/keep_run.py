"""Keep a finished run: its curves, pictures and evaluation under docs/results, its policy inside the package.

python -m experiments.keep_run runs/default-... --commit abc1234 --ship
python -m experiments.keep_run runs/long-... --commit abc1234 --ship --policy trained:long --output docs/results/long
"""

import json
import shutil
from dataclasses import dataclass
from pathlib import Path

import tyro

from common.policy_file import load_policy, save_policy
from deploy.local.run_directory import METRICS, POLICY, RunDirectory
from deploy.reports.provenance import provenance
from deploy.reports.run_report import read_metrics
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
    output: Path = Path("docs/results/default")
    """Where its results go."""
    ship: bool = False
    """Make its policy one that ships with the package, in 16-bit numbers."""
    policy: str = "trained"
    """Name of the policy that it then is; trained:long for a run of the preset long."""


def main() -> None:
    """Copy results, and ship the policy where asked for."""
    arguments = tyro.cli(Arguments, prog="python -m experiments.keep_run")
    source, output = arguments.run_dir, arguments.output
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
        metadata = {key: str(outcome[key]) for key in ("command", "commit", "seed", "episodes", "updates")}
        save_policy(SHIPPED[arguments.policy][1], load_policy(source / POLICY)[0], metadata, half=True)
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
    main()
