"""Time to a fixed reward by the number of workers, where a step takes 20 ms; and the farm on the same cores.

    python -m research.benchmarks.distribution [--json] [--write research/results/distribution] [--workers 1 2 4 8 16
    32] [--seeds 3] python -m research.benchmarks.distribution --redraw --write research/results/distribution

Each run is processes as users start them: a router, so many workers with one environment each, the coordinator, and the
learner last. One environment in real time takes about 2 % of a core, so the workers of one machine with few cores stand
for as many vehicles. All processes compute on one thread, and every run ends by itself: at the reward, or at --limit.

The farm is the preset instant with 1, 2 and 4 workers, for --farm-seconds each (0 leaves it out). With --write, results
are written after each run, and a later call adds to them what is missing.
"""

import argparse
import json
import os
import sys
from pathlib import Path
from typing import Any

from eia_sec.common.errors import UsageError
from eia_sec.deploy.exit_codes import run_command
from eia_sec.deploy.local.threads import thread_environment
from eia_sec.deploy.reports.plots import DPI
from eia_sec.deploy.reports.provenance import provenance
from research.benchmarks.distribution.farm import learn
from research.benchmarks.distribution.report import page, picture
from research.benchmarks.distribution.summary import summary
from research.benchmarks.distribution.training import WINDOW, Task, train

MOST_WORKERS = 256
Line = dict[str, Any]


def options(arguments: list[str] | None = None) -> argparse.Namespace:
    """Return the command line."""
    parser = argparse.ArgumentParser(
        prog="python -m research.benchmarks.distribution", description=(__doc__ or "").partition("\n")[0]
    )
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.add_argument("--write", type=Path, metavar="FOLDER", help="where results.json, page and picture go")
    parser.add_argument("--redraw", action="store_true", help="with --write: only page and picture, from results.json")
    parser.add_argument("--workers", type=int, nargs="+", default=[1, 2, 4, 8, 16, 32], metavar="N")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--limit", type=float, default=Task.limit, help="seconds after which a run is ended")
    parser.add_argument("--farm-workers", type=int, nargs="*", default=[1, 2, 4], metavar="N")
    parser.add_argument("--farm-seconds", type=float, default=60.0, help="measuring time of each; 0 for none")
    asked = parser.parse_args(arguments)
    if not all(1 <= number <= MOST_WORKERS for number in (*asked.workers, *asked.farm_workers)):
        parser.error(f"numbers of workers must be 1 to {MOST_WORKERS}.")
    if asked.redraw and asked.write is None:
        parser.error("--redraw takes the folder from --write.")
    return asked


def fresh(asked: argparse.Namespace) -> Line:
    """Return results without any run."""
    task = Task(limit=asked.limit)
    algorithm = task.config(0).on_policy
    described = {"reward": task.reward, "window": WINDOW, "period": task.period, "chunk_steps": task.chunk_steps}
    described["iteration_steps"] = algorithm.iteration_steps
    origin = {**provenance("research.benchmarks.distribution"), "cores": os.cpu_count(), "nice": os.nice(0)}
    return {**origin, "task": described, "runs": [], "farm": []}


def measure(asked: argparse.Namespace, data: Line) -> None:
    """Do the runs that the results lack, seed by seed, and keep each."""
    done = {(run["workers"], run["seed"]) for run in data["runs"]}
    for seed in range(asked.seeds):
        for workers in asked.workers:
            if (workers, seed) not in done:
                data["runs"].append(train(Task(limit=asked.limit), workers, seed))
                _keep(asked, data, data["runs"][-1])
    farmed = {line["workers"] for line in data["farm"]}
    for workers in asked.farm_workers if asked.farm_seconds else ():
        if workers not in farmed:
            data["farm"].append(learn(workers, asked.farm_seconds))
            _keep(asked, data, data["farm"][-1])


def _keep(asked: argparse.Namespace, data: Line, newest: Line) -> None:
    shown = {name: value for name, value in newest.items() if name != "curve"}
    sys.stderr.write(f"{json.dumps(shown)}\n")
    if asked.write:
        write(data, asked.write)


def write(data: Line, folder: Path) -> None:
    """Write data, page and picture."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "results.json").write_text(json.dumps(data, indent=1) + "\n", encoding="utf-8")
    if data["runs"]:
        (folder / "README.md").write_text(page(data), encoding="utf-8")
        picture(data).savefig(folder / "speedup.png", dpi=DPI)


def read(folder: Path) -> Line:
    """Return earlier results; raise UsageError where there are none."""
    source = folder / "results.json"
    if not source.is_file():
        raise UsageError(f"there is no {source}; leave --redraw out to measure.")
    found: Line = json.loads(source.read_text(encoding="utf-8"))
    return found


def main() -> int:
    """Measure, write and print; return 0."""
    asked = options()
    os.environ.update(thread_environment(1))
    data = read(asked.write) if asked.redraw else fresh(asked)
    if not asked.redraw:
        if asked.write and (asked.write / "results.json").is_file():
            before = read(asked.write)
            if (before["task"], before["commit"]) == (data["task"], data["commit"]):
                data |= {"runs": before["runs"], "farm": before["farm"]}
        measure(asked, data)
    elif asked.write:
        write(data, asked.write)
    if asked.json:
        sys.stdout.write(json.dumps({**data, "summary": summary(data["runs"])}) + "\n")
    elif data["runs"]:
        sys.stdout.write(page(data))
    return 0


if __name__ == "__main__":
    sys.exit(run_command(main))
