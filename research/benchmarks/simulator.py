"""The simulator's speed: steps per second and core, a single environment, threads, conditions, growth, and stages.

    python -m research.benchmarks.simulator [--json] [--quick] [--write research/results/simulator]

Actions are random and drawn beforehand; whole episodes are flown, and what their restarts cost is counted. Rates are
by the process's own processor time. Wall time stands beside it, and that of the fastest tenth of the calls, which comes
nearest to an idle machine where other programs share the processor's caches. `--write` also draws the growth.
"""

import hashlib
import json
import os
import platform
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Final

import numba
import numpy as np
import tyro

from eia_sec.common.config import FarmConfig, WorldConfig
from eia_sec.common.config.presets import preset
from eia_sec.rollout.sim.batch import FarmBatch
from eia_sec.rollout.sim.layout import make_layout
from eia_sec.rollout.sim.reference.farm import ReferenceFarm
from research.benchmarks.simulator_page import show, table, write
from research.benchmarks.stages import stage_shares

FARM = preset("study").farm
FIELD = preset("field").farm
ENDLESS: Final = 1e6
"""Capacity of batteries, J, that nobody empties: with random actions, UAVs would be gone for most of an episode."""
FARMS = 20
TABLE = 64
"""Rows of random actions that are flown again and again."""
HEADLINE = 32
COMPILE = """
import time
began = time.perf_counter()
from eia_sec.common.config.presets import preset
from eia_sec.rollout.sim.batch import FarmBatch
batch = FarmBatch(preset("study").farm, 1)
batch.reset(0, 0, 0)
print(time.perf_counter() - began)
"""


@dataclass(frozen=True)
class Options:
    """What to measure."""

    json: bool = False
    """Print JSON."""
    write: Path | None = None
    """Folder for simulator.json, README.md and growth.png."""
    redraw: bool = False
    """With --write: only page and picture, from simulator.json."""
    batches: tuple[int, ...] = (1, 8, 32, 128, 512)
    """Batch sizes."""
    repeats: int = 3
    """How often each measurement is made; the fastest counts."""
    quick: bool = False
    """Leave out conditions, growth, stages and compilation."""


@dataclass(frozen=True)
class Speed:
    """One measurement, microseconds per environment step."""

    cpu_us: float
    """Processor time, restarts included."""
    wall_us: float
    """Wall time, restarts included."""
    fastest_tenth_us: float = np.inf
    """Wall time of the fastest tenth of the calls, without restarts."""


def flights(config: FarmConfig, environments: int, threads: int, steps: int) -> Iterator[tuple[FarmBatch, float]]:
    """Step a batch, restart what has ended, and yield it after each step, and how many seconds the step took."""
    batch = FarmBatch(config, environments, threads)
    shape = (TABLE, environments, batch.team.environment_action_size)
    actions = np.random.default_rng(0).uniform(-1.0, 1.0, shape).astype(np.float32)
    episode = 0
    for step in range(steps):
        if step % config.world.steps == 0:
            episode += 1
            for index in range(environments):
                batch.reset(index, index % FARMS, episode)
        began = time.perf_counter()
        batch.step(actions[step % TABLE])
        yield batch, time.perf_counter() - began


def measure(config: FarmConfig, environments: int, threads: int, repeats: int, least: int = 12_000) -> Speed:
    """Return the fastest of several flights of whole episodes, each of at least so many environment steps."""
    length = config.world.steps
    steps = length * max(1, -(-least // (environments * length)))
    best = Speed(np.inf, np.inf)
    for index in range(environments):
        make_layout(config, index % FARMS)
    for _ in range(repeats):
        cpu, wall = time.process_time(), time.perf_counter()
        calls = [seconds for _, seconds in flights(config, environments, threads, steps)]
        scale = 1e6 / (steps * environments)
        speed = Speed(
            (time.process_time() - cpu) * scale,
            (time.perf_counter() - wall) * scale,
            float(np.quantile(calls, 0.1)) * 1e6 / environments,
        )
        best = min(best, speed, key=lambda s: s.cpu_us if threads == 1 else s.wall_us)
    return best


def single_step(repeats: int) -> float:
    """Return the median microseconds of one call of `step` on one environment, without restarts."""
    batch = FarmBatch(FARM, 1)
    actions = (
        np.random.default_rng(0).uniform(-1.0, 1.0, (TABLE, 1, batch.team.environment_action_size)).astype(np.float32)
    )
    medians = []
    for episode in range(4 * repeats):
        batch.reset(0, episode % FARMS, episode)
        spent = []
        for step in range(FARM.world.steps):
            began = time.perf_counter_ns()
            batch.step(actions[step % TABLE])
            spent.append(time.perf_counter_ns() - began)
        medians.append(float(np.median(spent)) / 1e3)
    return min(medians)


def reference_speed(repeats: int, steps: int = 60) -> Speed:
    """Return the speed of the NumPy reference over the first steps of an episode."""
    actions = np.random.default_rng(0).uniform(-1.0, 1.0, (steps, 2 * FARM.world.uavs)).astype(np.float32)
    best = Speed(np.inf, np.inf)
    for _ in range(repeats):
        farm = ReferenceFarm(FARM, make_layout(FARM, 0), 0)
        cpu, wall = time.process_time(), time.perf_counter()
        for action in actions:
            farm.step(action)
        speed = Speed((time.process_time() - cpu) * 1e6 / steps, (time.perf_counter() - wall) * 1e6 / steps)
        best = min(best, speed, key=lambda s: s.cpu_us)
    return best


def digest(threads: int, environments: int = 16, steps: int = 100) -> str:
    """Return the SHA-256 of everything that a short flight shows."""
    seen = hashlib.sha256()
    for batch, _ in flights(FARM, environments, threads, steps):
        for array in (batch.observation, batch.reward, batch.aoi, batch.vdf, batch.position, batch.assignment):
            seen.update(array.tobytes())
    return seen.hexdigest()


def fleets() -> dict[int, FarmConfig]:
    """Return farms by their number of UAVs."""
    return {3 * k: replace(FARM, world=WorldConfig(k, k, k)) for k in (2, 4, 8, 16, 32, 64)}


def sensor_fields(denser: bool) -> dict[int, FarmConfig]:
    """Return farms by their number of sensors: on the same field, or on a field that grows with them."""
    farms = {}
    for count in (100, 400, 1000, 2500, 5000, 10_000):
        side = 400.0 if denser else 400.0 * (count / 400.0) ** 0.5
        spacing = 1.0 if denser else 10.0
        farms[count] = replace(
            FARM, world=WorldConfig(sensors=count, sensor_spacing=spacing, field_x=side, field_y=side)
        )
    return farms


def plot_grids() -> dict[int, FarmConfig]:
    """Return farms by their number of plots."""
    return {k * k: replace(FARM, world=WorldConfig(plots_x=k, plots_y=k)) for k in (10, 20, 40, 80)}


def switched() -> dict[str, FarmConfig]:
    """Return farms by what is switched on: nothing, a condition of the preset `field`, or all of them.

    UAVs observe what the preset's observe of it. Autopilots that fly to stations are left out: the simulator has none.
    """
    battery = replace(FIELD.battery, capacity=ENDLESS, failsafe=0.0)
    seen = FIELD.observation
    conditions: dict[str, tuple[dict[str, Any], dict[str, bool]]] = {
        "links": ({"relay": FIELD.relay, "reward": FIELD.reward}, {"link": seen.link}),
        "failures": ({"failures": FIELD.failures}, {}),
        "stress": ({"stress": FIELD.stress}, {"stress": seen.stress}),
        "batteries": ({"battery": battery}, {"charge": seen.charge}),
        "wind": ({"wind": FIELD.wind}, {"wind": seen.wind}),
        "zones": ({"zones": FIELD.zones}, {"zones": seen.zones}),
    }
    farms, together, views = {"none": FARM}, FARM, FARM.observation
    for name, (parts, added) in conditions.items():
        farms[name] = replace(FARM, **parts, observation=replace(FARM.observation, **added))
        views = replace(views, **added)
        together = replace(together, **parts, observation=views)
    return {**farms, "all": together}


def growth(farms: dict[int, FarmConfig], repeats: int) -> list[dict[str, float]]:
    """Return the cost of a step of each farm, in a batch of eight."""
    return [
        {"value": value, "us_per_step": round(measure(farm, 8, 1, repeats, 4000).cpu_us, 3)}
        for value, farm in farms.items()
    ]


def processor() -> str:
    """Return the processor's name."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor()
    return next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), "unknown")


def compile_seconds() -> dict[str, float]:
    """Return the seconds until a first farm is reset in a fresh process, with and without machine code on disk."""
    seconds = {}
    with tempfile.TemporaryDirectory() as folder:
        environment = {**os.environ, "NUMBA_CACHE_DIR": folder}
        for name in ("first", "cached"):
            result = subprocess.run(
                [sys.executable, "-c", COMPILE], env=environment, capture_output=True, text=True, check=True
            )
            seconds[name] = round(float(result.stdout), 2)
    return seconds


def results(options: Options) -> dict[str, Any]:
    """Measure everything."""
    repeats = options.repeats
    batches = {size: measure(FARM, size, 1, repeats) for size in sorted({*options.batches, HEADLINE})}
    fastest = min(speed.cpu_us for speed in batches.values())
    reference = reference_speed(repeats)
    threads = {count: measure(FARM, 64, count, repeats) for count in (1, 2)}
    found: dict[str, Any] = {
        "machine": {
            "processor": processor(),
            "cores": len(os.sched_getaffinity(0)),
            "python": platform.python_version(),
            "numba": numba.__version__,
        },
        "farm": {"uavs": FARM.world.uavs, "sensors": FARM.world.sensors, "plots": FARM.world.plots_x**2},
        "env_steps_per_second_per_core": round(1e6 / batches[HEADLINE].cpu_us),
        "by_batch": {
            str(size): {**asdict(speed), "env_steps_per_second_per_core": round(1e6 / speed.cpu_us)}
            for size, speed in batches.items()
        },
        "single_step_us": round(single_step(repeats), 2),
        "reference_steps_per_second": round(1e6 / reference.cpu_us, 1),
        "reference_ratio": round(reference.cpu_us / fastest, 1),
        "threads": {
            "environments": 64,
            "wall_us": {str(count): round(speed.wall_us, 3) for count, speed in threads.items()},
            "same_results": digest(1) == digest(2),
        },
    }
    if not options.quick:
        farms = switched()
        # All farms in turn, so that what else the machine does slows all of them.
        passes = [{name: measure(farm, HEADLINE, 1, 1).cpu_us for name, farm in farms.items()} for _ in range(repeats)]
        costs = {name: min(each[name] for each in passes) for name in farms}
        found["switches"] = {
            "environments": HEADLINE,
            "us_per_step": {name: round(us, 3) for name, us in costs.items()},
        }
        found["scaling"] = {
            "uavs": growth(fleets(), repeats),
            "sensors": growth(sensor_fields(denser=True), repeats),
            "sensors_on_a_growing_field": growth(sensor_fields(denser=False), repeats),
            "plots": growth(plot_grids(), repeats),
        }
        whole = batches[HEADLINE].cpu_us
        found["parts_us"] = {name: round(share * whole, 3) for name, share in stage_shares(FARM, HEADLINE).items()}
        found["compile_seconds"] = compile_seconds()
    return found


def main() -> None:
    """Measure and print."""
    options = tyro.cli(Options, prog="python -m research.benchmarks.simulator", description=__doc__)
    if options.redraw:
        if options.write is None:
            sys.exit("--redraw takes the folder from --write.")
        show(json.loads((options.write / "simulator.json").read_text()), options.write)
        return
    found = results(options)
    sys.stdout.write(json.dumps(found, indent=2) + "\n" if options.json else table(found))
    if options.write:
        write(found, options.write)


if __name__ == "__main__":
    main()
