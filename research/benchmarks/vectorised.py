"""Environment steps a second of simple_spread, one environment after another and as one batch.

Run `python -m research.benchmarks.vectorised mpe2:simple_spread_v3 vmas:simple_spread jaxmarl:MPE_simple_spread_v3`,
or with those of the three that are installed. Every program takes actions drawn once and resets what has ended,
as a worker does; steps of the environments by processor time of this process, whose libraries get one thread each.
"""

import json
import sys
import time
from contextlib import closing
from typing import Final

import numpy as np

from eia_sec.common.config import EnvConfig, RolloutConfig, RunConfig
from eia_sec.common.config.algorithms import IppoConfig
from eia_sec.rollout.envs.registry import make_environments

SIZES: Final = (8, 64)
SECONDS: Final = 3.0
"""Processor time of a measurement."""


def main(names: list[str]) -> None:
    """Measure, and print a line for each environment and size."""
    for name in names:
        for size in SIZES:
            line = {"environment": name, "environments": size, "steps_a_second": round(_rate(name, size))}
            sys.stdout.write(json.dumps(line) + "\n")
            sys.stdout.flush()


def _rate(name: str, size: int) -> float:
    config = RunConfig(env=EnvConfig(name, steps=25), rollout=RolloutConfig(threads=1), algorithm=IppoConfig())
    with closing(make_environments(config, size)) as environments:
        for index in range(size):
            environments.reset(index, 0, index)
        discrete = any(group.choices for group in environments.team.groups)
        drawn = np.random.default_rng(0).uniform(0.0, 4.0 if discrete else 1.0, (size, environments.team.action_size))
        actions = drawn.astype(np.float32)
        environments.step(actions)  # compiles
        began, steps = time.process_time(), 0
        while time.process_time() - began < SECONDS:
            for index in map(int, np.flatnonzero(environments.ended)):
                environments.reset(index, 1, steps + index)
            environments.step(actions)
            steps += size
        return steps / (time.process_time() - began)


if __name__ == "__main__":
    main(sys.argv[1:])
