"""What several learners make of an iteration's updates, beside one learner, in pairs.

    python -m research.benchmarks.learners [--learners 2] [--preset instant] [--repeats 5] [--json]

Each repeat does an iteration with one learner, then one with the group; both have one thread a learner. The rows are
the same, flown once by a fresh policy, and no worker runs meanwhile.

speed_up    steps a second of the group over those of one learner in the same repeat: median, least and largest
processor   processor seconds of one learner for an iteration over those of the group's leader, median: the speed-up
            on cores that nothing else uses, if learners never waited for each other
exchange    share of the leader's time in which it exchanges rows and gradients or waits for the others, median
"""

import argparse
import json
import os
import statistics
import sys
import time

if __name__ == "__main__":  # who imports this chooses threads himself
    for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"):
        os.environ.setdefault(_variable, "1")

import torch

from eia_sec.common.config import RunConfig
from eia_sec.common.config.files import with_values
from eia_sec.common.config.presets import preset
from eia_sec.common.transitions import Chunk
from eia_sec.deploy.exit_codes import run_command
from eia_sec.deploy.local.learner_group import leading
from eia_sec.deploy.local.learners import Place, require_learners
from eia_sec.learner.on_policy.trainer import OnPolicyTrainer
from eia_sec.rollout.worker.collector import Collector


def iteration(trainer: OnPolicyTrainer, chunks: list[Chunk]) -> tuple[float, float]:
    """Learn from the chunks; return the seconds and this process's processor seconds."""
    for chunk in chunks:
        trainer.absorb(chunk, trainer.version)
    started, used = time.perf_counter(), time.process_time()
    trainer.train(trainer.updates_due())
    return time.perf_counter() - started, time.process_time() - used


def measure(config: RunConfig, learners: int, repeats: int) -> dict[str, float]:
    """Return the numbers of the module's docstring.

    Args:
        config: the run.
        learners: how many the group has.
        repeats: pairs of iterations, after one that is not counted.
    """
    require_learners(config, learners, lockstep=False)
    collector = Collector(config, "0", 0)
    one, chunks = OnPolicyTrainer(config, collector.team), list[Chunk]()
    while sum(chunk.rows.steps for chunk in chunks) < config.on_policy.iteration_steps:
        chunks.append(collector.collect(one.actors(), 0.0, uniform=False))
    speed_ups, processors, exchanges, alone = [], [], [], []
    with leading(Place(0, learners), config, collector.team) as group:
        assert group is not None
        led = OnPolicyTrainer(config, collector.team, group)
        for repeat in range(repeats + 1):
            seconds, used = iteration(one, chunks)
            exchanged = group.seconds
            group_seconds, group_used = iteration(led, chunks)
            if repeat:
                alone.append(seconds)
                speed_ups.append(seconds / group_seconds)
                processors.append(used / group_used)
                exchanges.append((group.seconds - exchanged) / group_seconds)
    steps = sum(chunk.rows.steps for chunk in chunks)
    return {
        "learners": learners,
        "steps_per_second": steps / statistics.median(alone),
        "speed_up": statistics.median(speed_ups),
        "speed_up_least": min(speed_ups),
        "speed_up_most": max(speed_ups),
        "processor": statistics.median(processors),
        "exchange": statistics.median(exchanges),
    }


def main() -> None:
    """Measure, and print what was found."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--learners", type=int, default=2)
    parser.add_argument("--preset", default="instant")
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    torch.set_num_threads(1)
    config = with_values(preset(options.preset), {"learner.update_threads": 1})
    found = measure(config, options.learners, options.repeats)
    if options.json:
        sys.stdout.write(json.dumps(found) + "\n")
        return
    for name, number in found.items():
        sys.stdout.write(f"{name:16} {number:,.3f}\n")


if __name__ == "__main__":
    sys.exit(run_command(main))
