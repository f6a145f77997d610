"""Where the time of an environment step goes when learning on policy: microseconds of one core, and the updates' limit.

    python -m benchmarks.on_policy [--json] [--preset default] [--repeats 5]

flying      the simulator's step, observations included
deciding    the actors' forward passes and the sampled actions
collecting  the whole of a worker's chunk: flying, deciding, random numbers, rows
wire        encoding a chunk, and decoding and checking it
updates     all updates of an iteration, per environment step
limit       the updates' multiplications and additions at the speed of a large matrix product of the same precision,
            measured in the same run on one thread

Every time is the least of the repeats. A pass forward costs two operations for each weight and sample, the gradient by
the weights as much again, and the gradient through all layers but the first as much as those.
"""

import argparse
import json
import os
import sys
import time
from collections.abc import Callable
from typing import Any

for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")

import numpy as np  # noqa: E402  (the variables above count only before numpy is loaded)
import torch  # noqa: E402  (as above)

from common.actors import actor_outputs  # noqa: E402  (as above)
from common.config import OnPolicyConfig, RunConfig  # noqa: E402  (as above)
from common.config.presets import preset  # noqa: E402  (as above)
from common.protocol.chunk_messages import from_message, to_message  # noqa: E402  (as above)
from common.protocol.messages import ChunkMessage  # noqa: E402  (as above)
from common.team import TeamSpec  # noqa: E402  (as above)
from common.transitions import Chunk  # noqa: E402  (as above)
from deploy.exit_codes import run_command  # noqa: E402  (as above)
from learner.on_policy.policies import HEAD  # noqa: E402  (as above)
from learner.on_policy.trainer import OnPolicyTrainer  # noqa: E402  (as above)
from rollout.worker.collector import Collector  # noqa: E402  (as above)

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


def matrix_speed(repeats: int) -> float:
    """Return operations per second of a large product at the precision that torch is set to."""
    a, b, out = (torch.randn(SQUARE, SQUARE) for _ in range(3))
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
    trainer = OnPolicyTrainer(config, collector.team)
    actors, environments = trainer.actors(), collector.environments
    chunks: list[Chunk] = []
    collecting = least(lambda: chunks.append(collector.collect(actors, 0.0, uniform=False)), repeats)
    steps, count = chunks[0].rows.steps, len(environments.time)
    version = iter(range(1, 10**6))

    def updates() -> None:
        for chunk in chunks:
            trainer.absorb(chunk, next(version))
            if trainer.updates_due():
                break
        trainer.train(trainer.updates_due())

    trained = -(-config.on_policy.iteration_steps // steps) * steps
    while len(chunks) * steps < trained:
        chunks.append(collector.collect(actors, 0.0, uniform=False))
    learning = least(updates, repeats)
    speed = matrix_speed(repeats)
    flying, deciding = _parts(collector, actors, repeats)
    return {
        "flying": 1e6 * flying / count,
        "deciding": 1e6 * deciding / count,
        "collecting": 1e6 * collecting / steps,
        "wire": 1e6 * least(lambda: _through_the_wire(chunks[0], collector), repeats) / steps,
        "updates": 1e6 * learning / trained,
        "limit": 1e6 * operations(config.on_policy, collector.team) / speed,
        "gflops": speed / 1e9,
    }


def _parts(collector: Collector, actors: Any, repeats: int) -> tuple[float, float]:
    """Return seconds of a step of all environments, and of the decisions for it."""
    environments, team = collector.environments, collector.team
    random = np.random.default_rng(0)
    normal = random.standard_normal((len(environments.time), team.action_size), np.float32)
    uniform = random.random(normal.shape, np.float32)
    action = team.adapt(environments.observation, actors.sample(environments.observation, normal, uniform)[0])
    deciding = least(lambda: actors.sample(environments.observation, normal, uniform), 20 * repeats)
    for index in range(len(environments.time)):
        environments.reset(index, index, 0)
    return least(lambda: environments.step(action), 20 * repeats), deciding


def _through_the_wire(chunk: Chunk, collector: Collector) -> None:
    data = to_message(chunk, collector.team, 1, chunk.rows.steps).encode()
    names = collector.environments.spec.metric_names
    from_message(ChunkMessage.decode(data), collector.team, names, on_policy=True)


def main() -> int:
    """Measure and print; return 0."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.on_policy", description="Time of an environment step.")
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.add_argument("--preset", default="default")
    parser.add_argument("--repeats", type=int, default=5)
    asked = parser.parse_args()
    torch.set_num_threads(1)
    found = measure(preset(asked.preset), asked.repeats)
    if asked.json:
        sys.stdout.write(json.dumps(found) + "\n")
    else:
        sys.stdout.write("".join(f"{name:>10} {value:8.1f}\n" for name, value in found.items()))
    return 0


if __name__ == "__main__":
    sys.exit(run_command(main))
