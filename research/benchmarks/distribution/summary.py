"""Medians over the seeds, and speed-ups beside one worker."""

from statistics import median
from typing import Any, Final

Line = dict[str, Any]
SHARED: Final = (
    "steps_per_second",
    "environment_steps",
    "seconds_from_launch",
    "learner_updating",
    "workers_waiting",
    "rejected_share",
    "update_ms",
)
"""Numbers of a run that are given as medians."""


def summary(runs: list[Line]) -> list[Line]:
    """Return one line for each number of workers.

    A run that did not reach the reward counts with the time that it had, so that its time is a lower bound. `speedup`
    and `efficiency` are of times to the reward, `steps_speedup` of environment steps a second; None without runs of one
    worker, or where some run reached nothing.
    """
    lines = []
    for workers in sorted({run["workers"] for run in runs}):
        own = [run for run in runs if run["workers"] == workers]
        seconds = [run["seconds"] for run in own]
        line: Line = {"workers": workers, "seeds": len(own), "reached": sum(run["reached"] for run in own)}
        line |= {"seconds": median(seconds), "least": min(seconds), "most": max(seconds)}
        lines.append(line | {name: median(run[name] for run in own) for name in SHARED})
    alone = next((line for line in lines if line["workers"] == 1), None)
    for line in lines:
        whole = alone is not None and all(one["reached"] == one["seeds"] for one in (alone, line))
        line["speedup"] = alone["seconds"] / line["seconds"] if alone is not None and whole else None
        line["efficiency"] = line["speedup"] / line["workers"] if whole else None
        line["steps_speedup"] = line["steps_per_second"] / alone["steps_per_second"] if alone is not None else None
    return lines
