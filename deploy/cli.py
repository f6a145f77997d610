"""The console command `eia-sec`: the first word names the subcommand, the rest are its options."""

import faulthandler
import gc
import importlib
import io
import os
import signal
import sys
from contextlib import suppress
from dataclasses import dataclass
from types import FrameType, ModuleType
from typing import Final, NoReturn

from eia_sec.common.errors import TerminatedError, UsageError
from eia_sec.common.log import FORMAT, FORMATS
from eia_sec.common.spelling import did_you_mean
from eia_sec.deploy.exit_codes import INTERRUPTED, run_command
from eia_sec.deploy.local.memory import keep_freed_memory
from eia_sec.deploy.local.threads import thread_environment


@dataclass(frozen=True)
class Command:
    """One subcommand.

    Attributes:
        module: the module whose `command(arguments)` runs it; imported only when needed.
        summary: one line for the overview.
    """

    module: str
    summary: str

    @property
    def internal(self) -> bool:
        """Whether only other commands call it."""
        return self.summary.startswith("internal")


COMMANDS: Final = {
    "train": Command(
        "eia_sec.deploy.commands.training.train", "train on this machine: learner, coordinator, workers, live view"
    ),
    "benchmark": Command(
        "eia_sec.deploy.commands.training.benchmark", "compare algorithms over seeds and environments: table and plots"
    ),
    "learner": Command("eia_sec.deploy.commands.training.learner", "start the learner alone"),
    "rollout": Command("eia_sec.deploy.commands.training.rollout", "start one rollout worker"),
    "elite": Command("eia_sec.deploy.commands.training.elite", "start the elite coordinator"),
    "router": Command(
        "eia_sec.deploy.commands.training.router", "start a router that learner, workers and monitors connect to"
    ),
    "evaluate": Command(
        "eia_sec.deploy.commands.policies.evaluate", "evaluate a policy on farms that training never saw"
    ),
    "replay": Command(
        "eia_sec.deploy.commands.policies.replay", "compare two policies on one farm: a film and their flight paths"
    ),
    "record": Command(
        "eia_sec.deploy.commands.policies.record", "record what a policy does, for train --demonstrations"
    ),
    "farm": Command("eia_sec.deploy.commands.policies.farm", "draw, save or check farms and files of sensor positions"),
    "export": Command("eia_sec.deploy.commands.policies.export", "export a run's actors as ONNX or plain tensors"),
    "fly": Command("eia_sec.deploy.commands.policies.fly", "fly vehicles with a policy: poses in, set-points out"),
    "simulator": Command(
        "eia_sec.deploy.commands.policies.simulator", "simulate the vehicles that eia-sec fly controls"
    ),
    "bridge": Command(
        "eia_sec.deploy.commands.policies.bridge",
        "connect a vehicle's autopilot to eia-sec fly: MAVLink, or PX4's own Zenoh",
    ),
    "keys": Command("eia_sec.deploy.commands.fleet.keys", "make and renew the certificates that --tls needs"),
    "audit": Command("eia_sec.deploy.commands.monitoring.audit", "check that every chunk of a run is accounted for"),
    "up": Command("eia_sec.deploy.commands.fleet.up", "start the processes of a fleet file on its hosts, over SSH"),
    "down": Command("eia_sec.deploy.commands.fleet.down", "stop a fleet, workers first"),
    "restart": Command("eia_sec.deploy.commands.fleet.restart", "restart a fleet, at once or host after host"),
    "status": Command("eia_sec.deploy.commands.fleet.status", "show the processes of a fleet and their state"),
    "logs": Command("eia_sec.deploy.commands.fleet.logs", "show the logs of a fleet"),
    "fleet": Command(
        "eia_sec.deploy.commands.fleet.fleet",
        "check a fleet file, make keys, collect histories, move the learner, render units",
    ),
    "host": Command(
        "eia_sec.deploy.commands.fleet.host", "internal: up, down, status, logs and fleet call it on each host"
    ),
    "trial": Command(
        "eia_sec.deploy.commands.training.trial", "internal: train tries an environment from outside with it"
    ),
    "measure": Command("eia_sec.deploy.commands.training.measure", "internal: benchmark does each of its runs with it"),
    "alive": Command(
        "eia_sec.deploy.commands.monitoring.alive", "probe one process of a run, for a supervisor or orchestrator"
    ),
    "monitor": Command("eia_sec.deploy.commands.monitoring.monitor", "watch a run live in the terminal, read-only"),
    "watch": Command(
        "eia_sec.deploy.commands.monitoring.watch",
        "watch a worker's farm, or any other environment, live in the browser",
    ),
}


LOG_FORMAT: Final = ("--log-format", "--log_format")
"""Spellings of the option that every command has."""
PLUGIN: Final = "--plugin"
ENV: Final = ("--env", "--env.name")


def overview() -> str:
    """Return the text of `eia-sec --help`."""
    lines = [f"  {name:<10}{command.summary}" for name, command in COMMANDS.items()]
    hints = [
        "eia-sec COMMAND --help shows its options, and those of train and learner with --help-all all settings, too.",
        "Each command takes --log-format text or json: how it and the processes that it starts write their logs.",
        "Each command takes --plugin NAME, any number of times: a package of yours whose code it runs.",
    ]
    return "\n".join(["usage: eia-sec COMMAND [OPTIONS]", "", *lines, "", *hints])


def without_log_format(arguments: list[str]) -> list[str]:
    """Return a command line without `--log-format FORMAT`, which it sets for this process and those that it starts.

    Raises:
        UsageError: there is no such format.
    """
    places = [place for place, word in enumerate(arguments) if word.partition("=")[0] in LOG_FORMAT]
    if not places:
        return arguments
    place = places[0]
    _, equals, value = arguments[place].partition("=")
    end = place + 1 if equals else place + 2
    value = value if equals else "".join(arguments[place + 1 : end])
    if value not in FORMATS:
        raise UsageError(f"--log-format is {value or 'empty'}, not {' or '.join(FORMATS)}.")
    os.environ[FORMAT] = value
    return [*arguments[:place], *arguments[end:]]


def without_plugins(arguments: list[str]) -> tuple[list[str], list[str]]:
    """Return a command line without `--plugin NAME`, and the names.

    Raises:
        UsageError: an option has no name.
    """
    rest: list[str] = arguments[:1]
    named: list[str] = []
    words = iter(arguments[1:])
    for word in words:
        option, equals, value = word.partition("=")
        if option != PLUGIN:
            rest.append(word)
            continue
        name = value if equals else next(words, "")
        if not name or name.startswith("-"):
            raise UsageError("--plugin needs the name of a module or of an installed plug-in.")
        named.append(name)
    return rest, named


def with_plugins(arguments: list[str], named: list[str]) -> list[str]:
    """Load plug-ins; return the command line with their environments' names written out as module:name.

    Raises:
        PluginError: one cannot be used.
    """
    plugins = importlib.import_module("eia_sec.common.plugins")
    for name in named:
        plugins.load(name)
    found = list(arguments)
    for place, word in enumerate(arguments):
        option, equals, value = word.partition("=")
        if option in ENV and equals:
            found[place] = f"{option}={plugins.environment(value)}"
        elif place and arguments[place - 1] in ENV:
            found[place] = plugins.environment(word)
    return found


def dispatch(arguments: list[str]) -> int:
    """Run one command line; raise UsageError for a word that is no command."""
    if not arguments or arguments[0] in ("-h", "--help", "help"):
        sys.stdout.write(overview() + "\n")
        return 0 if arguments else 2
    arguments, named = without_plugins(without_log_format(arguments))
    command = COMMANDS.get(arguments[0])
    if command is None:
        meant = did_you_mean(arguments[0], [name for name, one in COMMANDS.items() if not one.internal])
        raise UsageError(f"unknown command {arguments[0]!r}{meant or '.'} The commands are {', '.join(COMMANDS)}.")
    # Before numpy is loaded: a process that starts as many compute threads as there are cores slows all the others.
    for variable, threads in thread_environment(1).items():
        os.environ.setdefault(variable, threads)
    keep_freed_memory()
    if named:
        arguments = with_plugins(arguments, named)
    return int(_load(command.module).command(arguments[1:]) or 0)


def _quit(number: int, frame: FrameType | None) -> NoReturn:
    """End at once: nothing has been started yet, and an exception would be raised in the middle of an import."""
    with suppress(OSError):
        os.write(2, b"eia-sec: interrupted.\n")
    os._exit(INTERRUPTED)


def _load(module: str) -> ModuleType:
    """Import a command's module, which takes seconds; Ctrl-C meanwhile ends the process without a traceback."""
    try:
        before = signal.signal(signal.SIGINT, _quit)
    except ValueError:  # only the main thread may
        return importlib.import_module(module)
    try:
        return importlib.import_module(module)
    finally:
        signal.signal(signal.SIGINT, before)


def _open_standard_streams() -> None:
    """Open those that the caller has closed on /dev/null: the next file opened would take their place."""
    for number, name, mode in ((0, "stdin", "r"), (1, "stdout", "w"), (2, "stderr", "w")):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)
        if getattr(sys, name) is None:
            setattr(sys, name, os.fdopen(number, mode, encoding="utf-8", closefd=False))


def _terminate(number: int, frame: FrameType | None) -> NoReturn:
    raise TerminatedError(128 + number)


def main() -> None:
    """Entry point of the console script."""
    _open_standard_streams()
    faulthandler.enable()  # a library of the user's may crash without a word
    # Until a command handles it: what it has started is ended, and PID 1 of a container has no other way to stop.
    signal.signal(signal.SIGTERM, _terminate)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")  # paths may hold bytes that are no text
    code = run_command(lambda: dispatch(sys.argv[1:]))
    # Without this, the garbage collector searches torch's objects for cycles, which takes most of the shutdown.
    gc.freeze()
    sys.exit(code)


if __name__ == "__main__":
    main()
