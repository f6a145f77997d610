"""Milliseconds of one update of all agents, beside the time that its arithmetic alone would take; and decisions.

    python -m research.benchmarks.learner [--json] [--widths 64 128 256] [--threads 1] [--updates 300] [--device cuda]
    python -m research.benchmarks.learner --growth research/results/learner [--redraw]

An update includes drawing its batch from a full replay buffer. Updates are timed in bursts of at least two, as those of
other projects are in `research.benchmarks.peers`, and an algorithm whose updates differ in whole cycles of them. The
limit divides the multiplications and additions of the matrix products of an update by the speed of a large matrix
product on as many threads, or on the same device, measured in the same run. A decision takes all UAVs of one time step
from observations to actions, on one thread of the processor. Updates on policy are those of
`research.benchmarks.on_policy`, of the preset instant on one thread: microseconds for each environment step. Every time
is the least of many.

`--growth` measures how an update grows with agents, width and batch, and writes growth.json, growth.md and growth.png;
with `--redraw` it makes the latter two anew from growth.json.
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
from matplotlib.figure import Figure  # noqa: E402  (as above)

from eia_sec.common.actors import TeamActors  # noqa: E402  (as above)
from eia_sec.common.config import (  # noqa: E402  (as above)
    EiaSecConfig,
    FarmConfig,
    LearnerConfig,
    OffPolicyConfig,
    ReplayConfig,
)
from eia_sec.common.config.algorithms import switched  # noqa: E402  (as above)
from eia_sec.common.config.files import with_values  # noqa: E402  (as above)
from eia_sec.common.config.presets import preset  # noqa: E402  (as above)
from eia_sec.common.errors import UsageError  # noqa: E402  (as above)
from eia_sec.common.farm import farm_team  # noqa: E402  (as above)
from eia_sec.common.team import TeamSpec  # noqa: E402  (as above)
from eia_sec.common.transitions import TRANSITION, Chunk, Rows  # noqa: E402  (as above)
from eia_sec.deploy.exit_codes import run_command  # noqa: E402  (as above)
from eia_sec.deploy.reports.plots import DPI, TEXT, bare  # noqa: E402  (as above)
from eia_sec.deploy.reports.provenance import provenance  # noqa: E402  (as above)
from eia_sec.learner.networks.compiled import usable_cores  # noqa: E402  (as above)
from eia_sec.learner.off_policy.inputs import critic_width  # noqa: E402  (as above)
from eia_sec.learner.off_policy.trainer import DIAGNOSTIC_PERIOD, OffPolicyTrainer  # noqa: E402  (as above)
from eia_sec.learner.registry import OFF_POLICY  # noqa: E402  (as above)
from research.benchmarks import on_policy  # noqa: E402  (as above)
from research.benchmarks.peers.clock import BURST  # noqa: E402  (as above)
from research.looks import WIDTH, algorithm_look, heading, legend_below  # noqa: E402  (as above)

ABLATION = "base"
"""EIA-SEC without its ensemble."""
TIMED = ("eia-sec", ABLATION, "maddpg", "matd3", "masac")
UAVS = (6, 12, 16, 20, 24, 96)
SEGMENT = 20
GROWTH_BY = {"agents": "agents", "width": "width of both\nhidden layers", "batch": "transitions\nin a batch"}
"""What an update's growth is measured with, one at a time, and what the picture calls it."""
GROWTH_ROWS = 8192
"""Rows of the replay buffer there: of the presets' 65,536 those of 96 agents would take 1.6 GB."""
DEVICES = {"cpu": (512, 400), "cuda": (8192, 50)}
"""For each device the rows of the square matrices whose product gives its speed, and how often they are multiplied. A
processor is fastest where they stay in its caches, an accelerator where they fill it."""
Line = dict[str, Any]


def fastest(work: Callable[[], object], repeats: int, device: str = "cpu") -> float:
    """Return the least of the seconds that `work` takes on a device, which other processes disturb least."""
    seconds = []
    finish(device)
    for _ in range(repeats):
        started = time.perf_counter()
        work()
        finish(device)
        seconds.append(time.perf_counter() - started)
    return min(seconds)


def finish(device: str) -> None:
    """Wait until a device has done all that it was given; torch returns from a CPU's work only then anyway."""
    if device == "cuda":
        torch.cuda.synchronize()


def matrix_speed(device: str = "cpu") -> float:
    """Return the floating-point operations per second of a product of two large matrices, the best of many."""
    size, repeats = DEVICES[device]
    a, b, out = (torch.randn(size, size, device=device) for _ in range(3))
    return 2 * size**3 / fastest(lambda: torch.mm(a, b, out=out), repeats, device)


def operations(config: OffPolicyConfig, team: TeamSpec) -> float:
    """Return the floating-point operations of an update's matrix products, the mean of all its kinds.

    A forward pass costs m multiplications a row, m being the weights; the gradient by the weights as many again, the
    gradient through a layer its weights. Per update and agent: each critic and each member runs forward for the target
    and for its loss, backward by the weights, and for the actor's step forward and backward down to the action; the
    actor runs forward twice and backward once. Only those critics count there that the actors maximise, and only the
    updates in which they step.
    """
    h, total, algorithm = config.hidden, 0.0, OFF_POLICY[config.name]
    twins, maximised, share = algorithm.critics_each, algorithm.objective_critics, 1 / algorithm.actor_period(config)
    members = config.ensemble_members if isinstance(config, EiaSecConfig) and config.ensemble else 0
    heads = 2 if algorithm.head == "gaussian" else 1
    for kind, group in enumerate(team.groups):
        critic = critic_width(team, kind, config.joint_critics) * h + h * h + h
        out = heads * h * group.action_size
        actor = group.observation_size * h + h * h + out
        learning = (twins + members) * (2 * critic + critic + h * h + h)
        acting = (maximised + members) * (critic + h * h + h + group.action_size * h) + 2 * actor + h * h + out
        total += group.count * (learning + actor + share * acting)
    return 2.0 * config.batch * total


def configured(name: str, base: OffPolicyConfig | None = None) -> OffPolicyConfig:
    """Return the configuration of an algorithm of TIMED with the shared values of another one."""
    if name == ABLATION:
        return replace(configured("eia-sec", base), ensemble=False)
    config = switched(base or EiaSecConfig(), name)
    assert isinstance(config, OffPolicyConfig)
    return config


def team_of(uavs: int) -> FarmConfig:
    """Return the plain farm with so many UAVs, as even as possible, communication UAVs first."""
    counts = [uavs // 3 + (uavs % 3 > kind) for kind in range(3)]
    names = ("communication_uavs", "monitoring_uavs", "collection_uavs")
    plain = preset("study").farm
    return replace(plain, world=replace(plain.world, **dict(zip(names, counts, strict=True))))


def filled_trainer(
    algorithm: OffPolicyConfig, farm: FarmConfig | None = None, capacity: int = 65_536, device: str = "cpu"
) -> OffPolicyTrainer:
    """Return a trainer on a device whose replay buffer of so many rows is full of noise."""
    replay = ReplayConfig(capacity=capacity, warmup_steps=0)
    learner = replace(LearnerConfig(), device=device)
    base = preset("study").with_algorithm(algorithm.name)
    config = replace(base, algorithm=algorithm, replay=replay, farm=farm or base.farm, learner=learner)
    team = farm_team(config.farm)
    trainer, draw = OffPolicyTrainer(config, team), np.random.default_rng(0)
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


def burst_of(config: OffPolicyConfig) -> int:
    """Return how many updates are timed together: whole cycles of an algorithm's kinds of update, at least `BURST`."""
    cycle = OFF_POLICY[config.name].actor_period(config)
    return cycle * -(-BURST // cycle)


def measure(
    config: OffPolicyConfig,
    updates: int,
    farm: FarmConfig | None = None,
    capacity: int = 65_536,
    device: str = "cpu",
) -> Line:
    """Return one line of the result; on a CPU its threads are the cores that the engine computes on."""
    trainer = filled_trainer(config, farm, capacity, device)
    burst = burst_of(config)
    # Every kind of update, with diagnostics and without, so that nothing is compiled or captured while the clock runs.
    trainer.train(DIAGNOSTIC_PERIOD * burst + 1)
    seconds = fastest(lambda: trainer.train(burst), max(1, updates // burst), device) / burst
    speed = matrix_speed(device)
    return {
        "algorithm": ABLATION if isinstance(config, EiaSecConfig) and not config.ensemble else config.name,
        "width": config.hidden,
        "batch": config.batch,
        "agents": trainer.team.agents,
        "threads": trainer.engine.cores or torch.get_num_threads(),
        "device": device,
        "burst": burst,
        "ms": round(1e3 * seconds, 3),
        "limit_ms": round(1e3 * operations(config, trainer.team) / speed, 3),
        "gflops": round(speed / 1e9, 1),
    }


def decisions(uavs: Sequence[int], repeats: int) -> dict[str, float]:
    """Return the microseconds of one decision of so many UAVs together."""
    found = {}
    for count in uavs:
        team = farm_team(team_of(count))
        actors = TeamActors.initial(team, EiaSecConfig().hidden, 0)
        rows = np.random.default_rng(0).normal(size=(1, team.observation_size)).astype(np.float32)
        actors.environment_actions(rows)
        found[str(count)] = round(
            1e6 * fastest(lambda actors=actors, rows=rows: actors.environment_actions(rows), repeats), 1
        )
    return found


def growth(updates: int, device: str) -> dict[str, list[Line]]:
    """Return lines for more agents, wider networks and larger batches, one thing at a time."""
    base = EiaSecConfig()

    def lines(variants: Sequence[OffPolicyConfig], farms: Sequence[FarmConfig | None] = (None,)) -> list[Line]:
        return [
            measure(configured(name, variant), updates, farm, GROWTH_ROWS, device)
            for name in ("eia-sec", "maddpg")
            for variant in variants
            for farm in farms
        ]

    return {
        "agents": lines([base], [team_of(uavs) for uavs in (6, 12, 24, 48, 96)]),
        "width": lines([replace(base, hidden=width) for width in (32, 64, 128, 256)]),
        "batch": lines([replace(base, batch=batch) for batch in (32, 128, 512)]),
    }


def table(lines: Sequence[Line]) -> str:
    """Return lines as a Markdown table."""
    names = ("algorithm", "agents", "width", "batch", "threads", "ms", "limit_ms")
    rows = [" | ".join(names), " | ".join("---" for _ in names)]
    rows += [" | ".join(str(line[name]) for name in names) for line in lines]
    return "\n".join(f"| {row} |" for row in rows) + "\n"


def place(line: Line) -> str:
    """Return on what a line was measured, as words."""
    cores = line["threads"]
    return f"{cores} thread{'s' * (cores > 1)}" if line.get("device", "cpu") == "cpu" else str(line["device"])


def growth_page(data: dict[str, Any]) -> str:
    """Return the growth as a Markdown page."""
    lines = [line for by in GROWTH_BY for line in data[by]]
    timed = f"the least of many bursts of {lines[0]['burst']} updates"
    return f"Made by `{data['command']}` (commit {data['commit']}); {timed}, {place(lines[0])}.\n\n{table(lines)}"


def draw_growth(data: dict[str, Any], path: Path) -> None:
    """Draw milliseconds against agents, width and batch, and save the picture."""
    figure = Figure(figsize=(WIDTH, 3.7), layout="constrained")
    panels = figure.subplots(1, len(GROWTH_BY), sharey=True)
    for axes, by in zip(panels, GROWTH_BY, strict=True):
        for name in ("eia-sec", "maddpg"):
            own, style = [line for line in data[by] if line["algorithm"] == name], algorithm_look(name)
            x = [line[by] for line in own]
            axes.plot(x, [line["ms"] for line in own], label=f"{name.upper()}, measured", markersize=5, **style)
            hollow = style | {"linestyle": ":", "markerfacecolor": "white", "markersize": 5}
            axes.plot(x, [line["limit_ms"] for line in own], label=f"{name.upper()}, arithmetic alone", **hollow)
        axes.set(xscale="log", yscale="log", xlabel=f"{GROWTH_BY[by]}, logarithmic", xticks=x, xticklabels=x)
        axes.minorticks_off()
        axes.set_title("\n".join(f"{other} {data[by][0][other]}" for other in GROWTH_BY if other != by), **TEXT)
        bare(axes)
    panels[0].yaxis.set_major_formatter("{x:g}")
    panels[0].set_ylabel("ms for an update of all agents,\nlogarithmic")
    legend_below(figure, panels, 2)
    heading(
        figure, f"An update with one thing growing: the least of many bursts, {place(data[next(iter(GROWTH_BY))][0])}."
    )
    figure.savefig(path, dpi=DPI)


def show_growth(folder: Path) -> None:
    """Write the table and the picture of growth.json.

    Raises:
        UsageError: there is none.
    """
    source = folder / "growth.json"
    if not source.is_file():
        raise UsageError(f"there is no {source}; leave --redraw out to measure.")
    data = json.loads(source.read_text(encoding="utf-8"))
    (folder / "growth.md").write_text(growth_page(data), encoding="utf-8")
    draw_growth(data, folder / "growth.png")


def take_threads(threads: int) -> None:
    """Let torch and the engine's kernels compute on so many cores.

    Raises:
        UsageError: they do not get as many.
    """
    if threads < 1:
        raise UsageError(f"--threads {threads} cannot be; it takes 1 or more.")
    torch.set_num_threads(threads)
    given = {"torch": torch.get_num_threads(), "numba, by NUMBA_NUM_THREADS,": usable_cores(threads)}
    for library, count in given.items():
        if count != threads:
            raise UsageError(f"--threads {threads} cannot be: {library} gives {count}.")


def options() -> argparse.Namespace:
    """Return the command line."""
    parser = argparse.ArgumentParser(prog="python -m research.benchmarks.learner", description="Time of one update.")
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.add_argument("--algorithms", nargs="+", default=list(TIMED), choices=list(TIMED))
    parser.add_argument("--widths", type=int, nargs="+", default=[64, 128, 256])
    parser.add_argument("--threads", type=int, nargs="+", default=[1])
    parser.add_argument("--updates", type=int, default=300)
    parser.add_argument("--repeats", type=int, default=5, help="iterations on policy")
    parser.add_argument("--device", choices=list(DEVICES), default="cpu", help="where updates are computed")
    parser.add_argument("--growth", type=Path, metavar="FOLDER", help="measure growth instead and write it there")
    parser.add_argument("--redraw", action="store_true", help="with --growth: only table and picture, from growth.json")
    return parser.parse_args()


def measure_updates(asked: argparse.Namespace) -> list[Line]:
    """Return a line for each number of threads, width and algorithm."""
    lines, base = [], EiaSecConfig()
    for threads in asked.threads:
        take_threads(threads)
        lines += [
            measure(configured(name, replace(base, hidden=width)), asked.updates, device=asked.device)
            for width in asked.widths
            for name in asked.algorithms
        ]
    return lines


def learned_on_policy(repeats: int) -> dict[str, Any]:
    """Return the microseconds of an iteration's updates for each environment step, at the preset instant's sizes.

    To be called last: it sets torch's precision of float32 products for the process.
    """
    config = preset("instant")
    found = on_policy.measure_updates(with_values(config, on_policy.ONE_CORE), repeats)
    sizes = {"algorithm": config.algorithm.name, "width": config.on_policy.hidden, "threads": torch.get_num_threads()}
    times = {"updates_us": round(found["updates"], 2), "limit_us": round(found["limit"], 2)}
    return {"preset": "instant", **sizes, **times, "gflops": round(found["gflops"], 1)}


def keep_growth(asked: argparse.Namespace) -> None:
    """Measure the growth unless only its table and picture are wanted, and write."""
    if not asked.redraw:
        take_threads(asked.threads[0])
        found = growth(asked.updates, asked.device)
        asked.growth.mkdir(parents=True, exist_ok=True)
        result = {**provenance("research.benchmarks.learner"), "team": farm_team(preset("study").farm).digest, **found}
        (asked.growth / "growth.json").write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    show_growth(asked.growth)


def main() -> int:
    """Measure and print; return 0.

    Raises:
        UsageError: the device or the threads cannot be had.
    """
    asked = options()
    if asked.redraw and not asked.growth:
        raise UsageError("--redraw takes the folder from --growth.")
    if asked.device == "cuda" and not torch.cuda.is_available():
        raise UsageError("--device cuda needs a CUDA device, and torch finds none.")
    for threads in asked.threads:  # whatever cannot be had is reported before hours of measuring
        take_threads(threads)
    if asked.growth:
        keep_growth(asked)
        return 0
    lines = measure_updates(asked)
    torch.set_num_threads(1)
    decide = decisions(UAVS, 2000)
    iteration = learned_on_policy(asked.repeats)
    if asked.json:
        sys.stdout.write(json.dumps({"updates": lines, "decide_us": decide, "on_policy": iteration}) + "\n")
        return 0
    sys.stdout.write(table(lines) + "\n")
    sys.stdout.write(
        "on policy: {updates_us} us for each environment step, limit {limit_us} us\n\n".format(**iteration)
    )
    sys.stdout.write("".join(f"{count:>3} UAVs decide in {us:.1f} us\n" for count, us in decide.items()))
    return 0


if __name__ == "__main__":
    sys.exit(run_command(main))
