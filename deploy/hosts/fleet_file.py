"""A fleet file: the hosts of a run, who does what on which, and how they meet; `deploy/fleet.toml` explains.

    fleet = read(Path("fleet.toml"))
    fleet.hosts["farm-2"].workers

Everything is checked when it is read, so that no fleet is started halfway.
"""

import dataclasses
import itertools
import re
import shlex
import tomllib
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import UnionType
from typing import Any, Final, Literal, TypeVar, get_args, get_origin, get_type_hints

from eia_sec.common.config import RunConfig
from eia_sec.common.config.environment import FARM
from eia_sec.common.config.population import MOST_MEMBERS
from eia_sec.common.errors import ConfigError, UsageError
from eia_sec.common.farm import farm_environment, farm_of
from eia_sec.common.names import check_name
from eia_sec.common.protocol.message_sizes import require_frames
from eia_sec.common.regular_files import read_regular_text
from eia_sec.common.transport.endpoint import DEFAULT, Endpoint
from eia_sec.deploy.local.learners import require_learners
from eia_sec.deploy.local.members import FOLDER, member_config, require_population
from eia_sec.deploy.options import base_configuration, with_settings

LOCAL: Final = "local"
"""The name of this machine as a host; it is reached without SSH."""
MAX_WORKERS: Final = 1024
"""Most workers of one host."""

_DESTINATION: Final = re.compile(r"[A-Za-z0-9_\[][A-Za-z0-9_.@:%\[\]\-]*")
_IMAGE: Final = re.compile(r"[A-Za-z0-9][A-Za-z0-9._:/@\-]{0,254}")
_MEMBER: Final = re.compile(r"member-(0|[1-9]|[1-5][0-9]|6[0-3])")
_QUANTITY: Final = re.compile(r"[0-9]{1,15}(\.[0-9]{1,3})?([kMGTPE]|[KMGTPE]i)?")
_SUBDOMAIN: Final = re.compile(r"([a-z0-9]([a-z0-9.\-]{0,251}[a-z0-9])?)?")
_PROGRAM: Final = re.compile(r"[/A-Za-z0-9_.].*")
_NAMES: Final = {str: "a text in quotes", int: "a whole number", bool: "true or false"}

T = TypeVar("T")


@dataclass(frozen=True)
class Training:
    """The learner's configuration."""

    preset: str = ""
    """The preset that other values override. Default: `inertial` for the farm, `generic` for other environments."""
    config: str = ""
    """TOML file whose values override the preset's; relative to the fleet file, like every path here."""
    farm_file: str = ""
    """CSV or GeoJSON file with the sensor positions."""
    set: tuple[str, ...] = ()
    """Single values that override everything else, for example "episodes = 400"."""


@dataclass(frozen=True)
class Network:
    """How the processes reach one another."""

    endpoint: str = DEFAULT
    """Where other processes reach the router, or the learner if there is no router."""
    listen: str = ""
    """Where that process listens. Default: all addresses of its host, or loopback if the endpoint is, at the
    endpoint's port."""
    keys: str = ""
    """Folder of `eia-sec keys`; turns TLS on."""
    names: tuple[str, ...] = ()
    """More names and addresses of the listener, for its certificate."""
    insecure: bool = False
    """Listen on an address that other machines reach, without authentication."""
    shared_memory: bool = False
    """Workers on the learner's host (and the router's) send transitions through shared memory."""


@dataclass(frozen=True)
class Router:
    """The router; without this table, the learner listens itself."""

    host: str = ""
    """Name of its host."""
    name: str = "main"
    """Its name, which its certificate carries."""


@dataclass(frozen=True)
class Site:
    """A router for the hosts of one place, linked to the main one."""

    host: str = ""
    """Name of its host."""
    endpoint: str = ""
    """Where the hosts of the site reach it."""
    listen: str = ""
    """Where it listens. Default: as for the network."""
    names: tuple[str, ...] = ()
    """More names and addresses of it, for its certificate."""


W = TypeVar("W", Network, Site)
"""Tables of a process that others connect to."""


@dataclass(frozen=True)
class LearnerSpec:
    """The learner."""

    host: str = ""
    """Name of its host."""
    gpus: int = 0
    """GPUs that its container requests; training.set chooses them, with learner.device = "cuda"."""
    learners: int = 1
    """Learner processes on its host that make the updates together (on policy)."""


@dataclass(frozen=True)
class Coordinator:
    """The elite coordinator."""

    host: str = ""
    """Name of its host. Default: the learner's."""
    name: str = "coordinator"
    """Its name."""


@dataclass(frozen=True)
class Host:
    """One host."""

    host: str = ""
    """"local" for this machine, else the destination for `ssh`: HOST or USER@HOST. Default: the table's name."""
    ssh: tuple[str, ...] = ()
    """Options for `ssh`, for example ["-p", "2222"]."""
    folder: str = ""
    """Folder on that host, relative to its home directory (locally: to this file). Default: runs/RUN/NAME."""
    command: str = "eia-sec"
    """The command that runs eia-sec there, for example ".venv/bin/eia-sec"."""
    start: Literal["detached", "systemd"] = "detached"
    """detached: a separate session; systemd: a transient user unit (needs lingering)."""
    workers: int = 0
    """Number of rollout workers."""
    member: str = ""
    """Member of the population that they serve. Default: those whose learners run on this host, in turn."""
    site: str = ""
    """Site whose router its workers connect to. Default: the main router."""

    @property
    def words(self) -> list[str]:
        """Return the command's words by the shell's rules; raise ValueError for an unclosed quote."""
        return shlex.split(self.command)


@dataclass(frozen=True)
class Containers:
    """What only Compose and Kubernetes need."""

    image: str = "eia-sec:latest"
    """The image, built from Dockerfile."""
    storage: str = "10Gi"
    """Size of the learner's volume."""
    storage_class: str = ""
    """Storage class of that volume. Default: the cluster's."""


@dataclass(frozen=True)
class FleetRun:
    """A run of a fleet: its only one, or that of a member of its population.

    Attributes:
        name: the run's name.
        learner: its learner's table.
        config: its configuration.
        member: the member's name; empty for the only run.
    """

    name: str
    learner: LearnerSpec
    config: RunConfig
    member: str = ""

    @property
    def folder(self) -> str:
        """Its folder inside a host's folder of runs; empty for that folder itself."""
        return f"{FOLDER}/{self.member}" if self.member else ""

    @property
    def process(self) -> str:
        """The name of its learner among a fleet's processes."""
        return self.member or "learner"


@dataclass(frozen=True)
class FleetSpec:
    """A fleet: the hosts of a run or of a population, and the processes on each.

    Attributes:
        path: the file.
        config: the configuration, resolved from the training table; members of a population have it but for seeds and
            hyperparameters.
        runs: the run, or those of the members of the population.
    """

    run: str = "farm"
    training: Training = field(default_factory=Training)
    network: Network = field(default_factory=Network)
    router: Router | None = None
    sites: dict[str, Site] = field(default_factory=dict)
    learner: LearnerSpec = field(default_factory=LearnerSpec)
    population: dict[str, LearnerSpec] = field(default_factory=dict)
    coordinator: Coordinator = field(default_factory=Coordinator)
    hosts: dict[str, Host] = field(default_factory=dict)
    containers: Containers = field(default_factory=Containers)
    path: Path = field(default_factory=Path)
    config: RunConfig = field(default_factory=RunConfig)
    runs: tuple[FleetRun, ...] = ()

    def served(self, host: str, index: int) -> FleetRun:
        """Return the run that a host's worker of this number serves."""
        member = self.hosts[host].member
        found = [run for run in self.runs if (run.member == member if member else run.learner.host == host)]
        return found[index % len(found)] if self.population else self.runs[0]

    @property
    def folder(self) -> Path:
        """Return the folder to which paths in the file are relative."""
        return self.path.resolve().parent

    @property
    def keys(self) -> Path | None:
        """Return the authority's folder, or None without TLS."""
        return self.folder / self.network.keys if self.network.keys else None

    @property
    def listener(self) -> tuple[str, str]:
        """Return role and name of the process that listens."""
        return ("learner", "learner") if self.router is None else ("router", self.router.name)


def read(path: Path) -> FleetSpec:
    """Read a fleet file.

    Raises:
        ConfigError: the file cannot be read, is not TOML, or has an impossible value; the message names the key.
    """
    try:
        table = tomllib.loads(read_regular_text(path))
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is not UTF-8 text"
        raise ConfigError(f"the fleet file {path} cannot be read: {reason}.") from error
    except (ValueError, RecursionError) as error:
        raise ConfigError(f"{path} is not valid TOML: {str(error).lower().rstrip('.')}.") from error
    try:
        fleet = _complete(replace(_table(FleetSpec, table, ""), path=path))
        config = _configuration(fleet)
        return replace(fleet, config=config, runs=_runs(fleet, config))
    except UsageError as error:
        raise ConfigError(f"{path}: {error}") from error


def _table(kind: type[T], table: dict[str, Any], place: str) -> T:
    """Return a dataclass from a table of the file, each value checked against its field's type."""
    hints = get_type_hints(kind)
    inner = {"path", "config", "runs"} if kind is FleetSpec else set()
    known = [f.name for f in dataclasses.fields(kind) if f.name not in inner]  # type: ignore[arg-type]  # T is one of ours
    where = f"in [{place}]" if place else "at the top"
    for key in table:
        if key not in known:
            raise ConfigError(f"unknown key {key!r} {where}; the keys are {', '.join(known)}.")
    return kind(**{key: _value(hints[key], value, f"{place}.{key}".lstrip(".")) for key, value in table.items()})


def _value(wanted: Any, value: Any, place: str) -> Any:
    if get_origin(wanted) is UnionType:
        wanted = get_args(wanted)[0]
    if get_origin(wanted) is Literal:
        choices = get_args(wanted)
        if value not in choices:
            raise ConfigError(f"{place} must be {' or '.join(map(repr, choices))}, not {value!r}.")
        return value
    if dataclasses.is_dataclass(wanted) or get_origin(wanted) is dict:
        if not isinstance(value, dict):
            raise ConfigError(f"{place} must be a section [{place}].")
        if get_origin(wanted) is dict:
            kind = get_args(wanted)[1]
            return {name: _value(kind, inner, f"{place}.{check_name(name, place)}") for name, inner in value.items()}
        return _table(wanted, value, place)
    if get_origin(wanted) is tuple:
        if not isinstance(value, list) or any(type(item) is not str for item in value):
            raise ConfigError(f"{place} must be a list of texts in quotes.")
        return tuple(_printable(item, place) for item in value)
    if type(value) is not wanted:
        raise ConfigError(f"{place} must be {_NAMES[wanted]}, not {value!r}.")
    return _printable(value, place) if wanted is str else value


def _printable(text: str, place: str) -> str:
    """Return a text that may become a word of a unit file, a manifest or a command line."""
    if not text.isprintable():
        raise ConfigError(f"{place} {text[:80]!r} holds a line end or another control character.")
    return text


def _complete(fleet: FleetSpec) -> FleetSpec:
    """Check what concerns several tables, and return the fleet with defaults that depend on other values."""
    check_name(fleet.run, "run")
    if not fleet.hosts:
        raise ConfigError("the file has no host; write a section [hosts.NAME] for each.")
    learners = {f"population.{name}": learner for name, learner in fleet.population.items()}
    learners = learners or {"learner": fleet.learner}
    near = next(iter(learners.values())).host
    placed: dict[str, str | None] = {"router.host": fleet.router.host if fleet.router else None}
    placed |= {f"sites.{name}.host": site.host for name, site in fleet.sites.items()}
    placed |= {f"{place}.host": learner.host for place, learner in learners.items()}
    for place, name in (placed | {"coordinator.host": fleet.coordinator.host or near}).items():
        if name is not None and name not in fleet.hosts:
            raise ConfigError(f"{place} must be one of the hosts {', '.join(fleet.hosts)}, not {name!r}.")
    for name in (fleet.router.name if fleet.router else "main", fleet.coordinator.name):
        check_name(name, "name")
    for place, learner in learners.items():
        if not 0 <= learner.gpus <= 64:
            raise ConfigError(f"{place}.gpus must be 0 to 64, not {learner.gpus}.")
    _check_members(fleet)
    _check_sites(fleet)
    _check_containers(fleet.containers)
    hosts = {name: _host(fleet.run, name, host) for name, host in fleet.hosts.items()}
    where = [(host.host, host.folder) for host in hosts.values()]
    if len(set(where)) < len(where):
        raise ConfigError("two hosts use the same folder on the same machine; give each its own.")
    coordinator = replace(fleet.coordinator, host=fleet.coordinator.host or near)
    network = _met(fleet.network, fleet.network, "network")
    sites = {name: _met(site, fleet.network, f"sites.{name}") for name, site in fleet.sites.items()}
    return replace(fleet, hosts=hosts, coordinator=coordinator, network=network, sites=sites)


def _check_members(fleet: FleetSpec) -> None:
    """Check what a population adds: its members' names, and whom the workers of each host serve."""
    for name, host in fleet.hosts.items():
        if host.member and host.member not in fleet.population:
            named = ", ".join(fleet.population) or "none"
            raise ConfigError(f"hosts.{name}.member must be a member of the population ({named}), not {host.member!r}.")
    if not fleet.population:
        return
    if fleet.learner != LearnerSpec():
        raise ConfigError("a population has a table [population.member-N] for each learner; remove [learner].")
    if fleet.router is None:
        raise ConfigError("the members of a population meet at a router; add [router].")
    for name in fleet.population:
        if not _MEMBER.fullmatch(name):
            raise ConfigError(f"population.{name} must be named member-N, with N from 0 to {MOST_MEMBERS - 1}.")
        check_name(f"{fleet.run}-{name}", "run")
    led = {learner.host for learner in fleet.population.values()}
    for name, host in fleet.hosts.items():
        if host.workers and not host.member and name not in led:
            raise ConfigError(
                f"hosts.{name} has workers and no learner of the population; hosts.{name}.member says whom they serve."
            )


def _check_sites(fleet: FleetSpec) -> None:
    """Check what sites add: a main router to be linked to, and to which of them each host belongs."""
    if fleet.sites and fleet.router is None:
        raise ConfigError("the routers of sites are linked to the main one; add [router].")
    for name, site in fleet.sites.items():
        if not site.endpoint:
            raise ConfigError(f"sites.{name}.endpoint must say where the hosts of the site reach its router.")
        if site.endpoint == fleet.network.endpoint:
            raise ConfigError(f"sites.{name}.endpoint is that of the main router; a site's router has one of its own.")
    routers = {"router": (fleet.router.host, fleet.network.endpoint)} if fleet.router is not None else {}
    routers |= {f"sites.{name}": (site.host, site.endpoint) for name, site in fleet.sites.items()}
    for (one, (at, met)), (other, (beside, second)) in itertools.combinations(routers.items(), 2):
        if at == beside and abs(_parsed(met).port - _parsed(second).port) < 2:
            raise ConfigError(f"{one} and {other} are on one host, and each takes two ports: its own and the next.")
    for name, host in fleet.hosts.items():
        if host.site and host.site not in fleet.sites:
            named = ", ".join(fleet.sites) or "none"
            raise ConfigError(f"hosts.{name}.site must be one of the sites ({named}), not {host.site!r}.")


def _parsed(endpoint: str) -> Endpoint:
    """Return an endpoint without regard to TLS, which would need a certificate here."""
    return Endpoint.parse(re.sub(r"^tls/", "tcp/", endpoint))


def _runs(fleet: FleetSpec, config: RunConfig) -> tuple[FleetRun, ...]:
    """Return the runs with their configurations; raise ConfigError where they cannot be."""
    for learner in fleet.population.values() or [fleet.learner]:
        require_learners(config, learner.learners, lockstep=False)
    if not fleet.population:
        if config.population.members:
            raise ConfigError("population.members is set, and no table [population.member-0] says where it learns.")
        return (FleetRun(fleet.run, fleet.learner, config),)
    require_population(config)
    runs = []
    for name, learner in fleet.population.items():
        number = int(name.removeprefix("member-"))
        if number >= config.population.members:
            raise ConfigError(
                f"population.{name} needs population.members of {max(2, number + 1)} or more in training.set, "
                f"not {config.population.members}."
            )
        runs.append(FleetRun(f"{fleet.run}-{name}", learner, member_config(config, number), name))
    return tuple(runs)


def _host(run: str, name: str, host: Host) -> Host:
    host = replace(host, host=host.host or name, folder=host.folder or f"runs/{run}/{name}")
    if not _DESTINATION.fullmatch(host.host):
        raise ConfigError(f"hosts.{name}.host {host.host!r} must be {LOCAL!r}, HOST or USER@HOST.")
    if not 0 <= host.workers <= MAX_WORKERS:
        raise ConfigError(f"hosts.{name}.workers must be 0 to {MAX_WORKERS}, not {host.workers}.")
    try:
        empty = not host.words
    except ValueError as error:
        raise ConfigError(f"hosts.{name}.command {host.command!r} has an unclosed quote.") from error
    if empty:
        raise ConfigError(f"hosts.{name}.command is empty.")
    if not _PROGRAM.fullmatch(host.words[0]):
        raise ConfigError(f"hosts.{name}.command {host.command!r} does not begin with a program's name or path.")
    return host


def _check_containers(containers: Containers) -> None:
    """Raise ConfigError for what Compose and Kubernetes would not take, or would take for something else."""
    checks = (("image", _IMAGE, "ghcr.io/me/eia-sec:1"), ("storage", _QUANTITY, "10Gi"))
    for name, form, example in (*checks, ("storage_class", _SUBDOMAIN, "fast-ssd")):
        value = getattr(containers, name)
        if not form.fullmatch(value):
            raise ConfigError(f"containers.{name} {value[:80]!r} is not of the form of {example}.")


def _met(where: W, network: Network, place: str) -> W:
    """Return a table with the protocol and the listening address of its listener, which must not let strangers in."""
    protocol = "tls" if network.keys else "tcp"
    if where.endpoint.startswith("tls/") and not network.keys:
        raise ConfigError(f"{place}.endpoint needs TLS; set network.keys to the folder of `eia-sec keys`.")
    met = _parsed(where.endpoint)
    everywhere = "[::]" if met.host.startswith("[") else "0.0.0.0"
    default = str(met) if met.is_loopback else f"tcp/{everywhere}:{met.port}"
    listens = _parsed(where.listen or default)
    if not network.keys and not (listens.is_loopback or network.insecure):
        raise ConfigError(
            f"listening on {listens} would let anybody who reaches it join the run; set network.keys to the folder "
            "of `eia-sec keys`, or set insecure = true if that is intended."
        )
    return replace(
        where, endpoint=str(replace(met, protocol=protocol)), listen=str(replace(listens, protocol=protocol))
    )


def _configuration(fleet: FleetSpec) -> RunConfig:
    training = fleet.training
    arguments = ["--preset", training.preset] if training.preset else []
    arguments += ["--config", str(fleet.folder / training.config)] if training.config else []
    arguments += ["--farm-file", str(fleet.folder / training.farm_file)] if training.farm_file else []
    config = with_settings(base_configuration(arguments), training.set)
    if not training.preset and config.env.name != FARM:  # the name may stand in `set`, which no preset knows
        config = with_settings(base_configuration([*arguments, "--env", config.env.name]), training.set)
    farm = farm_of(config)
    if farm is not None:  # another environment may exist on the learner's host only, where it is checked
        require_frames(config, farm_environment(farm))
    return config
