"""Milliseconds of one update round of all agents, beside the time that its arithmetic alone would take.

    python -m benchmarks.learner [--json] [--widths 64 128] [--threads 1 2] [--rounds 300]

A round includes drawing its batch from a full replay buffer. The limit divides the multiplications and additions of
the matrix products of a round by the speed of a large matrix product on as many threads.
"""

import argparse
import json
import sys
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import torch

from common.config import AlgorithmConfig, ReplayConfig, RunConfig
from common.team import TeamSpec, farm_team
from common.transitions import TRANSITION, Chunk, Rows
from learner.arithmetic import choose_products
from learner.inputs import critic_width
from learner.trainer import Trainer

ALGORITHMS = {
    "EIA-SEC": AlgorithmConfig(),
    "no ensemble": AlgorithmConfig(ensemble=False),
    "no ensemble, joint critics": AlgorithmConfig(ensemble=False, critic_scope="joint"),
}
SEGMENT = 20
BURST = 2
"""Rounds timed together."""


def fastest(work: Callable[[], None], repeats: int) -> float:
    """Return the least of the seconds that `work` takes, which other processes disturb least."""
    seconds = []
    for _ in range(repeats):
        started = time.perf_counter()
        work()
        seconds.append(time.perf_counter() - started)
    return min(seconds)


def matrix_speed() -> float:
    """Return the floating-point operations per second of a product of two 1024 x 1024 matrices."""
    a, b, out = (torch.randn(1024, 1024) for _ in range(3))

    def work() -> None:
        torch.mm(a, b, out=out)

    return 2 * 1024**3 / fastest(work, 100)


def operations(algorithm: AlgorithmConfig, team: TeamSpec) -> float:
    """Return the floating-point operations of a round's matrix products.

    A forward pass costs m multiplications a row, m being the weights; the gradient by the weights as many again, the
    gradient through a layer its weights. Per round and agent: the actor runs forward twice and backward once; the local
    critic and each member run forward three times, backward once by the weights and once down to the action.
    """
    h, total = algorithm.hidden, 0
    for kind, group in enumerate(team.groups):
        seen = critic_width(team, kind, algorithm.critic_scope == "joint")
        critics = 1 + (algorithm.ensemble_members if algorithm.ensemble else 0)
        critic = seen * h + h * h + h
        actor = group.observation_size * h + h * h + h * group.action_size
        by_weights = critic + h * h + h
        by_action = h * h + h + group.action_size * h
        actor_backward = actor + h * h + h * group.action_size
        per_row = 2 * actor + actor_backward + critics * (3 * critic + by_weights + by_action)
        total += group.count * per_row
    return 2.0 * algorithm.batch * total


def filled_trainer(algorithm: AlgorithmConfig) -> Trainer:
    """Return a trainer on the default farm's team whose replay buffer is full of noise."""
    config = RunConfig(algorithm=algorithm, replay=ReplayConfig(capacity=65_536, warmup_steps=0))
    team = farm_team(config.farm)
    trainer, draw = Trainer(config, team), np.random.default_rng(0)
    count = 4096 // (SEGMENT + 1) * (SEGMENT + 1)
    flag = np.full(count, TRANSITION, np.uint8)
    flag[SEGMENT :: SEGMENT + 1] = 0
    rows = Rows(
        draw.uniform(-1, 1, (count, team.observation_size)).astype(np.float32),
        draw.uniform(-1, 1, (count, team.action_size)).astype(np.float32),
        draw.normal(size=(count, team.agents)).astype(np.float32),
        flag,
    )
    while trainer.replay.occupancy < 1.0:
        trainer.absorb(Chunk(rows))
    return trainer


def measure(name: str, width: int, threads: int, rounds: int, speed: float) -> dict[str, str | int | float]:
    """Return one line of the result."""
    trainer = filled_trainer(replace(ALGORITHMS[name], hidden=width))
    trainer.train(10 * BURST)
    seconds = fastest(lambda: trainer.train(BURST), max(1, rounds // BURST)) / BURST
    limit = operations(trainer.config.algorithm, trainer.team) / speed
    return {
        "algorithm": name,
        "width": width,
        "agents": trainer.team.agents,
        "threads": threads,
        "ms": round(1e3 * seconds, 3),
        "limit_ms": round(1e3 * limit, 3),
    }


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description="Time of one update round.")
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.add_argument("--widths", type=int, nargs="+", default=[64, 128])
    parser.add_argument("--threads", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--rounds", type=int, default=300)
    options = parser.parse_args()
    choose_products()
    lines = []
    for threads in options.threads:
        torch.set_num_threads(threads)
        speed = matrix_speed()
        lines += [measure(n, w, threads, options.rounds, speed) for w in options.widths for n in ALGORITHMS]
    if options.json:
        sys.stdout.write(json.dumps({"rounds": lines}) + "\n")
        return
    for line in lines:
        sys.stdout.write(
            "{algorithm:28} width {width:4} threads {threads} {ms:8.2f} ms, limit {limit_ms:.2f}\n".format(**line)
        )


if __name__ == "__main__":
    main()
