"""Milliseconds of one update off policy: by compiled kernels, and by torch's own operations.

    python -m research.benchmarks.kernels [--updates 300] [--widths 64] [--algorithms eia-sec maddpg matd3 masac]

Both do the same updates of the same batch, of the sizes of the preset `eia-sec`, in turns on one thread.
"""

import argparse
import json
import os
import sys
import time
from collections.abc import Callable

for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")

import numpy as np  # noqa: E402  (the variables above count only before numpy is loaded)
import torch  # noqa: E402  (as above)
from torch import Tensor  # noqa: E402  (as above)

from eia_sec.common.config import ALGORITHM_CONFIGS, OffPolicyConfig  # noqa: E402  (as above)
from eia_sec.common.config.files import with_values  # noqa: E402  (as above)
from eia_sec.common.config.presets import preset  # noqa: E402  (as above)
from eia_sec.common.farm import farm_team  # noqa: E402  (as above)
from eia_sec.common.team import TeamSpec  # noqa: E402  (as above)
from eia_sec.deploy.reports.provenance import provenance  # noqa: E402  (as above)
from eia_sec.learner.off_policy.algorithm import Batch  # noqa: E402  (as above)
from eia_sec.learner.off_policy.engine import Engine  # noqa: E402  (as above)
from eia_sec.learner.registry import OFF_POLICY  # noqa: E402  (as above)

KNOWN = [name for name in OFF_POLICY if ALGORITHM_CONFIGS[name].continuous_actions]
"""Algorithms that train the farm of the paper, whose actions are continuous."""
BURST = 2
CORES = {"kernels": 1, "torch": 0}
"""What computes, by the number of cores that it takes for compiled kernels."""


def random_batch(config: OffPolicyConfig, team: TeamSpec) -> Batch:
    """Return a batch of noise."""
    generator, rows = torch.Generator().manual_seed(0), config.batch

    def normal(*shape: int) -> Tensor:
        return torch.randn(*shape, generator=generator)

    return Batch(
        normal(rows, team.observation_size),
        normal(rows, team.action_size).tanh(),
        normal(rows, team.agents),
        normal(rows, team.observation_size),
        (normal(rows) > 1.0).float(),
    )


def in_turns(variants: dict[str, Callable[[], object]], bursts: int) -> dict[str, dict[str, float]]:
    """Return for each variant the least and the median milliseconds of one update, timed in turns."""
    seconds: dict[str, list[float]] = {name: [] for name in variants}
    for _ in range(bursts):
        for name, update in variants.items():
            started = time.perf_counter()
            for _ in range(BURST):
                update()
            seconds[name].append((time.perf_counter() - started) / BURST)
    return {
        name: {"ms": round(1e3 * min(found), 3), "median_ms": round(1e3 * float(np.median(found)), 3)}
        for name, found in seconds.items()
    }


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        prog="python -m research.benchmarks.kernels", description="Time of one update by kernels and by torch."
    )
    parser.add_argument("--algorithms", nargs="+", default=KNOWN, choices=KNOWN)
    parser.add_argument("--widths", type=int, nargs="+", default=[preset("eia-sec").algorithm.hidden])
    parser.add_argument("--updates", type=int, default=300)
    options = parser.parse_args()
    torch.set_num_threads(1)
    lines = []
    for name in options.algorithms:
        for width in options.widths:
            run = with_values(preset("eia-sec"), {"algorithm.name": name, "algorithm.hidden": width})
            team, config = farm_team(run.farm), run.off_policy
            batch = random_batch(config, team)
            variants: dict[str, Callable[[], object]] = {}
            for way, cores in CORES.items():
                engine = Engine(config, team, 0, cores=cores)
                variants[way] = lambda engine=engine, batch=batch: engine.update(batch)
            in_turns(variants, 10)
            lines.append({"algorithm": name, "width": width, **in_turns(variants, options.updates // BURST)})
    sys.stdout.write(json.dumps({**provenance("research.benchmarks.kernels"), "lines": lines}, indent=1) + "\n")


if __name__ == "__main__":
    main()
