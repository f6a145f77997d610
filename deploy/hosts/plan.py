"""The processes of a fleet with their command lines; every way of starting them uses these."""

from dataclasses import dataclass, replace
from typing import Final

from eia_sec.common.transport.credentials import Identity
from eia_sec.deploy.hosts.fleet_file import FleetRun, FleetSpec
from eia_sec.deploy.local.code_options import env_options, plugin_options
from eia_sec.deploy.local.run_directory import HISTORY

PATIENCE: Final = "86400"
"""Seconds that processes wait for the listener: hosts start in any order, some much later."""
ORDER: Final = ("rollout", "elite", "learner", "site", "router")
"""Roles in the order in which they stop: workers first, so that they deliver their last chunks."""

SHARING: Final = "--shared-memory"
"""Option of processes that share transitions through memory."""


@dataclass(frozen=True)
class Process:
    """One process.

    Attributes:
        role: router, site, learner, elite or rollout.
        name: its name inside the role; a learner's is that of its member in a population.
        host: its host's name in the fleet file.
        arguments: what follows `eia-sec`.
        threads: its share of compute threads.
        run: the run that it works for; None for the router and the coordinator, which serve all.
    """

    role: str
    name: str
    host: str
    arguments: tuple[str, ...]
    threads: int = 1
    run: FleetRun | None = None

    @property
    def label(self) -> str:
        """Its name among all processes of the fleet."""
        return f"{self.role}.{self.name}"

    @property
    def identity(self) -> Identity:
        """What its certificate carries: role and name. A learner's name in its run is always `learner`."""
        return Identity(self.role, "learner" if self.role == "learner" else self.name)


@dataclass(frozen=True)
class Places:
    """Paths and endpoints as a process sees them.

    Attributes:
        run_dir: folder of the run: checkpoints, metrics and histories.
        keys: folder of the process's certificate; "{identity}" stands for role and name.
        config: file with the learner's configuration.
        endpoint: where other processes reach the listener.
        listen: where the listener listens.
        begins: whether the learner may begin the run where its folder holds none; else it refuses to start there.
    """

    run_dir: str
    keys: str
    config: str
    endpoint: str
    listen: str
    begins: bool = True

    def of(self, run: FleetRun) -> "Places":
        """Return the paths of one run, each member of a population having a folder and a configuration of its own."""
        if not run.member:
            return self
        config = f"{self.config.removesuffix('.toml')}-{run.member}.toml"
        return replace(self, run_dir=f"{self.run_dir}/{run.folder}", config=config)


def here(fleet: FleetSpec) -> Places:
    """Return the paths relative to a host's folder, where `eia-sec up` puts the files."""
    return Places("run", "keys/{identity}", "config.toml", fleet.network.endpoint, fleet.network.listen)


def processes(fleet: FleetSpec, places: Places) -> list[Process]:
    """Return every process of a fleet: routers, learner, coordinator, then workers."""
    found = []
    if fleet.router is not None:
        who = Identity("router", fleet.router.name)
        found.append(Process("router", who.name, fleet.router.host, _router(fleet, places, who, places.listen)))
    for name, site in fleet.sites.items():
        arguments = _router(fleet, places, Identity("site", name), site.listen, "--connect", places.endpoint)
        found.append(Process("site", name, site.host, arguments))
    found += [_learner(fleet, places.of(run), run) for run in fleet.runs]
    coordinator = fleet.coordinator
    runs: tuple[str, ...] = ("--run", fleet.run, "--connect", places.endpoint)
    if fleet.population:
        runs = ("--members", *(f"{run.name}={places.endpoint}" for run in fleet.runs))
    joining = _joining(fleet, places, runs, Identity("elite", coordinator.name))
    found.append(Process("elite", coordinator.name, coordinator.host, ("elite", *joining)))
    for host, described in fleet.hosts.items():
        for index in range(described.workers):
            found.append(worker(fleet, places, fleet.served(host, index), host, f"{host}-{index}"))
    return found


def worker(fleet: FleetSpec, places: Places, run: FleetRun, host: str, name: str) -> Process:
    """Return one worker of a run."""
    config, site = run.config, fleet.hosts[host].site
    endpoint = fleet.sites[site].endpoint if site else places.endpoint
    joining = _joining(fleet, places, ("--run", run.name, "--connect", endpoint), Identity("rollout", name))
    history = ("--history", f"{places.of(run).run_dir}/{HISTORY}/rollout-{name}.jsonl")
    return Process(
        "rollout",
        name,
        host,
        ("rollout", *joining, *_shared(fleet), *history, *env_options(config)),
        config.rollout.threads,
        run,
    )


def _router(fleet: FleetSpec, places: Places, who: Identity, listen: str, *linked: str) -> tuple[str, ...]:
    where = ("router", "--listen", listen, *linked)
    return (*where, *_shared(fleet), *_insecure(fleet), *_tls(fleet, places, who))


def _learner(fleet: FleetSpec, places: Places, run: FleetRun) -> Process:
    if fleet.router is None:
        met: tuple[str, ...] = ("--listen", places.listen, *_insecure(fleet))
    else:
        met = ("--connect", places.endpoint, "--patience", PATIENCE)
    trained = ("--config", places.config)
    resumed = "--resume-if-any" if places.begins else "--resume"
    kept = ("--run-dir", places.run_dir, *trained, resumed, "--await-elite")
    tls = _tls(fleet, places, Identity("learner", "learner"))
    several = () if run.learner.learners == 1 else ("--learners", str(run.learner.learners))
    named = plugin_options(run.config)
    arguments = ("learner", *named, "--run", run.name, *met, *_shared(fleet), *kept, *several, *tls)
    return Process("learner", run.process, run.learner.host, arguments, run.config.learner.threads, run)


def _joining(fleet: FleetSpec, places: Places, runs: tuple[str, ...], who: Identity) -> tuple[str, ...]:
    where = (*plugin_options(fleet.config), *runs, "--name", who.name)
    return (*where, "--patience", PATIENCE, *_tls(fleet, places, who))


def _tls(fleet: FleetSpec, places: Places, who: Identity) -> tuple[str, ...]:
    return () if fleet.keys is None else ("--tls", places.keys.format(identity=who))


def _shared(fleet: FleetSpec) -> tuple[str, ...]:
    return (SHARING,) if fleet.network.shared_memory else ()


def _insecure(fleet: FleetSpec) -> tuple[str, ...]:
    return ("--insecure",) if fleet.network.insecure and fleet.keys is None else ()
