"""Real processes of a small run, for tests: started, asked, killed and always cleaned up."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from eia_sec.common.config import RunConfig
from eia_sec.common.config.files import from_toml
from eia_sec.common.config.presets import PRESETS
from eia_sec.common.history.history import Entry, read
from eia_sec.common.protocol import keys
from eia_sec.common.protocol.messages import CommandMessage, ConfigurationMessage, ReceiptMessage
from eia_sec.common.transport.bus import Bus
from eia_sec.common.transport.endpoint import Endpoint, free_endpoint

RUN = "test"
SECONDS = 90.0
PRESET = "eia-sec"
"""The preset under TINY: runs that learn from a replay buffer."""

TINY = """
episodes = 8
[farm.world]
communication_uavs = 1
monitoring_uavs = 2
collection_uavs = 2
field_x = 100.0
field_y = 100.0
sensors = 30
sensor_spacing = 5.0
plots_x = 5
plots_y = 5
steps = 40
[farm.observation]
sensors = 4
[algorithm]
hidden = 16
batch = 32
[elite]
cycle = 2
farms = 2
[replay]
capacity = 4096
warmup_steps = 64
updates_per_step = 0.5
slack_steps = 400
[rollout]
environments = 2
chunk_steps = 10
train_farms = 3
[learner]
publish_seconds = 0.05
checkpoint_seconds = 0.5
[evaluation]
farms = 2
"""


PPO = """
iteration_steps = 40
minibatch_steps = 10
epochs = 2
precision = "{precision}"
max_lag_versions = {lag}
"""
"""Options of the same run with an algorithm that learns on policy."""


CHOICES = 'farm.control]\ncommunication = "headings"\nmonitoring = "moves"\ncollection = "moves"'
"""The section of discrete actions."""


def on_policy(name: str, lag: int = 1, memory: str = "none") -> str:
    """Return TINY with an algorithm that learns on policy: `eia-ppo` imitates, the others choose discrete actions.

    With `eia-ppo` agents part after half of the run, and elites are scored by the rewards of training.
    Rows hold observations as bfloat16 numbers, or as float32 where actors have memory.
    """
    sections = {section.partition("]")[0]: section for section in TINY.split("\n[")}
    precision = "bfloat16" if memory == "none" else "float32"
    remembers = f'\nmemory = "{memory}"\nsequence_steps = 5'
    sections["algorithm"] = (
        f'algorithm]\nname = "{name}"\nhidden = 16{PPO.format(lag=lag, precision=precision).rstrip()}{remembers}'
    )
    without = {"replay"}
    if name == "eia-ppo":
        sections["algorithm"] += "\nshared_until = 0.5"
        sections["elite"] = sections["elite"].replace("farms = 2", "farms = 0")
    if name != "eia-ppo":
        without |= {"elite"}
        sections["farm.control"] = CHOICES
    return "\n[".join(section for title, section in sections.items() if title not in without)


def configured(toml: str = TINY) -> RunConfig:
    """Return what the commands make of a file with this text."""
    return from_toml(toml, PRESETS[PRESET])


def until(condition: Callable[[], Any], what: str, seconds: float = SECONDS) -> Any:
    """Return the first true value of a condition; fail the test when none comes in time."""
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline:
        if found := condition():
            return found
        time.sleep(0.02)
    raise AssertionError(f"{what} did not happen within {seconds} s")


class Processes:
    """A learner, a coordinator and workers, each an `eia-sec` command of its own."""

    def __init__(self, directory: Path, toml: str = TINY) -> None:
        self.directory = directory
        self.config = directory / "wanted.toml"
        self.config.write_text(toml, encoding="utf-8")
        self.endpoint: Endpoint = free_endpoint()
        self.running: dict[str, subprocess.Popen[bytes]] = {}
        self.prefix: tuple[str, ...] = ()
        self.module = "eia_sec.deploy.cli"

    def lengthen(self, episodes: int) -> None:
        """Let the run last long enough for what is to happen in it on a machine of any speed."""
        self.config.write_text(self.config.read_text().replace("episodes = 8\n", f"episodes = {episodes}\n"))

    @property
    def wanted(self) -> tuple[str, ...]:
        """Return a command's options for the configuration."""
        return "--preset", PRESET, "--config", str(self.config)

    def start(self, name: str, *arguments: str) -> subprocess.Popen[bytes]:
        """Start one command, its output in a log file."""
        environment = {**os.environ, "OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"}
        with (self.directory / f"{name}.log").open("ab") as log:
            process = subprocess.Popen(
                [*self.prefix, sys.executable, "-m", self.module, *arguments],
                stdout=log,
                stderr=log,
                env=environment,
            )
        self.running[name] = process
        return process

    def learner(self, *extra: str) -> subprocess.Popen[bytes]:
        """Start the learner, listening."""
        run_dir = ("--run-dir", str(self.directory / "run"))
        where = ("--run", RUN, "--listen", str(self.endpoint))
        return self.start("learner", "learner", *where, *run_dir, *self.wanted, *extra)

    def worker(self, name: str = "0", *extra: str) -> subprocess.Popen[bytes]:
        """Start a worker, its history in the run directory."""
        where = ("--run", RUN, "--connect", str(self.endpoint), "--name", name)
        history = ("--history", str(self.directory / "run" / "history" / f"rollout-{name}.jsonl"))
        return self.start(f"rollout-{name}", "rollout", *where, *history, *extra)

    def coordinator(self, name: str = "elite") -> subprocess.Popen[bytes]:
        """Start an elite coordinator."""
        return self.start(name, "elite", "--run", RUN, "--connect", str(self.endpoint))

    def records(self, kind: str) -> list[dict[str, Any]]:
        """Return the records of one kind that the learner has written."""
        path = self.directory / "run" / "metrics.jsonl"
        if not path.exists():
            return []
        lines = [line for line in path.read_text(encoding="utf-8").splitlines() if line.endswith("}")]
        return [record for record in map(json.loads, lines) if record["kind"] == kind]

    def accepted(self, worker: str) -> list[Entry]:
        """Return what the learner's history says that it has taken of a worker, the oldest first."""
        path = self.directory / "run" / "history" / "learner.jsonl"
        records = read(path)[0] if path.exists() else []
        return [
            record
            for record in records
            if isinstance(record, Entry) and record.verdict == "accepted" and record.worker == worker
        ]

    def ask_learner(self, verb: str) -> bytes | None:
        """Send the learner a command."""
        with Bus.connect(self.endpoint, "control", wait=20.0) as bus:
            return bus.ask(keys.COMMAND.key(RUN, verb=verb), CommandMessage("test").encode(), timeout=5.0)

    def drain(self) -> bool:
        """Ask the learner to drain; return whether it agreed."""
        answer = self.ask_learner("drain")
        return answer is not None and ReceiptMessage.decode(answer).done

    def configuration(self) -> ConfigurationMessage:
        """Return the learner's configuration."""
        answer = until(lambda: self.ask_learner("configuration"), "an answer of the learner")
        return ConfigurationMessage.decode(answer)

    def kill(self, name: str) -> None:
        """Kill -9 one process and wait until it is gone."""
        process = self.running.pop(name)
        process.kill()
        process.wait(10.0)

    def wait(self, name: str, seconds: float = SECONDS) -> int:
        """Return the exit code of a process that ends by itself."""
        try:
            return self.running[name].wait(seconds)
        except subprocess.TimeoutExpired:
            raise AssertionError(f"{name} did not end; its log:\n{self.log(name)}") from None

    def log(self, name: str) -> str:
        """Return what a process has written."""
        return (self.directory / f"{name}.log").read_text(encoding="utf-8", errors="replace")

    def close(self) -> None:
        """End whatever still runs."""
        for process in self.running.values():
            if process.poll() is None:
                process.send_signal(signal.SIGKILL)
        for process in self.running.values():
            process.wait(10.0)
