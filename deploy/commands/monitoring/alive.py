"""`eia-sec alive ROLE NAME`: a probe for orchestrators, which checks a process's liveliness token."""

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Final

import tyro

from eia_sec.common.config.checks import within
from eia_sec.common.errors import CredentialsError, EndpointError, UsageError
from eia_sec.common.names import check_name
from eia_sec.common.protocol import keys
from eia_sec.common.transport.endpoint import DEFAULT, Endpoint
from eia_sec.deploy.exit_codes import DONE, FAILED
from eia_sec.deploy.listener import connected
from eia_sec.deploy.options import parse

LIVING: Final = ("learner", "rollout", "elite", "router")
"""Roles that can be probed. A router has no token: it is alive when it answers."""


@dataclass(frozen=True)
class AliveArguments:
    """Check whether a process is alive: exit code 0 if it is, 1 if not."""

    role: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="ROLE")]
    """learner, rollout, elite or router. A router counts as alive when any listener answers at the endpoint, even a
    learner: its name and --run are not compared."""
    name: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="NAME")]
    """The process's name."""
    run: str = "farm"
    """Name of the run."""
    connect: str = DEFAULT
    """Endpoint where the learner or a router listens."""
    tls: Path | None = None
    """Folder with a certificate: the process's own or a monitor's."""
    patience: float = 5.0
    """Seconds to wait for a listener at the endpoint."""
    blame: bool = False
    """Exit with 1 only if restarting this process could help. Exit with 0 if the endpoint does not answer, and for a
    worker or coordinator also if no learner is alive, because it has no token while it waits for one."""


def command(arguments: Sequence[str]) -> int:
    """Print one line; return 0 if the process is alive (or not to blame), 1 otherwise."""
    options = parse(AliveArguments, arguments, "alive")
    if options.role not in LIVING:
        raise UsageError(f"{options.role!r} is not a role; the roles are {', '.join(LIVING)}.")
    within(0.0, 1e9, patience=options.patience)
    key = keys.LIVE.key(check_name(options.run, "run"), role=options.role, name=options.name)
    endpoint = Endpoint.parse(options.connect, options.tls)
    who = f"{options.role} {options.name} of run {options.run}"
    try:
        with connected(endpoint, options.patience) as bus:
            if options.role == "router" or bus.living(key):
                return _report(f"{who} is alive.", DONE)
            waiting = options.role != "learner" and not bus.living(keys.LIVE.pattern(options.run, role="learner"))
    except CredentialsError:
        raise
    except EndpointError as error:
        return _report(f"{who}: {error}", DONE if options.blame else FAILED)
    if options.blame and waiting:
        return _report(f"{who} is waiting for a learner, and none of run {options.run} is alive.", DONE)
    return _report(f"{who} is not alive at {endpoint}.", FAILED)


def _report(text: str, code: int) -> int:
    sys.stdout.write(text + "\n")
    return code
