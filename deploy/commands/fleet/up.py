"""`eia-sec up fleet.toml`: start every process of a fleet on its host."""

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from eia_sec.deploy.commands.fleet.status import show
from eia_sec.deploy.exit_codes import DONE, FAILED
from eia_sec.deploy.hosts import operations
from eia_sec.deploy.hosts.fleet_file import read
from eia_sec.deploy.options import parse


@dataclass(frozen=True)
class UpArguments:
    """Start a fleet's missing processes, restart those that changed, and stop those that the file no longer names."""

    file: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="FLEET")] = Path("fleet.toml")
    """The fleet file; deploy/fleet.toml explains every key."""


def command(arguments: Sequence[str]) -> int:
    """Start the fleet; return 0 if every host has taken up its plan, 1 if not."""
    options = parse(UpArguments, arguments, "up")
    fleet = read(options.file)
    states, failed = operations.up(fleet)
    show(fleet, states, failed)
    tls = f" --tls {fleet.keys}/monitor.monitor" if fleet.keys is not None else ""
    for run in fleet.runs:
        watch = f"eia-sec monitor --run {run.name} --connect {fleet.network.endpoint}{tls}"
        sys.stdout.write(f"watch with:  {watch}\n")
    return FAILED if failed else DONE
