"""How long a flight node takes for its decisions, and how long vehicles wait for them.

Run `python -m research.benchmarks.fly --write research/results/fly.json`, then `make docs`.

For each rate `eia-sec fly` in lockstep with the policy that ships and `eia-sec simulator` with all UAVs of one farm,
two processes on one machine. The simulator makes its next step when every UAV has its decision, so it asks as fast as
the path lets it. Latencies are the node's own over its newest 1,000 set-points, round trips those of every vehicle and
step.
"""

import json
import os
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import tyro

from eia_sec.common.config import FarmConfig
from eia_sec.common.errors import EiaSecError
from eia_sec.common.farm import farm_team
from eia_sec.common.protocol import keys
from eia_sec.common.protocol.messages import MetricMessage
from eia_sec.common.transport.bus import Bus, Subscription
from eia_sec.common.transport.endpoint import Endpoint, free_endpoint
from eia_sec.deploy.exit_codes import run_command
from eia_sec.deploy.reports.provenance import provenance

RUN: Final = "fly"
LIMIT: Final = 600.0
"""Seconds after which a flight counts as failed."""
REPORT_SECONDS: Final = 30.0
"""Longest wait for the node's metrics after a flight; they come once a second."""


@dataclass(frozen=True)
class Arguments:
    """Measure a flight node's latencies."""

    rates: tuple[float, ...] = (10.0, 100.0)
    """Set-points per second and vehicle."""
    seconds: float = 30.0
    """Length of each flight: so many seconds times the rate are its steps, but fewer than an episode's."""
    farm: int = 1000
    """Seed of the farm."""
    json: bool = False
    """Print one JSON object."""
    write: Path | None = None
    """File for the same object."""


def fly(arguments: Arguments, rate: float) -> dict[str, Any]:
    """Fly once; return the metrics of both sides.

    Raises:
        EiaSecError: when either process fails, or the node reports nothing.
    """
    endpoint = free_endpoint()
    where = ("--run", RUN)
    listen = ("fly", "--policy", "trained", "--lockstep", "--rate", str(rate), "--listen", str(endpoint), *where)
    listen += ("--farm", str(arguments.farm), "--validity", str(max(0.5, 2.0 / rate)))
    node = subprocess.Popen([sys.executable, "-m", "eia_sec.deploy.cli", *listen], stdout=subprocess.DEVNULL)
    try:
        with Bus.connect(endpoint, "control", wait=60.0) as bus:
            reports = bus.subscribe(keys.METRIC.key(RUN, role="flight", name="main"), 64)
            flown = _simulate(arguments, rate, endpoint, where)
            reported = _last_report(reports)
    finally:
        node.terminate()
        try:
            node.wait(30.0)
        except subprocess.TimeoutExpired:
            node.kill()
    names = ("periods", "overruns", "decisions", "hovers", "latency")
    return {"rate": rate, "flight": flown, "node": {name: reported[name] for name in names}}


def _simulate(arguments: Arguments, rate: float, endpoint: Endpoint, where: tuple[str, ...]) -> dict[str, Any]:
    steps = ("--steps", str(max(1, min(round(arguments.seconds * rate), FarmConfig().world.steps - 1))))
    what = ("simulator", "--farm", str(arguments.farm), *steps, "--connect", str(endpoint), "--json", *where)
    done = subprocess.run(
        [sys.executable, "-m", "eia_sec.deploy.cli", *what],
        stdout=subprocess.PIPE,
        text=True,
        timeout=LIMIT,
        check=False,
    )
    if done.returncode:
        raise EiaSecError(f"the simulator ended with exit code {done.returncode}.")
    found: dict[str, Any] = json.loads(done.stdout)
    return found


def _last_report(reports: Subscription) -> dict[str, Any]:
    """Return the metrics once two reports after the flight count equally many decisions."""
    list(reports.drain())
    deadline, before = time.monotonic() + REPORT_SECONDS, -1
    while time.monotonic() < deadline:
        if (sample := reports.poll()) is not None:
            values = MetricMessage.decode(sample.payload).values
            if values["decisions"] == before:
                return values
            before = values["decisions"]
        time.sleep(0.01)
    raise EiaSecError("the flight node reported no metrics.")


def measure() -> int:
    """Measure, print and write; return 0."""
    arguments = tyro.cli(Arguments, prog="python -m research.benchmarks.fly")
    flights = [fly(arguments, rate) for rate in arguments.rates]
    vehicles, cores = farm_team(FarmConfig()).agents, os.cpu_count()
    origin = {**provenance("research.benchmarks.fly"), "farm": arguments.farm, "vehicles": vehicles, "cores": cores}
    result = {**origin, "flights": flights}
    text = json.dumps(result, indent=2) + "\n"
    if arguments.write is not None:
        arguments.write.write_text(text, encoding="utf-8")
    if arguments.json:
        sys.stdout.write(text)
        return 0
    for row in flights:
        latency, trip = row["node"]["latency"], row["flight"]["round_trip_ms"]
        sys.stdout.write(
            f"{row['rate']:g} a second: latency {latency['median']:.2f} ms (median), {latency['p99']:.1f} (99 of 100), "
            f"{latency['most']:.1f} (most); round trip {trip['median']:.1f}, {trip['p99']:.1f}, {trip['most']:.1f} ms; "
            f"{row['node']['overruns']} of {row['node']['periods'] + row['node']['overruns']} periods left out\n"
        )
    return 0


if __name__ == "__main__":
    sys.exit(run_command(measure))
