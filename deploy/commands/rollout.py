"""`eia-sec rollout`: one worker, which may join or leave a run at any time."""

import os
import socket
from collections.abc import Sequence
from dataclasses import dataclass

from common.endpoint import DEFAULT, Endpoint
from common.keys import check_name
from deploy.options import parse
from rollout.service import WorkerOptions, serve


@dataclass(frozen=True)
class RolloutArguments:
    """Start one rollout worker; the learner tells it the configuration."""

    run: str = "farm"
    """Name of the run."""
    connect: str = DEFAULT
    """Endpoint where the learner or a router listens."""
    name: str | None = None
    """Name of the worker, unique in the run. Default: host name and process number."""
    patience: float = 60.0
    """Seconds to wait for somebody to listen at the endpoint."""


def command(arguments: Sequence[str]) -> int:
    """Run the worker until the run is finished or a signal comes; return 0."""
    options = parse(RolloutArguments, arguments, "rollout")
    name = options.name or f"{socket.gethostname()[:40]}-{os.getpid()}"
    check_name(options.run, "run")
    check_name(name, "name")
    serve(WorkerOptions(options.run, name, Endpoint.parse(options.connect), options.patience))
    return 0
