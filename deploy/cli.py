"""The console command `eia-sec`: the first word names the subcommand, the rest are its options."""

import gc
import importlib
import io
import os
import signal
import sys
from dataclasses import dataclass
from types import FrameType, ModuleType
from typing import Final, NoReturn

from common.errors import UsageError
from deploy.exit_codes import run_command
from deploy.local.memory import keep_freed_memory
from deploy.local.threads import thread_environment


@dataclass(frozen=True)
class Command:
    """One subcommand.

    Attributes:
        module: the module whose `command(arguments)` runs it; imported only when needed.
        summary: one line for the overview.
    """

    module: str
    summary: str


COMMANDS: Final = {
    "train": Command(
        "deploy.commands.training.train", "train on this machine: learner, coordinator, workers, live view"
    ),
    "learner": Command("deploy.commands.training.learner", "start the learner alone"),
    "rollout": Command("deploy.commands.training.rollout", "start one rollout worker"),
    "elite": Command("deploy.commands.training.elite", "start the elite coordinator"),
    "router": Command(
        "deploy.commands.training.router", "start a router that learner, workers and monitors connect to"
    ),
    "evaluate": Command("deploy.commands.policies.evaluate", "evaluate a policy on farms that training never saw"),
    "replay": Command(
        "deploy.commands.policies.replay", "compare two policies on one farm: a film and their flight paths"
    ),
    "farm": Command("deploy.commands.policies.farm", "draw, save or check farms and files of sensor positions"),
    "reproduce": Command("experiments.studies.command", "redo the paper's studies, with tables and plots"),
    "export": Command("deploy.commands.policies.export", "export a run's actors as ONNX or plain tensors"),
    "fly": Command("deploy.commands.policies.fly", "fly vehicles with trained actors: observations in, set-points out"),
    "simulator": Command("deploy.commands.policies.simulator", "simulate the vehicles that eia-sec fly controls"),
    "keys": Command("deploy.commands.fleet.keys", "make and renew the certificates that --tls needs"),
    "audit": Command("deploy.commands.monitoring.audit", "check that every chunk of a run is accounted for"),
    "up": Command("deploy.commands.fleet.up", "start the processes of a fleet file on its hosts, over SSH"),
    "down": Command("deploy.commands.fleet.down", "stop a fleet, workers first"),
    "status": Command("deploy.commands.fleet.status", "show the processes of a fleet and their state"),
    "logs": Command("deploy.commands.fleet.logs", "show the logs of a fleet"),
    "fleet": Command(
        "deploy.commands.fleet.fleet", "check a fleet file, make keys, collect histories, render units and manifests"
    ),
    "host": Command("deploy.commands.fleet.host", "internal: up, down, status and logs call it on each host"),
    "alive": Command(
        "deploy.commands.monitoring.alive", "probe one process of a run, for a supervisor or orchestrator"
    ),
    "monitor": Command("deploy.commands.monitoring.monitor", "watch a run live in the terminal, read-only"),
    "watch": Command("deploy.commands.monitoring.watch", "watch one worker's farm live in the browser"),
}


def overview() -> str:
    """Return the text of `eia-sec --help`."""
    lines = [f"  {name:<10}{command.summary}" for name, command in COMMANDS.items()]
    return "\n".join(["usage: eia-sec COMMAND [OPTIONS]", "", *lines, "", "eia-sec COMMAND --help shows its options."])


def dispatch(arguments: list[str]) -> int:
    """Run one command line; raise UsageError for a word that is no command."""
    if not arguments or arguments[0] in ("-h", "--help", "help"):
        sys.stdout.write(overview() + "\n")
        return 0 if arguments else 2
    command = COMMANDS.get(arguments[0])
    if command is None:
        raise UsageError(f"unknown command {arguments[0]!r}; the commands are {', '.join(COMMANDS)}.")
    # Before numpy is loaded: a process that starts as many compute threads as there are cores slows all the others.
    for variable, threads in thread_environment(1).items():
        os.environ.setdefault(variable, threads)
    keep_freed_memory()
    return int(_load(arguments[0], command.module).command(arguments[1:]) or 0)


def _load(word: str, module: str) -> ModuleType:
    """Import a command's module; the studies are no part of the installed package."""
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as error:
        if error.name != module.partition(".")[0]:
            raise
        raise UsageError(f"eia-sec {word} needs a checkout of the source: the studies are not installed.") from error


def _terminate(number: int, frame: FrameType | None) -> NoReturn:
    raise SystemExit(128 + number)


def main() -> None:
    """Entry point of the console script."""
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
