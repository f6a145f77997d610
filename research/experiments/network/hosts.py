"""Many hosts, as network namespaces with mutual TLS and a slow relay between them: one joins, one is cut off.

    python -m research.experiments.network.hosts                # needs root and iproute2; several minutes

Router, learner, coordinator and two workers on a host each, all of it started by `eia-sec up` from one fleet file. A
sixth host joins, another is cut off and comes back. Written to research/results/hosts/results.json.
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import tyro

from eia_sec.deploy.hosts.fleet_file import read
from eia_sec.deploy.monitor.audit import audit
from eia_sec.deploy.reports.provenance import provenance
from research.experiments.network.namespaces import PORT, RELAY, Laboratory, laboratory

WORKER: Final = "workers = 1\n"
HOSTS: Final = {"router": "", "learner": "", "coordinator": "", "first": WORKER, "second": WORKER, "late": WORKER}
"""The hosts' names, one for each namespace, and what each one's table holds."""
CUT: Final = list(HOSTS).index("first")
START_SECONDS: Final = 300.0

HEAD: Final = """run = "hosts"
[training]
preset = "{preset}"
config = "wanted.toml"
[network]
endpoint = "tls/{relay}:{port}"
keys = "keys"
[router]
host = "router"
[learner]
host = "learner"
{tables}"""
APART: Final = """[coordinator]
host = "coordinator"
"""


@dataclass(frozen=True)
class Arguments:
    """Train on hosts that are network namespaces."""

    preset: str = "quick"
    """Preset."""
    set: str = "episodes = 300"
    """TOML text with values that replace the preset's."""
    delay: float = 0.02
    """Delay between a host and the router, each way, s."""
    cut: float = 20.0
    """Seconds for which a host is cut off; a lease ends after four."""
    farms: str = "1000:1020"
    """Farms of the evaluation."""
    output: Path = Path("research/results/hosts/results.json")
    """The result."""


class Hosts:
    """The fleet of a laboratory.

    Args:
        lab: the namespaces.
        preset: the preset to train.
        toml: values that replace the preset's.
        hosts: the hosts' names, in the order of the namespaces, and what their tables hold.
        tables: further tables of the fleet file, and before them what the learner's holds.
    """

    def __init__(
        self, lab: Laboratory, preset: str, toml: str, hosts: Mapping[str, str] = HOSTS, tables: str = APART
    ) -> None:
        self.lab, self.hosts = lab, hosts
        self.file = lab.folder / "fleet.toml"
        (lab.folder / "wanted.toml").write_text(toml, encoding="utf-8")
        self.head = HEAD.format(preset=preset, relay=RELAY, port=PORT, tables=tables)
        # Names are issued ahead: the router reads its list of members only when it starts.
        self.describe(list(hosts))
        self.eia_sec("fleet", "keys", str(self.file))
        self.describe([name for name in hosts if name != "late"])

    def describe(self, hosts: Sequence[str]) -> None:
        """Write the fleet file with these hosts."""
        command = f"env PYTHONPATH={os.environ.get('PYTHONPATH', '')} {sys.executable} -m eia_sec.deploy.cli"
        text = self.head
        for name in hosts:
            host = self.lab.names[self.place(name)]
            text += f'[hosts.{name}]\nhost = "{host}"\nfolder = "run"\ncommand = "{command}"\n{self.hosts[name]}'
        self.file.write_text(text, encoding="utf-8")

    def place(self, host: str) -> int:
        """Return the number of a host's namespace."""
        return list(self.hosts).index(host)

    def eia_sec(self, *words: str) -> str:
        """Run a command that has to succeed; return what it printed."""
        command = [sys.executable, "-m", "eia_sec.deploy.cli", *words]
        done = subprocess.run(command, capture_output=True, text=True, env=self.lab.environment(), check=False)
        if done.returncode:
            raise RuntimeError(f"{' '.join(words)}: {done.stdout}{done.stderr}{self.last_lines()}")
        return done.stdout

    def last_lines(self) -> str:
        """Return the ends of all logs."""
        paths = sorted(self.lab.folder.glob("home/*/run/logs/*.log"))
        return "".join(f"\n== {path.name}\n{path.read_text(errors='replace')[-400:]}" for path in paths)

    def taken(self, worker: str = "") -> int:
        """Return how many lines of accepted chunks (of one worker) the learner's history has."""
        path = self.lab.home(self.place("learner")) / "run" / "run" / "history" / "learner.jsonl"
        return path.read_text(encoding="utf-8").count(f'["accepted","{worker}') if path.exists() else 0

    def until(self, condition: Callable[[], Any], what: str, seconds: float = START_SECONDS) -> float:
        """Wait for something; return the seconds that it took."""
        started = time.monotonic()
        while not condition():
            if time.monotonic() - started > seconds:
                raise RuntimeError(f"{what} did not come within {seconds} s{self.last_lines()}")
            time.sleep(0.05)
        return time.monotonic() - started

    def state(self, process: str) -> str:
        """Return the state of a process as `eia-sec status` shows it."""
        return str(self.processes().get(process, {}).get("state", "down"))

    def processes(self) -> dict[str, dict[str, Any]]:
        """Return what `eia-sec status` knows of each process that a host has."""
        command = [sys.executable, "-m", "eia_sec.deploy.cli", "status", str(self.file), "--json"]
        done = subprocess.run(command, capture_output=True, text=True, env=self.lab.environment(), check=False)
        hosts = json.loads(done.stdout)["hosts"].values()
        return {name: dict(state) for host in hosts for name, state in host["processes"].items()}


def happen(fleet: Hosts, cut: float) -> dict[str, Any]:
    """Start five hosts, let a sixth join, cut one off for some seconds; return how long everything took."""
    started = time.monotonic()
    fleet.eia_sec("up", str(fleet.file))
    up = time.monotonic() - started
    fleet.until(fleet.taken, "the first chunk")
    first = time.monotonic() - started
    fleet.until(lambda: fleet.taken("first-0"), "a chunk of the host that is cut off later")
    fleet.describe(list(fleet.hosts))
    started = time.monotonic()
    fleet.eia_sec("up", str(fleet.file))
    fleet.until(lambda: fleet.taken("late-0"), "a chunk of the sixth host")
    joined = time.monotonic() - started
    fleet.lab.cut(CUT, down=True)
    time.sleep(1.0)
    before = fleet.taken("first-0")
    time.sleep(cut)
    while_cut = fleet.taken("first-0") - before
    fleet.lab.cut(CUT, down=False)
    recovered = fleet.until(lambda: fleet.taken("first-0") > before + while_cut, "a chunk of the host that was cut off")
    return {
        "seconds_to_start": round(up, 1),
        "seconds_to_first_chunk": round(first, 1),
        "seconds_to_join": round(joined, 1),
        "seconds_cut_off": cut,
        "chunks_while_cut_off": while_cut,
        "seconds_to_recover": round(recovered, 1),
    }


def finish(fleet: Hosts) -> dict[str, Any]:
    """End the fleet, collect, and audit; return the ledger."""
    fleet.eia_sec("down", str(fleet.file))
    target = fleet.lab.folder / "collected"
    fleet.eia_sec("fleet", "collect", str(fleet.file), "--out", str(target))
    found = audit(target)
    steps = {fate: found.steps[fate] for fate in ("accepted", "lost", "rejected", "in_flight")}
    workers = {name: counts["accepted"] for name, counts in sorted(found.workers.items())}
    ledger = {"produced": found.produced, **steps, "duplicate_chunks": found.duplicates}
    return {
        "ledger": {**ledger, "unexplained": len(found.unexplained), "counted_twice": len(found.doubled)},
        "accepted_by_worker": workers,
    }


def evaluated(fleet: Hosts, farms: str) -> dict[str, float]:
    """Return the reward per agent of the trained policy and of two that need no training, on unseen farms."""
    rewards = {}
    for policy in ("", "static", "random"):
        chosen = ["--policy", policy] if policy else []
        words = ["evaluate", "--run-dir", str(fleet.lab.folder / "collected"), "--farms", farms, "--json", *chosen]
        rewards[policy or "trained"] = round(float(json.loads(fleet.eia_sec(*words))["reward"]["mean"]), 1)
    return rewards


def main() -> None:
    """Run, and write the result."""
    arguments = tyro.cli(Arguments, prog="python -m research.experiments.network.hosts")
    with (
        tempfile.TemporaryDirectory() as folder,
        laboratory(Path(folder), len(HOSTS), arguments.delay) as lab,
    ):
        if lab is None:
            sys.exit("making network namespaces needs root and iproute2.")
        fleet = Hosts(lab, arguments.preset, arguments.set)
        seed = read(fleet.file).config.seed
        started = time.monotonic()
        measured = happen(fleet, arguments.cut)
        fleet.until(lambda: time.sleep(2.0) or fleet.state("learner.learner") == "finished", "the end", 7200.0)
        measured["minutes"] = round((time.monotonic() - started) / 60, 1)
        measured |= finish(fleet)
        records = [json.loads(line) for line in (Path(folder) / "collected" / "metrics.jsonl").open(encoding="utf-8")]
        last = [record for record in records if record["kind"] == "status"][-1]
        measured |= {name: last[name] for name in ("episodes", "environment_steps", "updates")}
        measured["reward_per_agent"] = evaluated(fleet, arguments.farms)
    result = {
        **provenance("research.experiments.network.hosts"),
        "preset": arguments.preset,
        "seed": seed,
        "hosts": len(HOSTS),
        "delay_seconds": arguments.delay,
        "farms": arguments.farms,
        **measured,
    }
    text = json.dumps(result, indent=1)
    arguments.output.parent.mkdir(parents=True, exist_ok=True)
    arguments.output.write_text(text + "\n", encoding="utf-8")
    sys.stdout.write(text + "\n")


if __name__ == "__main__":
    main()
