"""What the scripts of all peers share: how time is taken and how results are handed over. Standard library only."""

import argparse
import json
import statistics
import sys
import time
from collections.abc import Callable, Sequence
from importlib.metadata import version
from itertools import pairwise
from typing import Any

BLOCKS = 8
"""Parts that a simulator's measuring time is cut into; the fastest is least disturbed by other processes."""
BURST = 2
"""Updates timed together; `research.benchmarks.learner` takes as many of ours, or a whole longer cycle."""


def step_rate(step: Callable[[], None], seconds: float) -> float:
    """Return how often a second `step` can be called: the fastest of `BLOCKS` equal parts of the measuring time.

    Args:
        step: one call of the environment; called a few times before the clock starts.
        seconds: measuring time, s.
    """
    for _ in range(3):
        step()
    started = time.perf_counter()
    step()
    once = time.perf_counter() - started
    calls = max(1, int(seconds / BLOCKS / max(once, 1e-7)))
    best = float("inf")
    for _ in range(BLOCKS):
        started = time.perf_counter()
        for _ in range(calls):
            step()
        best = min(best, time.perf_counter() - started)
    return calls / best


def update_times(update: Callable[[], None], updates: int) -> tuple[float, float]:
    """Return the least and the median milliseconds of one update, timed in bursts of `BURST`.

    Args:
        update: one update, replay sampling included; called ten times before the clock starts.
        updates: how many to time.
    """
    for _ in range(10):
        update()
    bursts = []
    for _ in range(max(1, updates // BURST)):
        started = time.perf_counter()
        for _ in range(BURST):
            update()
        bursts.append(1e3 * (time.perf_counter() - started) / BURST)
    return min(bursts), statistics.median(bursts)


def bursts_of(moments: Sequence[float]) -> list[float]:
    """Return the milliseconds of one update in each whole burst between moments, s, at which updates ended."""
    ends = moments[::BURST]
    return [1e3 * (after - before) / BURST for before, after in pairwise(ends)]


def simulator_options(software: str) -> argparse.ArgumentParser:
    """Return the command line that all scripts of simulators understand."""
    parser = argparse.ArgumentParser(description=f"Environment steps per second of {software}.")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--seconds", type=float, default=4.0, help="measuring time of each case")
    parser.add_argument("--batches", type=int, nargs="+", default=[1, 32, 1024])
    parser.add_argument("--agents", type=int, default=12)
    return parser


def learner_options(software: str) -> argparse.ArgumentParser:
    """Return the command line that all scripts of learners understand."""
    parser = argparse.ArgumentParser(description=f"Milliseconds of an update of {software}.")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--updates", type=int, default=100)
    parser.add_argument("--widths", type=int, nargs="+", default=[64, 128, 256])
    parser.add_argument("--batch", type=int, default=128)
    parser.add_argument("--capacity", type=int, default=65_536)
    parser.add_argument("--groups", nargs="+", required=True, metavar="NAME:COUNT:OBSERVATION:ACTION")
    return parser


def parse_groups(texts: Sequence[str]) -> list[tuple[str, int, int, int]]:
    """Return name, agents, observation size and action size of each group."""
    parts = [text.split(":") for text in texts]
    return [(name, int(count), int(observation), int(action)) for name, count, observation, action in parts]


def hand_over(lines: list[dict[str, Any]], *packages: str) -> None:
    """Print the lines and the versions of the packages as one line of JSON, the last that the driver reads."""
    versions = {name: version(name) for name in packages}
    sys.stdout.write("\n" + json.dumps({"lines": lines, "versions": versions}) + "\n")
    sys.stdout.flush()
