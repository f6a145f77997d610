"""`eia-sec down fleet.toml`: stop a fleet, workers first, or single processes of it."""

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from eia_sec.common.config.checks import within
from eia_sec.common.text import printable_lines
from eia_sec.deploy.exit_codes import DONE, FAILED
from eia_sec.deploy.hosts import operations
from eia_sec.deploy.hosts.fleet_file import read
from eia_sec.deploy.options import parse


@dataclass(frozen=True)
class DownArguments:
    """Stop a fleet, or some processes. Workers deliver what they hold, the learner keeps its state; `up` resumes."""

    file: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="FLEET")] = Path("fleet.toml")
    """The fleet file."""
    process: tuple[str, ...] = ()
    """Processes to stop, for example rollout.farm-2-0, which leaves the others as they are. Default: all."""
    wait: float = 60.0
    """Seconds to wait for the workers, then for the coordinator, the learner and the routers in turn."""
    kill: bool = False
    """Kill processes that are still running then; the steps they hold are lost, and the audit says so."""


def command(arguments: Sequence[str]) -> int:
    """Stop; return 0 if everything has stopped, 1 if something runs or a host was not reached."""
    options = parse(DownArguments, arguments, "down")
    within(0.0, 86_400.0, wait=options.wait)
    fleet = read(options.file)
    ended, left, failed = operations.down(fleet, options.wait, options.kill, names=options.process)
    lines = [f"{name} has stopped." for name in ended]
    lines += [f"{name} is still running after {options.wait:g} s; --kill stops it." for name in left]
    lines += list(failed.values())
    sys.stdout.write("".join(f"{printable_lines(line)}\n" for line in lines or ["nothing was running."]))
    return FAILED if left or failed else DONE
