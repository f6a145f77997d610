"""`eia-sec down fleet.toml`: the end of a fleet, workers first."""

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from common.config.checks import within
from common.text import printable_lines
from deploy.exit_codes import DONE, FAILED
from deploy.hosts import operations
from deploy.hosts.fleet_file import read
from deploy.options import parse


@dataclass(frozen=True)
class DownArguments:
    """End a fleet: workers deliver what they hold, the learner writes a checkpoint; `eia-sec up` goes on from there."""

    file: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="FLEET")] = Path("fleet.toml")
    """The fleet file."""
    wait: float = 60.0
    """Seconds to wait for workers, then for the coordinator, the learner and the router."""
    kill: bool = False
    """Kill what has not ended then; what it held is lost, and the audit says so."""


def command(arguments: Sequence[str]) -> int:
    """End; return 0 when everything has ended, 1 when something has not or a host was not reached."""
    options = parse(DownArguments, arguments, "down")
    within(0.0, 86_400.0, wait=options.wait)
    ended, left, failed = operations.down(read(options.file), options.wait, options.kill)
    lines = [f"{name} has ended." for name in ended]
    lines += [f"{name} did not end within {options.wait:g} s; --kill ends it." for name in left]
    lines += list(failed.values())
    sys.stdout.write("".join(f"{printable_lines(line)}\n" for line in lines or ["nothing was running."]))
    return FAILED if left or failed else DONE
