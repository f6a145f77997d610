"""A second worker joins a run by hand, and is killed: what it adds, and what is lost with it.

    python -m experiments.second_worker

The learner takes in and stores, but does not train (`replay.updates_per_step = 0`), so that the workers are what is
measured. Written to docs/results/second_worker.json.
"""

import json
import os
import signal
import sys
import tempfile
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import tyro

from common import keys
from common.bus import Bus
from common.config.files import to_toml
from common.config.presets import PRESETS
from common.endpoint import Endpoint, free_endpoint
from common.messages import CommandMessage
from deploy.fleet import Fleet
from deploy.provenance import provenance
from deploy.supervisor import Supervisor

RUN = "second-worker"


@dataclass(frozen=True)
class Arguments:
    """Measure what a second worker adds."""

    seconds: float = 20.0
    """Length of each measurement, s."""
    settle: float = 15.0
    """Time that a worker has to come up, s."""
    output: Path = Path("docs/results/second_worker.json")
    """The result."""


def rate(fleet: Fleet, seconds: float) -> float:
    """Return the environment steps per second that the learner takes in over some seconds."""
    points = []
    for pause in (0.0, seconds):
        time.sleep(pause)
        fleet.update()
        values = fleet.learner_values()
        points.append((float(values["elapsed"]), int(values["environment_steps"])))
    (start, before), (end, after) = points
    return (after - before) / (end - start)


def measure(arguments: Arguments, supervisor: Supervisor, endpoint: Endpoint) -> dict[str, Any]:
    """Return rates with one worker, with two, and after the second was killed, and the ledger at the end."""
    worker = ["rollout", "--run", RUN, "--connect", str(endpoint), "--name"]
    with Bus.connect(endpoint, "control", wait=60.0) as bus:
        fleet = Fleet(bus, RUN)
        supervisor.start("rollout-0", [*worker, "0"])
        time.sleep(arguments.settle)
        one = rate(fleet, arguments.seconds)
        second = supervisor.start("rollout-1", [*worker, "1"])
        time.sleep(arguments.settle)
        two = rate(fleet, arguments.seconds)
        assert second.process is not None
        os.kill(second.process.pid, signal.SIGKILL)
        time.sleep(5.0)
        after = rate(fleet, arguments.seconds)
        bus.ask(keys.COMMAND.key(RUN, verb="drain"), CommandMessage(RUN).encode(), timeout=5.0)
        time.sleep(2.0)
        fleet.update()
        ledger = fleet.learner_values()["ledger"]
    steps = {"one_worker": one, "two_workers": two, "after_kill": after}
    return {"environment_steps_per_second": steps, "gain": two / one, "ledger": ledger}


def main() -> None:
    """Measure and write the result."""
    arguments = tyro.cli(Arguments, prog="python -m experiments.second_worker")
    base = PRESETS["default"]
    config = replace(base, episodes=10_000_000, replay=replace(base.replay, updates_per_step=0.0, warmup_steps=0))
    endpoint = free_endpoint()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "config.toml"
        path.write_text(to_toml(config), encoding="utf-8")
        supervisor = Supervisor(Path(folder) / "logs")
        try:
            supervisor.start("learner", ["learner", "--run", RUN, "--listen", str(endpoint), "--config", str(path)])
            result = measure(arguments, supervisor, endpoint)
        finally:
            supervisor.stop()
    text = json.dumps({**provenance("experiments.second_worker"), **result}, indent=1)
    arguments.output.parent.mkdir(parents=True, exist_ok=True)
    arguments.output.write_text(text + "\n", encoding="utf-8")
    sys.stdout.write(text + "\n")


if __name__ == "__main__":
    main()
