"""What it costs to step an environment over Zenoh instead of in the worker's process.

Run `python -m research.benchmarks.served research/results/served.json`; it takes a minute.

A listener stands between worker and environment, in a process of its own, as a learner does. The environment has two
agents (`research.benchmarks.served_line`), with pauses or without. The best of several short stretches counts, so that
other work on the machine matters little; the ways take turns.
"""

import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Final

import numpy as np

from eia_sec.common.config import EnvConfig
from eia_sec.common.errors import EnvironmentOutageError
from eia_sec.common.transport.bus import Bus
from eia_sec.common.transport.endpoint import free_endpoint
from eia_sec.deploy.reports.provenance import provenance
from eia_sec.rollout.envs.base import Reach
from eia_sec.rollout.envs.pettingzoo_batch import PettingZooBatch
from eia_sec.rollout.remote.served import ServedEnvironments

LINE: Final = "research.benchmarks.served_line"
SECONDS: Final = 1.0
"""Length of a stretch."""
STRETCHES: Final = 6
PERIOD: Final = 0.02
"""Time that a slow step takes, s."""
COPIES: Final = 16


def main(arguments: list[str]) -> None:
    """Measure, and write the result to the file given, or to standard output."""
    ways = {
        "here": lambda: _here(0.0),
        "served": lambda: _served_rate(1, 0.0),
        "here_slow": lambda: _here(PERIOD),
        "served_slow": lambda: _served_rate(1, PERIOD),
        "served_copies": lambda: _served_rate(COPIES, 0.0),
    }
    found: dict[str, list[float]] = {name: [] for name in ways}
    for _ in range(STRETCHES):
        for name, measure in ways.items():
            found[name].append(round(measure(), 1))
    result = {
        **provenance("research.benchmarks.served"),
        "cores": os.cpu_count(),
        "load": round(os.getloadavg()[0], 1),
        "seconds": SECONDS,
        "period": PERIOD,
        "copies": COPIES,
        "steps_per_second": found,
    }
    text = json.dumps(result, indent=2) + "\n"
    if arguments:
        Path(arguments[0]).write_text(text, encoding="utf-8")
    else:
        sys.stdout.write(text)


def _served_rate(copies: int, pause: float) -> float:
    """Return the environment steps a second of so many copies over Zenoh."""
    endpoint = free_endpoint()
    with (
        _running("-c", _LISTENER, str(endpoint)),
        _running("-m", LINE, str(endpoint), str(copies), str(pause)),
        Bus.connect(endpoint, "control", wait=20.0) as bus,
        closing(_served(bus, copies)) as environments,
    ):
        return _stepped(environments)


def _here(pause: float) -> float:
    """Return the environment steps a second of one environment in this process."""
    with closing(
        PettingZooBatch(EnvConfig(f"{LINE}:Line", json.dumps({"pause": pause})), 1, boxes=False)
    ) as environments:
        return _stepped(environments)


def _stepped(environments: PettingZooBatch) -> float:
    count = len(environments.time)
    action = np.ones((count, environments.team.action_size), np.float32)
    for index in range(count):
        environments.reset(index, 0, index)
    steps, began = 0, time.perf_counter()
    while (now := time.perf_counter()) - began < SECONDS:
        environments.step(action)
        steps += count
        for index in np.flatnonzero(environments.ended).tolist():
            environments.reset(index, 0, steps + index)
    return steps / (now - began)


def _served(bus: Bus, copies: int) -> PettingZooBatch:
    deadline = time.monotonic() + 20.0
    while True:
        make = ServedEnvironments(Reach(bus, "benchmark"), "line").make
        try:
            return PettingZooBatch(EnvConfig("zenoh:line"), copies, boxes=False, make=make)
        except EnvironmentOutageError:
            if time.monotonic() > deadline:
                raise
            time.sleep(0.1)


_LISTENER: Final = """
import sys, time
from eia_sec.common.transport.bus import Bus
from eia_sec.common.transport.endpoint import Endpoint
with Bus.listen(Endpoint.parse(sys.argv[1]), "control"):
    time.sleep(600.0)
"""


@contextmanager
def _running(*words: str) -> Iterator[None]:
    process = subprocess.Popen([sys.executable, *words], stderr=subprocess.DEVNULL)
    try:
        yield
    finally:
        process.kill()
        process.wait()


if __name__ == "__main__":
    main(sys.argv[1:])
