"""`eia-sec elite`: the elite coordinator."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path

from eia_sec.common.config.checks import within
from eia_sec.common.errors import UsageError
from eia_sec.common.names import check_name
from eia_sec.common.transport.endpoint import DEFAULT, Endpoint
from eia_sec.deploy.options import parse
from eia_sec.elite import population
from eia_sec.elite.service import CoordinatorOptions, serve


@dataclass(frozen=True)
class EliteArguments:
    """Start the elite coordinator of a run or of a population; it takes the configuration from the learners."""

    run: str = "farm"
    """Name of the run."""
    connect: str = DEFAULT
    """Endpoint where the learner or a router listens."""
    name: str = "coordinator"
    """Name of the coordinator."""
    members: tuple[str, ...] = ()
    """Runs of a population, each as RUN=ENDPOINT; in place of --run and --connect."""
    tls: Path | None = None
    """Folder with the coordinator's certificate (`eia-sec keys issue elite NAME`); turns TLS on."""
    patience: float = 60.0
    """Seconds to wait for a listener at the endpoint, of a population's for the first one."""


def command(arguments: Sequence[str]) -> int:
    """Run the coordinator until the run finishes or a signal arrives; return 0."""
    options = parse(EliteArguments, arguments, "elite")
    within(0.0, 1e9, patience=options.patience)
    check_name(options.run, "run")
    check_name(options.name, "name")
    named = {word.partition("=")[0] for word in arguments if word.startswith("--")}
    if "--members" in named:
        population.serve(_members(options, named))
    else:
        serve(CoordinatorOptions(options.run, _endpoint(options, options.connect), options.name, options.patience))
    return 0


def _members(options: EliteArguments, named: Collection[str]) -> list[CoordinatorOptions]:
    """Return how to reach the members of a population; raise UsageError for what a command line cannot mean."""
    for other in ("--run", "--connect"):
        if other in named:
            raise UsageError(f"--members names runs and where they listen; leave {other} out.")
    if not options.members:
        raise UsageError("--members needs the members, each as RUN=ENDPOINT.")
    members = [_member(options, text) for text in options.members]
    names = [member.run for member in members]
    if twice := [name for name in names if names.count(name) > 1]:
        raise UsageError(f"--members names {twice[0]} more than once.")
    return members


def _member(options: EliteArguments, text: str) -> CoordinatorOptions:
    """Return how to reach a member of a population that a command line names."""
    name, equals, where = text.partition("=")
    if not equals:
        raise UsageError(f"--members takes RUN=ENDPOINT, member-0=tcp/127.0.0.1:7447 for instance, not {text!r}.")
    check_name(name, "run")
    return CoordinatorOptions(name, _endpoint(options, where), options.name, options.patience)


def _endpoint(options: EliteArguments, where: str) -> Endpoint:
    endpoint = Endpoint.parse(where, options.tls)
    if endpoint.credentials is not None:
        endpoint.credentials.require("elite", options.name)
    return endpoint
