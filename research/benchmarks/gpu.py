"""A learner on a GPU that processors feed: updates by width of the networks, and whole runs by number of workers.

    python -m research.benchmarks.gpu [--json] [--widths 64 128 256 512] [--workers 2 6 14] [--processor 1 6] [--seconds
                             15] [--write FOLDER]

Updates are those of one iteration of the preset instant, on the GPU and, with `learner.update_threads`, on the
processor. Whole runs are processes as `eia-sec train` starts them. A worker has fewer environments the more workers
there are, so that their chunks together are at most what an iteration takes in, and policies mostly one version old.
Runs with the learner on the processor are there to compare.
"""

import argparse
import json
import os
import sys
from pathlib import Path
from typing import Any, Final

from eia_sec.deploy.local.threads import thread_environment

if __name__ == "__main__":  # who imports this chooses threads himself
    os.environ.update(thread_environment(1))

import torch

from eia_sec.common.config import RunConfig
from eia_sec.common.config.files import with_values
from eia_sec.common.config.presets import preset
from eia_sec.common.errors import UsageError
from eia_sec.deploy.exit_codes import run_command
from eia_sec.deploy.local.memory import keep_freed_memory
from eia_sec.deploy.reports.provenance import provenance
from research.benchmarks.distribution.farm import learn
from research.benchmarks.on_policy import measure_updates
from research.benchmarks.peers.report import table

TEMPLATE: Final = Path(__file__).with_suffix(".md")
SETTLE_SECONDS: Final = 5.0
Line = dict[str, Any]


def environments(config: RunConfig, workers: int) -> int:
    """Return how many environments a worker has: at least one, and else as many as fill an iteration with chunks."""
    steps = config.on_policy.iteration_steps
    return max(1, min(config.rollout.environments, steps // (config.rollout.chunk_steps * workers)))


def updates(widths: list[int], repeats: int) -> list[Line]:
    """Return the microseconds of an iteration's updates for one environment step, by device and width."""
    lines = []
    for width in widths:
        line: Line = {"width": width}
        for device in ("cpu", "cuda"):
            config = with_values(preset("instant"), {"algorithm.hidden": width, "learner.device": device})
            line[device] = round(measure_updates(config, repeats)["updates"], 2)
        sys.stderr.write(f"{json.dumps(line)}\n")
        lines.append(line)
    return lines


def run(device: str, workers: int, seconds: float) -> Line:
    """Return the rates of a whole run of the preset instant."""
    config = preset("instant")
    each = environments(config, workers)
    config = with_values(config, {"learner.device": device, "rollout.environments": each})
    line = {"device": device, "environments": each, **learn(workers, seconds, config, SETTLE_SECONDS)}
    sys.stderr.write(f"{json.dumps(line)}\n")
    return line


def machine() -> Line:
    """Return what the GPU is, and how many cores there are; raise UsageError without a GPU."""
    if not torch.cuda.is_available():
        raise UsageError("research.benchmarks.gpu needs a CUDA device, and torch finds none.")
    return {"gpu": torch.cuda.get_device_name(), "cores": os.cpu_count()}


def page(data: Line) -> str:
    """Return the results as Markdown."""
    widths = [[str(line["width"]), f"{line['cpu']:.1f}", f"{line['cuda']:.1f}"] for line in data["updates"]]
    runs = [
        [
            {"cpu": "processor", "cuda": "GPU"}[line["device"]],
            *(str(line[name]) for name in ("workers", "environments")),
            f"{line['steps_per_second']:,.0f}",
            f"{line['update_ms']:.2f}",
            *(f"{line[name]:.0%}" for name in ("learner_updating", "workers_waiting", "rejected_share")),
        ]
        for line in data["runs"]
    ]
    head = ["learner", "workers", "environments each", "env steps/s", "an update, ms"]
    return TEMPLATE.read_text(encoding="utf-8").format(
        **{name: data[name] for name in ("command", "commit", "gpu", "cores")},
        torch=data["packages"]["torch"],
        updates="\n".join(table(["width", "processor", "GPU"], widths, 0)),
        runs="\n".join(table([*head, "learner updates", "workers wait", "steps discarded as stale"], runs, 1)),
    )


def write(data: Line, folder: Path) -> None:
    """Write data and page."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "results.json").write_text(json.dumps(data, indent=1) + "\n", encoding="utf-8")
    (folder / "README.md").write_text(page(data), encoding="utf-8")


def options() -> argparse.Namespace:
    """Return the command line."""
    parser = argparse.ArgumentParser(
        prog="python -m research.benchmarks.gpu", description=(__doc__ or "").partition("\n")[0]
    )
    parser.add_argument("--json", action="store_true", help="print JSON, not the page")
    parser.add_argument("--widths", type=int, nargs="*", default=[64, 128, 256, 512], metavar="N")
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--workers", type=int, nargs="*", default=[2, 6, 14], metavar="N", help="of runs on the GPU")
    parser.add_argument("--processor", type=int, nargs="*", default=[1, 6], metavar="N", help="workers of runs without")
    parser.add_argument("--seconds", type=float, default=15.0, help="measuring time of each run")
    parser.add_argument("--write", type=Path, metavar="FOLDER", help="where results.json and README.md go")
    return parser.parse_args()


def main() -> int:
    """Measure, write and print; return 0."""
    asked = options()
    torch.set_num_threads(1)
    data = {**provenance("research.benchmarks.gpu"), **machine()}
    keep_freed_memory()  # as every process of `eia-sec` does
    data["updates"] = updates(asked.widths, asked.repeats)
    runs = [*(("cpu", workers) for workers in asked.processor), *(("cuda", workers) for workers in asked.workers)]
    data["runs"] = []
    if asked.write:
        write(data, asked.write)
    for device, workers in runs:
        data["runs"].append(run(device, workers, asked.seconds))
        if asked.write:
            write(data, asked.write)
    sys.stdout.write(json.dumps(data) + "\n" if asked.json else page(data))
    return 0


if __name__ == "__main__":
    sys.exit(run_command(main))
