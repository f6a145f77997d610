"""`eia-sec logs fleet.toml`: what the processes of a fleet have written."""

import sys
import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from common.config.checks import within
from common.process import StopSignal
from common.text import printable_lines
from deploy.exit_codes import DONE, FAILED
from deploy.hosts import operations
from deploy.hosts.agent import MAX_LINES
from deploy.hosts.fleet_file import read
from deploy.options import parse


@dataclass(frozen=True)
class LogsArguments:
    """Show the last lines of each process's log, and of the keepers' that start them."""

    file: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="FLEET")] = Path("fleet.toml")
    """The fleet file."""
    process: tuple[str, ...] = ()
    """Processes to show, for instance learner.learner, rollout.farm-2-0 or keeper. Default: all."""
    lines: int = 20
    """Lines of each."""
    follow: bool = False
    """Go on with what they write from now on, each line with host and process before it, until Ctrl-C."""


def command(arguments: Sequence[str]) -> int:
    """Show; return 0, or 1 when a host was not reached."""
    options = parse(LogsArguments, arguments, "logs")
    within(1, MAX_LINES, lines=options.lines)
    if options.follow:
        return _follow(options)
    found, failed = operations.logs(read(options.file), options.process, options.lines)
    for host, texts in found.items():
        for name, text in texts.items():
            sys.stdout.write(printable_lines(f"== {host} {name}\n{text}\n"))
    return _failed(failed)


def _follow(options: LogsArguments) -> int:
    lock, stop = threading.Lock(), StopSignal()

    def tell(host: str, name: str, line: str) -> None:
        with lock:
            try:
                sys.stdout.write(f"{printable_lines(f'{host} {name}: {line}')}\n")
                sys.stdout.flush()
            except BrokenPipeError:
                stop.event.set()

    stop.install()
    failed = operations.follow(read(options.file), options.process, options.lines, tell, stop)
    return _failed(failed)


def _failed(failed: Mapping[str, str]) -> int:
    """Print why hosts failed; return the exit code."""
    sys.stderr.write("".join(f"eia-sec: {printable_lines(sentence)}\n" for sentence in failed.values()))
    return FAILED if failed else DONE
