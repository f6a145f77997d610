"""EIA-SEC: environment steps per second of the compiled farm, and of the NumPy reference that it is held against.

A batch is stepped by one thread; with more threads each steps a batch of its own, its share of the environments, as
each worker of a run does. Episodes are reset between the timed blocks, not in them.
"""

import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from eia_sec.common.config.presets import preset
from eia_sec.common.team import Float32
from eia_sec.rollout.sim.batch import FarmBatch
from eia_sec.rollout.sim.layout import make_layout
from eia_sec.rollout.sim.reference.farm import ReferenceFarm
from research.benchmarks.peers.clock import BLOCKS, hand_over, simulator_options

DRAWN = 16
"""Random actions that are drawn before the clock starts and then used in turn."""
FARMS = 20


def reset(batch: FarmBatch) -> None:
    """Start an episode in every environment."""
    for index in range(len(batch.time)):
        batch.reset(index, index % FARMS, index)


def actions(environments: int, size: int) -> list[Float32]:
    """Return random actions."""
    draw = np.random.default_rng(0)
    return [draw.uniform(-1, 1, (environments, size)).astype(np.float32) for _ in range(DRAWN)]


def fly(batch: FarmBatch, drawn: list[Float32], steps: int) -> None:
    """Do a number of steps."""
    for step in range(steps):
        batch.step(drawn[step % DRAWN])


def rate(environments: int, threads: int, seconds: float) -> float:
    """Return the environment steps per second of the fastest block."""
    config = preset("study").farm
    count = min(threads, environments)
    batches = [FarmBatch(config, environments // count) for _ in range(count)]
    drawn = actions(environments // count, batches[0].team.environment_action_size)
    with ThreadPoolExecutor(count) as pool:

        def block(steps: int) -> float:
            for batch in batches:
                reset(batch)
            started = time.perf_counter()
            list(pool.map(lambda batch: fly(batch, drawn, steps), batches))
            return time.perf_counter() - started

        once = min(block(5) for _ in range(3)) / 5
        steps = max(1, min(config.world.steps, int(seconds / BLOCKS / once)))
        # As many equal parts as the peers have; one may hold several episodes.
        episodes = max(1, round(seconds / BLOCKS / (steps * once)))
        best = min(sum(block(steps) for _ in range(episodes)) for _ in range(BLOCKS))
    return episodes * steps * (environments // count) * count / best


def reference_rate(seconds: float) -> float:
    """Return the environment steps per second of the reference."""
    config = preset("study").farm
    farm = ReferenceFarm(config, make_layout(config, 0), 0)
    drawn = actions(1, 2 * config.world.uavs)
    farm.step(drawn[0][0])
    started = time.perf_counter()
    farm.step(drawn[1][0])
    once = time.perf_counter() - started
    steps = max(1, min(config.world.steps // 2 // BLOCKS, int(seconds / BLOCKS / once)))
    best = float("inf")
    for _ in range(BLOCKS):
        started = time.perf_counter()
        for step in range(steps):
            farm.step(drawn[step % DRAWN][0])
        best = min(best, time.perf_counter() - started)
    return steps / best


def main() -> None:
    """Measure and print."""
    options = simulator_options("EIA-SEC").parse_args()
    same = {"agents": preset("study").farm.world.uavs, "threads": options.threads, "processes": 1}
    lines = [
        {
            "software": "EIA-SEC",
            "case": "farm",
            "environments": environments,
            **same,
            "env_steps_per_second": rate(environments, options.threads, options.seconds),
        }
        for environments in options.batches
        if environments >= options.threads
    ]
    if options.threads == 1:
        found = reference_rate(options.seconds)
        lines.append(
            {"software": "NumPy reference", "case": "farm", "environments": 1, **same, "env_steps_per_second": found}
        )
    hand_over(lines, "numpy", "numba")


if __name__ == "__main__":
    main()
