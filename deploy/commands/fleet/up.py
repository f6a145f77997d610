"""`eia-sec up fleet.toml`: every process of a fleet, on its hosts."""

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from deploy.commands.fleet.status import show
from deploy.exit_codes import DONE, FAILED
from deploy.hosts import operations
from deploy.hosts.fleet_file import read
from deploy.options import parse


@dataclass(frozen=True)
class UpArguments:
    """Start what a fleet file names and does not run yet; restart what has changed, end what it no longer names."""

    file: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="FLEET")] = Path("fleet.toml")
    """The fleet file; deploy/fleet.toml explains every key."""


def command(arguments: Sequence[str]) -> int:
    """Start; return 0 when every host has taken its part up, 1 when one has not."""
    options = parse(UpArguments, arguments, "up")
    fleet = read(options.file)
    states, failed = operations.up(fleet)
    show(fleet, states, failed)
    tls = f" --tls {fleet.keys}/monitor.monitor" if fleet.keys is not None else ""
    watch = f"eia-sec monitor --run {fleet.run} --connect {fleet.network.endpoint}{tls}"
    sys.stdout.write(f"watch with:  {watch}\n")
    return FAILED if failed else DONE
