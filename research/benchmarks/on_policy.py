"""Where the time of an environment step goes when learning on policy: microseconds of one core, and the updates' limit.

    python -m research.benchmarks.on_policy [--json] [--preset instant] [--repeats 5] [--write
    research/results/on_policy.json]

flying      the simulator's step, observations included
deciding    the actors' forward passes and the sampled actions
collecting  the whole of a worker's chunk: flying, deciding, random numbers, rows
wire        encoding a chunk, and decoding and checking it
updates     all updates of an iteration, per environment step
at_once     the same as a learner does them, with networks side by side on `learner.update_threads` cores; elapsed time
limit       the updates' multiplications and additions at the speed of a large matrix product of what hidden layers
            multiply, bfloat16 where the processor has it, measured in the same run on one thread
step_bytes  bytes of a step's rows in a chunk

Every time is the least of the repeats. A pass forward costs two operations for each weight and sample, the gradient by
the weights as much again, and the gradient through all layers but the first as much as those.
"""

import argparse
import json
import os
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

if __name__ == "__main__":  # who imports this chooses threads himself
    for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"):
        os.environ.setdefault(_variable, "1")

import numpy as np
import torch

from eia_sec.common.actors import TeamActors, actor_outputs
from eia_sec.common.config import OnPolicyConfig, RunConfig
from eia_sec.common.config.files import with_values
from eia_sec.common.config.presets import preset
from eia_sec.common.farm import farm_team
from eia_sec.common.protocol.chunk_messages import from_message, to_message
from eia_sec.common.protocol.messages import ChunkMessage
from eia_sec.common.team import TeamSpec
from eia_sec.common.transitions import Chunk
from eia_sec.deploy.exit_codes import run_command
from eia_sec.deploy.local.memory import keep_freed_memory
from eia_sec.deploy.reports.provenance import provenance
from eia_sec.learner.networks.device import product_dtype
from eia_sec.learner.on_policy.policies import HEAD
from eia_sec.learner.on_policy.trainer import OnPolicyTrainer
from eia_sec.rollout.worker.action_sampler import ActionSampler
from eia_sec.rollout.worker.collector import Collector

ONE_CORE = {"learner.update_threads": 1}
SQUARE = 1024
"""Rows of the matrices whose product gives the speed of arithmetic."""


def least(work: Callable[[], object], repeats: int) -> float:
    """Return the least of the seconds that `work` takes."""
    seconds = []
    for _ in range(repeats):
        started = time.perf_counter()
        work()
        seconds.append(time.perf_counter() - started)
    return min(seconds)


def matrix_speed(repeats: int, dtype: torch.dtype) -> float:
    """Return operations per second of a large product of this type."""
    a, b, out = (torch.randn(SQUARE, SQUARE).to(dtype) for _ in range(3))
    return 2.0 * SQUARE**3 / least(lambda: torch.mm(a, b, out=out), 10 * repeats)


def operations(config: OnPolicyConfig, team: TeamSpec) -> float:
    """Return the operations of all updates of one environment step's samples."""
    h, total = config.hidden, 0.0
    for group in team.groups:
        first, rest = group.observation_size * h, h * h * (1 if config.memory == "none" else 6)
        last = h * actor_outputs(group, HEAD)
        actor = group.count * (2 * first + 3 * (rest + last))
        own = group.count * (1 + config.ensemble_size) * (2 * first + 3 * (rest + h))
        joint = 2 * team.observation_size * h + 3 * (rest + h * group.count)
        total += actor + (joint if config.sees_team else own)
    return 2.0 * config.epochs * total


def measure(config: RunConfig, repeats: int) -> dict[str, Any]:
    """Return the microseconds of every part, for one environment step."""
    collector = Collector(config, "0", 0)
    trainer = OnPolicyTrainer(with_values(config, ONE_CORE), collector.team)
    actors, environments = trainer.actors(), collector.environments
    chunks: list[Chunk] = []
    collecting = least(lambda: chunks.append(collector.collect(actors, 0.0, uniform=False)), repeats)
    steps, count = chunks[0].rows.steps, len(environments.time)
    flying, deciding = _parts(collector, actors, repeats)
    return {
        "flying": 1e6 * flying / count,
        "deciding": 1e6 * deciding / count,
        "collecting": 1e6 * collecting / steps,
        "wire": 1e6 * least(lambda: _through_the_wire(chunks[0], collector), repeats) / steps,
        **_learning(trainer, collector, chunks, repeats),
        "at_once": measure_updates(config, repeats)["updates"],
        "step_bytes": len(_encoded(chunks[0], collector.team)) / steps,
    }


def measure_updates(config: RunConfig, repeats: int) -> dict[str, float]:
    """Return the microseconds of an iteration's updates, and their limit, for one environment step."""
    collector = Collector(config, "0", 0)
    return _learning(OnPolicyTrainer(config, collector.team), collector, [], repeats)


def _learning(trainer: OnPolicyTrainer, collector: Collector, chunks: list[Chunk], repeats: int) -> dict[str, float]:
    """Return the updates' time and their limit; collect more chunks until an iteration is full."""
    config, version = trainer.config.on_policy, iter(range(1, 10**6))
    while sum(chunk.rows.steps for chunk in chunks) < config.iteration_steps:
        chunks.append(collector.collect(trainer.actors(), 0.0, uniform=False))

    def updates() -> None:
        for chunk in chunks:
            trainer.absorb(chunk, next(version))
            if trainer.updates_due():
                break
        trainer.train(trainer.updates_due())

    steps = chunks[0].rows.steps
    trained = -(-config.iteration_steps // steps) * steps
    learning, speed = least(updates, repeats), matrix_speed(repeats, product_dtype(config.precision, "cpu"))
    return {
        "updates": 1e6 * learning / trained,
        "limit": 1e6 * operations(config, collector.team) / speed,
        "gflops": speed / 1e9,
    }


def _parts(collector: Collector, actors: TeamActors, repeats: int) -> tuple[float, float]:
    """Return seconds of a step of all environments, and of the decisions for it."""
    environments = collector.environments
    observation, sampler = environments.observation, ActionSampler(collector.team)
    random = np.random.default_rng(0)
    normal = random.standard_normal((len(observation), collector.team.action_size), np.float32)
    uniform = random.random(normal.shape, np.float32)
    action = sampler.sample(actors, observation, normal, uniform, None)[2]
    deciding = least(lambda: sampler.sample(actors, observation, normal, uniform, None), 20 * repeats)
    for index in range(len(environments.time)):
        environments.reset(index, index, 0)
    return least(lambda: environments.step(action), 20 * repeats), deciding


def _encoded(chunk: Chunk, team: TeamSpec) -> bytes:
    return to_message(chunk, team, 1, chunk.rows.steps).encode()


def _through_the_wire(chunk: Chunk, collector: Collector) -> None:
    names = collector.environments.spec.metric_names
    rounded = chunk.rows.observation.dtype == np.uint16
    from_message(
        ChunkMessage.decode(_encoded(chunk, collector.team)), collector.team, names, on_policy=True, rounded=rounded
    )


def main() -> int:
    """Measure and print; return 0."""
    parser = argparse.ArgumentParser(
        prog="python -m research.benchmarks.on_policy", description="Time of an environment step."
    )
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.add_argument("--preset", default="instant")
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--write", type=Path, metavar="FILE", help="where the result and its origin go as JSON")
    asked = parser.parse_args()
    torch.set_num_threads(1)
    keep_freed_memory()  # as every process of `eia-sec` does
    config = preset(asked.preset)
    found = measure(config, asked.repeats)
    if asked.write:
        team = farm_team(config.farm).digest
        record = {
            **provenance("research.benchmarks.on_policy"),
            "preset": asked.preset,
            "team": team,
            "load": os.getloadavg()[0],
        }
        asked.write.write_text(json.dumps({**record, **found}, indent=1) + "\n", encoding="utf-8")
    if asked.json:
        sys.stdout.write(json.dumps(found) + "\n")
    else:
        sys.stdout.write("".join(f"{name:>10} {value:8.1f}\n" for name, value in found.items()))
    return 0


if __name__ == "__main__":
    sys.exit(run_command(main))
