"""`eia-sec fleet`: a fleet file checked, its keys, its histories, and what other ways of starting it need."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro
from rich.console import Console

from common.text import printable, printable_lines
from deploy.exit_codes import DONE, FAILED
from deploy.hosts import operations
from deploy.hosts.fleet_file import read
from deploy.hosts.history_collection import collect
from deploy.hosts.plan import here, processes
from deploy.hosts.render import render
from deploy.options import parse

File = Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="FLEET")]


@dataclass(frozen=True)
class CheckArguments:
    """Read a fleet file, and print every command line that follows from it."""

    file: File = Path("fleet.toml")
    """The fleet file."""


@dataclass(frozen=True)
class KeysArguments:
    """Make the certificates that a fleet lacks, and the authority when there is none."""

    file: File = Path("fleet.toml")
    """The fleet file."""
    days: int = 365
    """Days until they end."""


@dataclass(frozen=True)
class CollectArguments:
    """Bring the histories of all hosts and the learner's metrics and policy into one folder, for `eia-sec audit`."""

    file: File = Path("fleet.toml")
    """The fleet file."""
    out: Path = Path("collected")
    """The folder."""


@dataclass(frozen=True)
class RenderArguments:
    """Write what another way of starting the same fleet needs; every file is replaced."""

    form: Annotated[tyro.conf.Positional[Literal["systemd", "compose", "kubernetes"]], tyro.conf.arg(metavar="FORM")]
    """systemd, compose or kubernetes."""
    file: File = Path("fleet.toml")
    """The fleet file."""
    out: Path = Path("rendered")
    """Folder for the files; those with keys are readable by their owner alone."""


@dataclass(frozen=True)
class FleetArguments:
    """A fleet file: checked, its keys made, its histories collected, its files for other ways of starting written."""

    task: Annotated[
        Annotated[CheckArguments, tyro.conf.subcommand("check")]
        | Annotated[KeysArguments, tyro.conf.subcommand("keys")]
        | Annotated[CollectArguments, tyro.conf.subcommand("collect")]
        | Annotated[RenderArguments, tyro.conf.subcommand("render")],
        tyro.conf.arg(name=""),
    ]


def command(arguments: Sequence[str]) -> int:
    """Do what the subcommand says; return 0, or 1 when a host was not reached."""
    task = parse(FleetArguments, arguments, "fleet").task
    console = Console(highlight=False, soft_wrap=True, markup=False)
    fleet = read(task.file)
    if isinstance(task, CheckArguments):
        for process in processes(fleet, here(fleet)):
            console.print(f"{process.host}: eia-sec {' '.join(process.arguments)}")
        return DONE
    if isinstance(task, KeysArguments):
        made = operations.issue_keys(fleet, task.days)
        names = ", ".join(map(str, made)) or "nothing: every certificate is there"
        console.print(f"written into {fleet.keys}: {names}")
        return DONE
    if isinstance(task, RenderArguments):
        for path in render(fleet, task.form, task.out):
            console.print(f"written: {path}")
        return DONE
    found = collect(fleet, task.out)
    console.print(f"{found.files} files in {task.out}; eia-sec audit {task.out}")
    for name in found.left_out:
        console.print(f"left out, because it is not that host's to tell: {printable(name)}")
    for sentence in found.failed.values():
        console.print(printable_lines(sentence))
    return FAILED if found.failed else DONE
