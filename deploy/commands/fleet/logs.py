"""`eia-sec logs fleet.toml`: the logs of a fleet's processes."""

import sys
import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from eia_sec.common.config.checks import within
from eia_sec.common.process import StopSignal
from eia_sec.common.text import printable_lines
from eia_sec.deploy.exit_codes import DONE, FAILED
from eia_sec.deploy.hosts import operations
from eia_sec.deploy.hosts.agent import MAX_LINES
from eia_sec.deploy.hosts.fleet_file import FleetSpec, read
from eia_sec.deploy.hosts.plan import here, processes
from eia_sec.deploy.options import parse


@dataclass(frozen=True)
class LogsArguments:
    """Show the last lines of each process's log, and of each host's keeper, which supervises them."""

    file: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="FLEET")] = Path("fleet.toml")
    """The fleet file."""
    process: tuple[str, ...] = ()
    """Processes to show, for example learner.learner, rollout.farm-2-0 or keeper. Default: all."""
    lines: int = 20
    """Lines of each log."""
    follow: bool = False
    """Keep printing new lines, each with host and process in front, until Ctrl-C."""


def command(arguments: Sequence[str]) -> int:
    """Show the logs; return 0, or 1 if a host was not reached."""
    options = parse(LogsArguments, arguments, "logs")
    within(1, MAX_LINES, lines=options.lines)
    fleet = read(options.file)
    _require_processes(fleet, options.process)
    if options.follow:
        return _follow(fleet, options)
    found, failed = operations.logs(fleet, options.process, options.lines)
    for host, texts in found.items():
        for name, text in texts.items():
            sys.stdout.write(printable_lines(f"== {host} {name}\n{text}\n"))
    return _failed(failed)


def _require_processes(fleet: FleetSpec, wanted: Sequence[str]) -> None:
    """Raise UsageError for a name that no process of the fleet has, and of which no host has a log.

    A process that has left the fleet file still has its log.
    """
    known = ["keeper", *(process.label for process in processes(fleet, here(fleet)))]
    strangers = [name for name in wanted if name not in known]
    if strangers and (missing := _without_log(fleet, strangers)):
        raise operations.no_process(fleet, missing[0], known)


def _without_log(fleet: FleetSpec, names: Sequence[str]) -> list[str]:
    """Return the names of which no host has a log; none while a host that may have it is not reached."""
    found, failed = operations.logs(fleet, names, 1)
    return [] if failed else [name for name in names if not any(name in texts for texts in found.values())]


def _follow(fleet: FleetSpec, options: LogsArguments) -> int:
    lock, stop = threading.Lock(), StopSignal()

    def show(host: str, name: str, line: str) -> None:
        with lock:
            try:
                sys.stdout.write(f"{printable_lines(f'{host} {name}: {line}')}\n")
                sys.stdout.flush()
            except BrokenPipeError:
                stop.event.set()

    stop.install()
    failed = operations.follow(fleet, options.process, options.lines, show, stop)
    return _failed(failed)


def _failed(failed: Mapping[str, str]) -> int:
    """Print why hosts failed; return the exit code."""
    sys.stderr.write("".join(f"eia-sec: {printable_lines(sentence)}\n" for sentence in failed.values()))
    return FAILED if failed else DONE
