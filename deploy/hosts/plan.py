"""The processes of a fleet with their command lines; every way of starting them uses these."""

from dataclasses import dataclass
from typing import Final

from eia_sec.common.transport.credentials import Identity
from eia_sec.deploy.hosts.fleet_file import FleetSpec
from eia_sec.deploy.local.code_options import env_options, plugin_options
from eia_sec.deploy.local.run_directory import HISTORY

PATIENCE: Final = "86400"
"""Seconds that processes wait for the listener: hosts start in any order, some much later."""
ORDER: Final = ("rollout", "elite", "learner", "router")
"""Roles in the order in which they stop: workers first, so that they deliver their last chunks."""

SHARING: Final = "--shared-memory"
"""Option of processes that share transitions through memory."""


@dataclass(frozen=True)
class Process:
    """One process.

    Attributes:
        role: router, learner, elite or rollout.
        name: its name inside the role.
        host: its host's name in the fleet file.
        arguments: what follows `eia-sec`.
        threads: its share of compute threads.
    """

    role: str
    name: str
    host: str
    arguments: tuple[str, ...]
    threads: int = 1

    @property
    def identity(self) -> Identity:
        """Return role and name, which its certificate carries, too."""
        return Identity(self.role, self.name)


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


def here(fleet: FleetSpec) -> Places:
    """Return the paths relative to a host's folder, where `eia-sec up` puts the files."""
    return Places("run", "keys/{identity}", "config.toml", fleet.network.endpoint, fleet.network.listen)


def processes(fleet: FleetSpec, places: Places) -> list[Process]:
    """Return every process of a fleet: router, learner, coordinator, then workers."""
    found = []
    if fleet.router is not None:
        router = Identity("router", fleet.router.name)
        arguments = (
            "router",
            "--listen",
            places.listen,
            *_shared(fleet),
            *_insecure(fleet),
            *_tls(fleet, places, router),
        )
        found.append(Process("router", fleet.router.name, fleet.router.host, arguments))
    found.append(_learner(fleet, places))
    coordinator = fleet.coordinator
    joining = _joining(fleet, places, Identity("elite", coordinator.name))
    found.append(Process("elite", coordinator.name, coordinator.host, ("elite", *joining)))
    for host, described in fleet.hosts.items():
        found += [worker(fleet, places, host, f"{host}-{index}") for index in range(described.workers)]
    return found


def worker(fleet: FleetSpec, places: Places, host: str, name: str) -> Process:
    """Return one worker."""
    config = fleet.config
    joining = _joining(fleet, places, Identity("rollout", name))
    history = ("--history", f"{places.run_dir}/{HISTORY}/rollout-{name}.jsonl")
    return Process(
        "rollout",
        name,
        host,
        ("rollout", *joining, *_shared(fleet), *history, *env_options(config)),
        config.rollout.threads,
    )


def _learner(fleet: FleetSpec, places: Places) -> Process:
    if fleet.router is None:
        met: tuple[str, ...] = ("--listen", places.listen, *_insecure(fleet))
    else:
        met = ("--connect", places.endpoint, "--patience", PATIENCE)
    trained = ("--config", places.config)
    resumed = "--resume-if-any" if places.begins else "--resume"
    kept = ("--run-dir", places.run_dir, *trained, resumed, "--await-elite")
    tls = _tls(fleet, places, Identity("learner", "learner"))
    several = () if fleet.learner.learners == 1 else ("--learners", str(fleet.learner.learners))
    named = plugin_options(fleet.config)
    arguments = ("learner", *named, "--run", fleet.run, *met, *_shared(fleet), *kept, *several, *tls)
    return Process("learner", "learner", fleet.learner.host, arguments, fleet.config.learner.threads)


def _joining(fleet: FleetSpec, places: Places, who: Identity) -> tuple[str, ...]:
    where = (*plugin_options(fleet.config), "--run", fleet.run, "--connect", places.endpoint, "--name", who.name)
    return (*where, "--patience", PATIENCE, *_tls(fleet, places, who))


def _tls(fleet: FleetSpec, places: Places, who: Identity) -> tuple[str, ...]:
    return () if fleet.keys is None else ("--tls", places.keys.format(identity=who))


def _shared(fleet: FleetSpec) -> tuple[str, ...]:
    return (SHARING,) if fleet.network.shared_memory else ()


def _insecure(fleet: FleetSpec) -> tuple[str, ...]:
    return ("--insecure",) if fleet.network.insecure and fleet.keys is None else ()
