"""The preset instant on this machine's cores: environment steps that the learner learns from, by number of workers."""

import os
import tempfile
import time
from pathlib import Path
from typing import Any, Final

from eia_sec.common.config import RunConfig
from eia_sec.common.errors import EiaSecError
from eia_sec.common.protocol import keys
from eia_sec.common.transport.bus import Bus
from research.benchmarks.distribution.processes import JOIN_SECONDS, RUN, Processes
from research.benchmarks.distribution.records import Record, Tail, between
from research.benchmarks.distribution.training import WorkerTimes

SETTLE_SECONDS: Final = 10.0
"""Time for which a run trains before it is measured, by default."""
REPORT_SECONDS: Final = 1.5
"""Longest time between two of the learner's reports, with a margin."""


def learn(
    workers: int, seconds: float, config: RunConfig | None = None, settle: float = SETTLE_SECONDS
) -> dict[str, Any]:
    """Train with so many workers for a while; return rates and where the time went.

    Args:
        workers: number of workers.
        seconds: measuring time.
        config: the run; the preset instant.
        settle: seconds for which it trains before it is measured.

    Raises:
        EiaSecError: when a process ends, nothing is accepted in time, or steps are unexplained.
    """
    records: list[Record] = []
    with tempfile.TemporaryDirectory() as folder:
        load = os.getloadavg()[0]
        with Processes(config or RunConfig(), workers, Path(folder), routed=False) as processes:
            tail, reports = Tail(processes.metrics), WorkerTimes()
            deadline, begin = time.monotonic() + JOIN_SECONDS, 0.0
            with Bus.connect(processes.endpoint, "control", wait=JOIN_SECONDS) as bus:
                metrics = bus.subscribe(keys.METRIC.pattern(RUN, role="rollout"), 4096)
                while not begin or records[-1]["time"] < begin + seconds + REPORT_SECONDS:
                    processes.check()
                    reports.read(metrics)
                    records += tail.new()
                    if not begin and any(record.get("environment_steps", 0) for record in records):
                        begin = records[-1]["time"] + settle
                        deadline = time.monotonic() + 10.0 * seconds + JOIN_SECONDS
                    if time.monotonic() > deadline:
                        raise EiaSecError("the learner reported nothing in time.")
                    time.sleep(0.1)
                processes.drain(bus)
                records += tail.new()
    first, last = between(records, begin, begin + seconds + REPORT_SECONDS)
    return {"workers": workers, "load": load, **rates(first, last), "workers_waiting": round(reports.waiting(), 4)}


def rates(first: Record, last: Record) -> dict[str, Any]:
    """Return what happened between two of the learner's reports."""
    if last["ledger"]["unexplained"]:
        raise EiaSecError(f"{last['ledger']['unexplained']} environment steps are unexplained.")
    seconds = last["time"] - first["time"]
    steps, updates = (last[name] - first[name] for name in ("environment_steps", "updates"))
    rejected = last["ledger"]["rejected"] - first["ledger"]["rejected"]
    training = last["waits"]["training"] - first["waits"]["training"]
    return {
        "seconds": round(seconds, 2),
        "environment_steps": steps,
        "steps_per_second": round(steps / seconds, 1),
        "updates_per_second": round(updates / seconds, 2),
        "update_ms": round(1e3 * training / max(1, updates), 2),
        "learner_updating": round(training / seconds, 4),
        "rejected_share": round(rejected / max(1, steps + rejected), 4),
    }
