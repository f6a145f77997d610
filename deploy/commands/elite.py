"""`eia-sec elite`: the elite coordinator."""

from collections.abc import Sequence
from dataclasses import dataclass

from common.endpoint import DEFAULT, Endpoint
from common.keys import check_name
from deploy.options import parse
from elite.service import CoordinatorOptions, serve


@dataclass(frozen=True)
class EliteArguments:
    """Start the elite coordinator; the learner tells it the configuration."""

    run: str = "farm"
    """Name of the run."""
    connect: str = DEFAULT
    """Endpoint where the learner or a router listens."""
    name: str = "coordinator"
    """Name of the coordinator."""
    patience: float = 60.0
    """Seconds to wait for somebody to listen at the endpoint."""


def command(arguments: Sequence[str]) -> int:
    """Run the coordinator until the run is finished or a signal comes; return 0."""
    options = parse(EliteArguments, arguments, "elite")
    check_name(options.run, "run")
    check_name(options.name, "name")
    serve(CoordinatorOptions(options.run, Endpoint.parse(options.connect), options.name, options.patience))
    return 0
