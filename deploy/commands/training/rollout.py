"""`eia-sec rollout`: one rollout worker, which may join or leave a run at any time."""

import os
import socket
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from eia_sec.common.config.checks import within
from eia_sec.common.errors import UsageError
from eia_sec.common.names import check_name
from eia_sec.common.transport.endpoint import DEFAULT, Endpoint
from eia_sec.deploy.options import parse
from eia_sec.rollout.worker.service import WorkerOptions, serve


@dataclass(frozen=True)
class RolloutArguments:
    """Start one rollout worker; it takes the configuration from the learner."""

    run: str = "farm"
    """Name of the run."""
    connect: str = DEFAULT
    """Endpoint where the learner or a router listens."""
    name: str | None = None
    """Name of the worker, unique in the run. Default: the certificate's name, else host name and process id."""
    tls: Path | None = None
    """Folder with the worker's certificate (`eia-sec keys issue rollout NAME`); turns TLS on."""
    shared_memory: bool = False
    """Send transitions through shared memory if the learner (and the router) is on this machine and does the same."""
    patience: float = 60.0
    """Seconds to wait for a listener at the endpoint."""
    env: str | None = None
    """Environment other than the farm, module:name, that this worker may load; the run must use it."""
    history: Path | None = None
    """File for the worker's history of its chunks, which eia-sec audit reads."""


def command(arguments: Sequence[str]) -> int:
    """Run the worker until the run finishes or a signal arrives; return 0."""
    options = parse(RolloutArguments, arguments, "rollout")
    within(0.0, 1e9, patience=options.patience)
    endpoint = Endpoint.parse(options.connect, options.tls, shared_memory=options.shared_memory)
    name = options.name or f"{socket.gethostname()[:40]}-{os.getpid()}"
    if endpoint.credentials is not None:
        name = options.name or endpoint.credentials.identity.name
        endpoint.credentials.require("rollout", name)
    if options.history is not None and options.history.exists() and not options.history.is_file():
        raise UsageError(f"--history {options.history} is no file; name the file that the history goes to.")
    check_name(options.run, "run")
    check_name(name, "name")
    serve(WorkerOptions(options.run, name, endpoint, options.patience, options.env, options.history))
    return 0
