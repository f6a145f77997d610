"""`eia-sec fleet`: check a fleet file, make its keys, collect its histories, move its learner, render units."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro
from rich.console import Console

from eia_sec.common.config.checks import within
from eia_sec.common.text import printable, printable_lines
from eia_sec.deploy.commands.fleet.status import show
from eia_sec.deploy.exit_codes import DONE, FAILED
from eia_sec.deploy.hosts import operations
from eia_sec.deploy.hosts.fleet_file import FleetSpec, read
from eia_sec.deploy.hosts.history_collection import collect
from eia_sec.deploy.hosts.plan import here, processes
from eia_sec.deploy.hosts.render import keeping, left_over, render
from eia_sec.deploy.options import parse

File = Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="FLEET")]


@dataclass(frozen=True)
class CheckArguments:
    """Check a fleet file and print the command line of every process."""

    file: File = Path("fleet.toml")
    """The fleet file."""


@dataclass(frozen=True)
class KeysArguments:
    """Make the certificates that a fleet lacks, and the authority if there is none."""

    file: File = Path("fleet.toml")
    """The fleet file."""
    days: int = 365
    """Days until they expire."""


@dataclass(frozen=True)
class CollectArguments:
    """Copy the histories of all hosts and the learner's metrics and policy into one folder, for `eia-sec audit`."""

    file: File = Path("fleet.toml")
    """The fleet file."""
    out: Path = Path("collected")
    """Output folder."""


@dataclass(frozen=True)
class MoveLearnerArguments:
    """Move the run to the host that [learner] now names: stop the fleet, copy checkpoints and history, and continue."""

    file: File = Path("fleet.toml")
    """The fleet file; the host that the run leaves is still among its hosts."""
    wait: float = 60.0
    """Seconds to wait for the workers, then for the coordinator, the learner and the router in turn."""


@dataclass(frozen=True)
class RenderArguments:
    """Write files that start the same fleet with systemd, Compose or Kubernetes, or watch it with Prometheus."""

    form: Annotated[
        tyro.conf.Positional[Literal["systemd", "compose", "kubernetes", "prometheus"]], tyro.conf.arg(metavar="FORM")
    ]
    """systemd, compose, kubernetes or prometheus."""
    file: File = Path("fleet.toml")
    """The fleet file."""
    out: Path = Path("rendered")
    """Output folder; files with keys are readable by their owner only."""


@dataclass(frozen=True)
class FleetArguments:
    """Check a fleet file, make its keys, collect its histories, move its learner, or render units and manifests."""

    task: Annotated[
        Annotated[CheckArguments, tyro.conf.subcommand("check")]
        | Annotated[KeysArguments, tyro.conf.subcommand("keys")]
        | Annotated[CollectArguments, tyro.conf.subcommand("collect")]
        | Annotated[MoveLearnerArguments, tyro.conf.subcommand("move-learner")]
        | Annotated[RenderArguments, tyro.conf.subcommand("render")],
        tyro.conf.arg(name=""),
    ]


def command(arguments: Sequence[str]) -> int:
    """Run the subcommand; return 0, or 1 if a host was not reached."""
    task = parse(FleetArguments, arguments, "fleet").task
    console = Console(highlight=False, soft_wrap=True, markup=False)
    fleet = read(task.file)
    if isinstance(task, CheckArguments):
        for process in processes(fleet, here(fleet)):
            console.print(f"{process.host}: eia-sec {' '.join(process.arguments)}")
        return DONE
    if isinstance(task, KeysArguments):
        made = operations.issue_keys(fleet, task.days)
        names = ", ".join(map(str, made)) or "nothing, every certificate exists"
        console.print(f"written to {fleet.keys}: {names}")
        return DONE
    if isinstance(task, RenderArguments):
        kept = keeping(fleet, task.form, task.out)
        written = render(fleet, task.form, task.out)
        for path in written:
            console.print(f"written: {path}")
        for path in left_over(fleet, task.form, task.out, written):
            console.print(f"no longer in the fleet; delete it: {printable(str(path))}")
        console.print(printable(kept))
        return DONE
    if isinstance(task, MoveLearnerArguments):
        within(0.0, 86_400.0, wait=task.wait)
        for sentence in operations.move_learner(fleet, task.wait):
            console.print(printable_lines(sentence))
        states, failed = operations.up(fleet)
        show(fleet, states, failed)
        return FAILED if failed else DONE
    return _collect(fleet, task, console)


def _collect(fleet: FleetSpec, task: CollectArguments, console: Console) -> int:
    found = collect(fleet, task.out)
    console.print(f"{found.files} files in {task.out}; check them with:")
    for run in fleet.runs:
        console.print(f"eia-sec audit {task.out / run.folder}")
    for name in found.left_out:
        console.print(f"skipped, because it does not belong to that host: {printable(name)}")
    for host in found.strays:
        if fleet.population:
            console.print(f"{host} holds files of a member whose learner runs elsewhere; they were not collected.")
            continue
        console.print(
            f"{host} holds learner's files of run {fleet.run}, and [learner] names {fleet.learner.host}: they were not "
            f"collected; `eia-sec fleet move-learner {task.file}` moves them."
        )
    for sentence in found.failed.values():
        console.print(printable_lines(sentence))
    return FAILED if found.failed or found.strays else DONE
