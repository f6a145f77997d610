"""Milliseconds of one update round of all agents, beside the time that its arithmetic alone would take; and decisions.

    python -m benchmarks.learner [--json] [--widths 64 128 256] [--threads 1] [--rounds 300]
    python -m benchmarks.learner --growth docs/results/learner

A round includes drawing its batch from a full replay buffer. The limit divides the multiplications and additions of
the matrix products of a round by the speed of a large matrix product on as many threads, measured in the same run. A
decision takes all UAVs of one time step from observations to actions. Every time is the least of many.

`--growth` measures how a round grows with agents, width and batch, and writes growth.json, growth.md and growth.png.
"""

import argparse
import json
import os
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")

import numpy as np  # noqa: E402  (the variables above count only before numpy is loaded)
import torch  # noqa: E402  (as above)

from common.actors import ActorBank  # noqa: E402  (as above)
from common.config import AlgorithmConfig, FarmConfig, ReplayConfig, RunConfig, WorldConfig  # noqa: E402  (as above)
from common.team import TeamSpec, farm_team  # noqa: E402  (as above)
from common.transitions import TRANSITION, Chunk, Rows  # noqa: E402  (as above)
from deploy.provenance import provenance  # noqa: E402  (as above)
from learner.algorithms import ALGORITHMS  # noqa: E402  (as above)
from learner.arithmetic import choose_products  # noqa: E402  (as above)
from learner.inputs import critic_width  # noqa: E402  (as above)
from learner.trainer import Trainer  # noqa: E402  (as above)

TIMED = ("eia-sec", "base", "maddpg", "matd3", "masac")
UAVS = (6, 12, 16, 20, 24, 96)
SEGMENT = 20
Line = dict[str, Any]


def fastest(work: Callable[[], object], repeats: int) -> float:
    """Return the least of the seconds that `work` takes, which other processes disturb least."""
    seconds = []
    for _ in range(repeats):
        started = time.perf_counter()
        work()
        seconds.append(time.perf_counter() - started)
    return min(seconds)


def matrix_speed() -> float:
    """Return the floating-point operations per second of a product of two 512 x 512 matrices, the best of many."""
    a, b, out = (torch.randn(512, 512) for _ in range(3))
    return 2 * 512**3 / fastest(lambda: torch.mm(a, b, out=out), 400)


def operations(config: AlgorithmConfig, team: TeamSpec) -> float:
    """Return the floating-point operations of a round's matrix products, the mean of all its kinds.

    A forward pass costs m multiplications a row, m being the weights; the gradient by the weights as many again, the
    gradient through a layer its weights. Per round and agent: each critic and each member runs forward for the target
    and for its loss, backward by the weights, and for the actor's step forward and backward down to the action; the
    actor runs forward twice and backward once. MATD3's actors step with one critic, and not in every round.
    """
    h, total = config.hidden, 0.0
    twins = ALGORITHMS[config.name].critics_each
    climbed, share = (1, 1 / config.actor_delay) if config.name == "matd3" else (twins, 1.0)
    members = config.ensemble_members if config.uses_ensemble else 0
    heads = 2 if ALGORITHMS[config.name].head == "gaussian" else 1
    for kind, group in enumerate(team.groups):
        critic = critic_width(team, kind, config.joint_critics) * h + h * h + h
        out = heads * h * group.action_size
        actor = group.observation_size * h + h * h + out
        learning = (twins + members) * (2 * critic + critic + h * h + h)
        climbing = (climbed + members) * (critic + h * h + h + group.action_size * h) + 2 * actor + h * h + out
        total += group.count * (learning + actor + share * climbing)
    return 2.0 * config.batch * total


def team_of(uavs: int) -> FarmConfig:
    """Return the default farm with so many UAVs, as even as possible, communication UAVs first."""
    counts = [uavs // 3 + (uavs % 3 > kind) for kind in range(3)]
    names = ("communication_uavs", "monitoring_uavs", "collection_uavs")
    return replace(FarmConfig(), world=replace(WorldConfig(), **dict(zip(names, counts, strict=True))))


def filled_trainer(algorithm: AlgorithmConfig, farm: FarmConfig | None = None, capacity: int = 65_536) -> Trainer:
    """Return a trainer whose replay buffer is full of noise."""
    replay = ReplayConfig(capacity=capacity, warmup_steps=0)
    config = RunConfig(algorithm=algorithm, replay=replay, farm=farm or FarmConfig())
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


def measure(config: AlgorithmConfig, rounds: int, farm: FarmConfig | None = None, capacity: int = 65_536) -> Line:
    """Return one line of the result; an algorithm whose rounds differ is timed over one whole cycle of them."""
    trainer = filled_trainer(config, farm, capacity)
    burst = config.actor_delay if config.name == "matd3" else 1
    trainer.train(16 * burst + 1)
    seconds = fastest(lambda: trainer.train(burst), max(1, rounds // burst)) / burst
    speed = matrix_speed()
    return {
        "algorithm": config.name,
        "width": config.hidden,
        "batch": config.batch,
        "agents": trainer.team.agents,
        "threads": torch.get_num_threads(),
        "ms": round(1e3 * seconds, 3),
        "limit_ms": round(1e3 * operations(config, trainer.team) / speed, 3),
        "gflops": round(speed / 1e9, 1),
    }


def decisions(uavs: Sequence[int], repeats: int) -> dict[str, float]:
    """Return the microseconds of one decision of so many UAVs together."""
    found = {}
    for count in uavs:
        team = farm_team(team_of(count))
        bank = ActorBank.initial(team, AlgorithmConfig().hidden, 0)
        rows = np.random.default_rng(0).normal(size=(1, team.observation_size)).astype(np.float32)
        bank.command(rows)
        found[str(count)] = round(1e6 * fastest(lambda bank=bank, rows=rows: bank.command(rows), repeats), 1)
    return found


def growth(rounds: int) -> dict[str, list[Line]]:
    """Return lines for more agents, wider networks and larger batches, one thing at a time."""
    base = AlgorithmConfig()
    small = 8192
    return {
        "agents": [
            measure(replace(base, name=name), rounds, team_of(n), small)
            for name in ("eia-sec", "maddpg")
            for n in (6, 12, 24, 48, 96)
        ],
        "width": [
            measure(replace(base, name=name, hidden=h), rounds, None, small)
            for name in ("eia-sec", "maddpg")
            for h in (32, 64, 128, 256)
        ],
        "batch": [
            measure(replace(base, name=name, batch=b), rounds, None, small)
            for name in ("eia-sec", "maddpg")
            for b in (32, 128, 512)
        ],
    }


def table(lines: Sequence[Line]) -> str:
    """Return lines as a Markdown table."""
    names = ("algorithm", "agents", "width", "batch", "threads", "ms", "limit_ms")
    rows = [" | ".join(names), " | ".join("---" for _ in names)]
    rows += [" | ".join(str(line[name]) for name in names) for line in lines]
    return "\n".join(f"| {row} |" for row in rows) + "\n"


def keep_growth(folder: Path, rounds: int) -> None:
    """Measure the growth; write its figures, table and plot."""
    import matplotlib  # noqa: PLC0415  (loaded only where a picture is wanted)

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt  # noqa: PLC0415  (as above)

    found = growth(rounds)
    folder.mkdir(parents=True, exist_ok=True)
    origin, team = provenance("benchmarks.learner"), farm_team(RunConfig().farm).digest
    (folder / "growth.json").write_text(json.dumps({**origin, "team": team, **found}, indent=1) + "\n")
    made = f"Made by `{origin['command']}` (commit {origin['commit']})"
    head = f"{made}; the least of many rounds, one thread.\n\n"
    (folder / "growth.md").write_text(head + table([line for lines in found.values() for line in lines]))
    figure, axes = plt.subplots(1, 3, figsize=(10, 3.2), layout="constrained")
    for axis, (by, lines) in zip(axes, found.items(), strict=True):
        for colour, name in zip(("C0", "C1"), ("eia-sec", "maddpg"), strict=True):
            own = [line for line in lines if line["algorithm"] == name]
            x = [line[by] for line in own]
            axis.plot(x, [line["ms"] for line in own], "o-", color=colour, label=name)
            axis.plot(x, [line["limit_ms"] for line in own], ":", color=colour, label=f"{name}, arithmetic alone")
        axis.set(xscale="log", yscale="log", xlabel=by, xticks=x, xticklabels=x)
        axis.minorticks_off()
    axes[0].set_ylabel("ms per round of all agents")
    axes[0].legend(fontsize=7)
    figure.savefig(folder / "growth.png", dpi=140)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description="Time of one update round.")
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.add_argument("--algorithms", nargs="+", default=list(TIMED), choices=list(ALGORITHMS))
    parser.add_argument("--widths", type=int, nargs="+", default=[64, 128, 256])
    parser.add_argument("--threads", type=int, nargs="+", default=[1])
    parser.add_argument("--rounds", type=int, default=300)
    parser.add_argument("--growth", type=Path, metavar="FOLDER", help="measure growth instead and write it there")
    options = parser.parse_args()
    choose_products()
    torch.set_num_threads(options.threads[0])
    if options.growth:
        keep_growth(options.growth, options.rounds)
        return
    lines = []
    for threads in options.threads:
        torch.set_num_threads(threads)
        base = AlgorithmConfig()
        lines += [
            measure(replace(base, name=name, hidden=width), options.rounds)
            for width in options.widths
            for name in options.algorithms
        ]
    torch.set_num_threads(1)
    decide = decisions(UAVS, 2000)
    if options.json:
        sys.stdout.write(json.dumps({"rounds": lines, "decide_us": decide}) + "\n")
        return
    sys.stdout.write(table(lines) + "\n")
    sys.stdout.write("".join(f"{count:>3} UAVs decide in {us:.1f} us\n" for count, us in decide.items()))


if __name__ == "__main__":
    main()
