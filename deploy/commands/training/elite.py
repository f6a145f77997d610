"""`eia-sec elite`: the elite coordinator."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from eia_sec.common.config.checks import within
from eia_sec.common.names import check_name
from eia_sec.common.transport.endpoint import DEFAULT, Endpoint
from eia_sec.deploy.options import parse
from eia_sec.elite.service import CoordinatorOptions, serve


@dataclass(frozen=True)
class EliteArguments:
    """Start the elite coordinator; it takes the configuration from the learner."""

    run: str = "farm"
    """Name of the run."""
    connect: str = DEFAULT
    """Endpoint where the learner or a router listens."""
    name: str = "coordinator"
    """Name of the coordinator."""
    tls: Path | None = None
    """Folder with the coordinator's certificate (`eia-sec keys issue elite NAME`); turns TLS on."""
    patience: float = 60.0
    """Seconds to wait for a listener at the endpoint."""


def command(arguments: Sequence[str]) -> int:
    """Run the coordinator until the run finishes or a signal arrives; return 0."""
    options = parse(EliteArguments, arguments, "elite")
    within(0.0, 1e9, patience=options.patience)
    check_name(options.run, "run")
    check_name(options.name, "name")
    endpoint = Endpoint.parse(options.connect, options.tls)
    if endpoint.credentials is not None:
        endpoint.credentials.require("elite", options.name)
    serve(CoordinatorOptions(options.run, endpoint, options.name, options.patience))
    return 0
