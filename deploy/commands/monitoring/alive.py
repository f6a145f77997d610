"""`eia-sec alive ROLE NAME`: whether a process of a run lives, by its liveliness token; a probe for orchestrators."""

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Final

import tyro

from common.errors import CredentialsError, EndpointError, UsageError
from common.names import check_name
from common.protocol import keys
from common.transport.bus import Bus
from common.transport.endpoint import DEFAULT, Endpoint
from deploy.exit_codes import DONE, FAILED
from deploy.options import parse

LIVING: Final = ("learner", "rollout", "elite", "router")
"""Roles that can be asked for. A router has no token: it lives when it answers."""


@dataclass(frozen=True)
class AliveArguments:
    """Say whether a process lives: exit code 0 when it does, 1 when not."""

    role: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="ROLE")]
    """learner, rollout, elite or router."""
    name: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="NAME")]
    """The process's name."""
    run: str = "farm"
    """Name of the run."""
    connect: str = DEFAULT
    """Endpoint where the learner or a router listens."""
    tls: Path | None = None
    """Folder with a certificate: the process's own, or that of a monitor."""
    patience: float = 5.0
    """Seconds to wait for somebody to listen at the endpoint."""
    blame: bool = False
    """Exit with 1 only when starting the process again could help: not while nobody answers at the endpoint, which is
    another process's, nor, for a worker or coordinator, while no learner lives, for which they wait without a token."""


def command(arguments: Sequence[str]) -> int:
    """Print one line; return 0 when the process lives (or is not to blame), 1 when it does not."""
    options = parse(AliveArguments, arguments, "alive")
    if options.role not in LIVING:
        raise UsageError(f"{options.role!r} is none of the roles {', '.join(LIVING)}.")
    key = keys.LIVE.key(check_name(options.run, "run"), role=options.role, name=options.name)
    endpoint = Endpoint.parse(options.connect, options.tls)
    who = f"{options.role} {options.name} of run {options.run}"
    try:
        with Bus.connect(endpoint, "control", options.patience) as bus:
            if options.role == "router" or bus.living(key):
                return _tell(f"{who} lives.", DONE)
            waiting = options.role != "learner" and not bus.living(keys.LIVE.pattern(options.run, role="learner"))
    except CredentialsError:
        raise
    except EndpointError as error:
        return _tell(f"{who}: {error}", DONE if options.blame else FAILED)
    if options.blame and waiting:
        return _tell(f"no learner of run {options.run} lives, for which {who} waits.", DONE)
    return _tell(f"{who} shows no sign of life at {endpoint}.", FAILED)


def _tell(text: str, code: int) -> int:
    sys.stdout.write(text + "\n")
    return code
