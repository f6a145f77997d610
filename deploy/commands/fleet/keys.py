"""`eia-sec keys`: an installation's certificate authority, and a certificate for each process."""

import datetime
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console
from rich.table import Table

from eia_sec.common.errors import CredentialsError
from eia_sec.common.transport import credentials
from eia_sec.common.transport.credentials import CA, CERTIFICATE, LISTENING, MEMBERS, ROLES, SOON, Identity
from eia_sec.deploy.exit_codes import DONE
from eia_sec.deploy.options import parse
from eia_sec.deploy.security import authority

Role = Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="ROLE")]
Name = Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="NAME")]


@dataclass(frozen=True)
class _InFolder:
    dir: Path = Path("keys")
    """Folder of the authority."""


@dataclass(frozen=True)
class InitArguments(_InFolder):
    """Make a certificate authority. Its key, ca.key, signs everything else; keep it off the training machines."""


@dataclass(frozen=True)
class IssueArguments(_InFolder):
    """Make the key and certificate of one process and add it to the members."""

    role: Role = ""
    """learner, router, flight, rollout, elite, operator, monitor, watcher, vehicle or environment."""
    name: Name = ""
    """The process's name: a worker's `--name`, "learner" for the learner."""
    host: tuple[str, ...] = ()
    """Names and addresses that a learner, router or flight node listens on; needed for these roles."""
    days: int = 365
    """Days until the certificate expires."""


@dataclass(frozen=True)
class RenewArguments(_InFolder):
    """Replace the key and certificate of one process; name and hosts stay the same."""

    role: Role = ""
    """The process's role."""
    name: Name = ""
    """The process's name."""
    days: int = 365
    """Days until the new certificate expires."""


@dataclass(frozen=True)
class RevokeArguments(_InFolder):
    """Remove one process from the members, a list that listeners read when they start."""

    role: Role = ""
    """The process's role."""
    name: Name = ""
    """The process's name."""


@dataclass(frozen=True)
class ShowArguments:
    """List certificates and when they expire."""

    dir: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="DIR")] = Path("keys")
    """Folder of the authority or of one process."""


@dataclass(frozen=True)
class KeysArguments:
    """Make, renew, revoke and list the certificates that `--tls` needs."""

    task: Annotated[
        Annotated[InitArguments, tyro.conf.subcommand("init")]
        | Annotated[IssueArguments, tyro.conf.subcommand("issue")]
        | Annotated[RenewArguments, tyro.conf.subcommand("renew")]
        | Annotated[RevokeArguments, tyro.conf.subcommand("revoke")]
        | Annotated[ShowArguments, tyro.conf.subcommand("show")],
        tyro.conf.arg(name=""),
    ]


def command(arguments: Sequence[str]) -> int:
    """Run the subcommand; return 0."""
    task = parse(KeysArguments, arguments, "keys").task
    console = Console(highlight=False, soft_wrap=True, markup=False)
    if isinstance(task, InitArguments):
        authority.create(task.dir)
        console.print(f"written: {task.dir / CA} and {task.dir / authority.CA_KEY}; keep the latter secret.")
        _show(task.dir, console)
    elif isinstance(task, IssueArguments):
        target = authority.issue(task.dir, _identity(task.role, task.name), task.host, authority.lasting(task.days))
        _report(target, console)
        _remind(task.dir, console)
    elif isinstance(task, RenewArguments):
        _report(authority.renew(task.dir, _identity(task.role, task.name), authority.lasting(task.days)), console)
    elif isinstance(task, RevokeArguments):
        identity = _identity(task.role, task.name)
        authority.revoke(task.dir, identity)
        console.print(f"{identity} is no longer a member.")
        _remind(task.dir, console)
    else:
        _show(task.dir, console)
    return DONE


def _identity(role: str, name: str) -> Identity:
    if role not in ROLES or not name:
        raise CredentialsError(f"give ROLE and NAME; the roles are {', '.join(ROLES)}.")
    if role == "learner" and name != "learner":
        raise CredentialsError("the learner is always named learner: eia-sec keys issue learner learner --host HOST.")
    return Identity.parse(f"{role}.{name}")


def _report(target: Path, console: Console) -> None:
    loaded = credentials.load(target)
    console.print(f"written: {loaded.identity} in {target}, valid until {loaded.expires:%Y-%m-%d}.")


def _remind(folder: Path, console: Console) -> None:
    """Print which listeners need the new list of members."""
    listening = sorted(path.name for role in LISTENING for path in folder.glob(f"{role}.*"))
    if listening:
        console.print(f"{MEMBERS} has changed: copy it to {', '.join(listening)} and restart for it to take effect.")


def _show(folder: Path, console: Console) -> None:
    paths = [path for path in (folder / CA, folder / CERTIFICATE) if path.exists()]
    paths += sorted(folder.glob(f"*/{CERTIFICATE}"))
    if not paths:
        raise CredentialsError(f"{folder} has no certificate.")
    members = set(credentials.read_members(folder / MEMBERS)) if (folder / MEMBERS).exists() else None
    table = Table("certificate", "expires", "left", "serves", "member", box=None)
    for path in paths:
        table.add_row(*_row(path, members))
    console.print(table)


def _row(path: Path, members: set[Identity] | None) -> list[str]:
    certificate = credentials.read_certificate(path)
    left = certificate.not_valid_after_utc - datetime.datetime.now(datetime.UTC)
    state = "expired" if left.total_seconds() < 0 else f"{left.days} days{', renew it' if left < SOON else ''}"
    ends = f"{certificate.not_valid_after_utc:%Y-%m-%d}"
    if path.name == CA:
        return ["authority", ends, state, "", ""]
    identity = credentials.identity_of(certificate, path)
    known = "" if members is None else "yes" if identity in members else "no"
    return [str(identity), ends, state, ", ".join(credentials.hosts_of(certificate)), known]
