"""`eia-sec rollout`: one worker, which may join or leave a run at any time."""

import os
import socket
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from common.names import check_name
from common.transport.endpoint import DEFAULT, Endpoint
from deploy.options import parse
from rollout.worker.service import WorkerOptions, serve


@dataclass(frozen=True)
class RolloutArguments:
    """Start one rollout worker; the learner tells it the configuration."""

    run: str = "farm"
    """Name of the run."""
    connect: str = DEFAULT
    """Endpoint where the learner or a router listens."""
    name: str | None = None
    """Name of the worker, unique in the run. Default: that of the certificate, else host name and process number."""
    tls: Path | None = None
    """Folder with the worker's certificate, made by `eia-sec keys issue rollout NAME`; links are TLS then."""
    shared_memory: bool = False
    """Send transitions through this machine's memory when the learner (and the router) does so, too, and is here."""
    patience: float = 60.0
    """Seconds to wait for somebody to listen at the endpoint."""
    env: str | None = None
    """Environment besides the farm that this worker may load, module:name; the learner's run must be about it."""
    history: Path | None = None
    """File for the worker's own account of its chunks, which eia-sec audit reads."""


def command(arguments: Sequence[str]) -> int:
    """Run the worker until the run is finished or a signal comes; return 0."""
    options = parse(RolloutArguments, arguments, "rollout")
    endpoint = Endpoint.parse(options.connect, options.tls, shared_memory=options.shared_memory)
    name = options.name or f"{socket.gethostname()[:40]}-{os.getpid()}"
    if endpoint.credentials is not None:
        name = options.name or endpoint.credentials.identity.name
        endpoint.credentials.require("rollout", name)
    check_name(options.run, "run")
    check_name(name, "name")
    serve(WorkerOptions(options.run, name, endpoint, options.patience, options.env, options.history))
    return 0
