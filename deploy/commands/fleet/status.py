"""`eia-sec status fleet.toml`: the table of a fleet's processes.

`eia_sec.deploy.hosts.operations.status` asks the agent on each host (`eia_sec.deploy.hosts.agent.status`) for the
states. The fleet file says which processes there should be.
"""

import json
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro
from rich.console import Console
from rich.table import Table

from eia_sec.common.text import printable, printable_lines
from eia_sec.deploy.exit_codes import DONE, FAILED
from eia_sec.deploy.hosts import operations
from eia_sec.deploy.hosts.fleet_file import FleetSpec, read
from eia_sec.deploy.hosts.plan import here, processes
from eia_sec.deploy.options import parse


@dataclass(frozen=True)
class StatusArguments:
    """Show each process of a fleet: state, process id, age, and how often in a row it has died."""

    file: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="FLEET")] = Path("fleet.toml")
    """The fleet file."""
    json: bool = False
    """Print one JSON object instead of the table."""


def command(arguments: Sequence[str]) -> int:
    """Show the state; return 0 if every process is running or has finished, 1 otherwise."""
    options = parse(StatusArguments, arguments, "status")
    fleet = read(options.file)
    states, failed = operations.status(fleet)
    if options.json:
        sys.stdout.write(json.dumps({"hosts": states, "failed": failed}) + "\n")
    else:
        show(fleet, states, failed)
    named = [(process.host, process.label) for process in processes(fleet, here(fleet))]
    words = [states.get(host, {}).get("processes", {}).get(name, {}).get("state") for host, name in named]
    return DONE if all(word in ("running", "finished") for word in words) else FAILED


def show(fleet: FleetSpec, states: Mapping[str, dict[str, Any]], failed: Mapping[str, str]) -> None:
    """Print a table of all processes, named or running, then alarms and failed hosts."""
    table = Table("host", "process", "state", "pid", "since", "deaths", box=None)
    rows: dict[tuple[str, str], dict[str, Any]] = {
        (process.host, process.label): {} for process in processes(fleet, here(fleet))
    }
    rows |= {(host, name): found for host, state in states.items() for name, found in state["processes"].items()}
    for (host, name), found in rows.items():
        state = "unknown" if host in failed else found.get("state", "down")
        pid, deaths = found.get("pid") or "", found.get("deaths", 0)
        since = _age(time.time() - found["since"]) if found.get("since") else ""
        table.add_row(host, printable(name), printable(state), str(pid), since, str(deaths or ""))
    console = Console(highlight=False, soft_wrap=True, markup=False)
    console.print(table)
    for host, state in states.items():
        for alarm in state.get("alarms", []) if state["keeper"] else []:
            console.print(printable(f"{host}: {alarm}"))
    for sentence in failed.values():
        console.print(printable_lines(sentence))


def _age(seconds: float) -> str:
    for size, unit in ((86_400, "d"), (3_600, "h"), (60, "min")):
        if seconds >= size:
            return f"{seconds / size:.0f} {unit}"
    return f"{max(0.0, seconds):.0f} s"
