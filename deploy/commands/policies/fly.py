"""`eia-sec fly`: a node that turns vehicles' observations into velocity set-points with trained actors."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from eia_sec.common.config import FarmConfig
from eia_sec.common.config.checks import positive, within
from eia_sec.common.config.files import from_toml
from eia_sec.common.config.presets import PRESETS
from eia_sec.common.errors import RunDirError, UsageError
from eia_sec.common.farm import farm_team, require_farm
from eia_sec.common.log import log
from eia_sec.common.names import check_name
from eia_sec.common.policy_file import load_policy
from eia_sec.common.process import StopSignal
from eia_sec.common.transport.bus import Bus
from eia_sec.common.transport.endpoint import DEFAULT, Endpoint
from eia_sec.deploy.flight.node import FlightNode, NodeOptions
from eia_sec.deploy.flight.pilot import Limits, Pilot
from eia_sec.deploy.local.run_directory import CONFIG, POLICY, RunDirectory
from eia_sec.deploy.options import parse
from eia_sec.rollout.policies import fitted
from eia_sec.rollout.shipped_policies import policy_path, preset_of


@dataclass(frozen=True)
class FlyArguments:
    """Fly vehicles with trained actors: observations in, velocity set-points out (docs/how-to/vehicles.md)."""

    policy: str | None = None
    """Policy file, "trained" for the one that ships, or "trained:battery" for that of the preset battery, for instance.
    Default: the policy of --run-dir."""
    run_dir: Path | None = None
    """Run directory: its configuration, and its policy unless --policy names another."""
    config: Path | None = None
    """TOML file with the farm that the policy was trained for; it determines speeds and the team."""
    run: str = "farm"
    """Name of the run that vehicles and this node share."""
    connect: str | None = None
    """Endpoint of a router or of a listening learner."""
    listen: str | None = None
    """Endpoint to listen on, if vehicles connect to this node directly. Default: tcp/127.0.0.1:7447."""
    tls: Path | None = None
    """Folder with the node's certificate (`eia-sec keys issue flight NAME --host HOST`); turns TLS on."""
    insecure: bool = False
    """Listen on an address that other machines reach, without authentication."""
    name: str = "main"
    """Name of this node."""
    vehicle: tuple[str, ...] = ()
    """Vehicles to fly as NAME=AGENT, for example uav-7=monitoring_0. Default: every agent under its own name."""
    rate: float = 10.0
    """Set-points per second for each vehicle."""
    hold: int = 1
    """Periods for which an observation stays valid; after that the vehicle gets a hover set-point."""
    max_age: float = 1.0
    """Largest difference between an observation's time stamp and this machine's clock, seconds."""
    patience: float = 10.0
    """Seconds to wait for a listener at the endpoint."""
    seconds: float | None = None
    """Seconds until it stops. Default: fly until interrupted."""


def command(arguments: Sequence[str]) -> int:
    """Fly until interrupted or the time is up; return 0."""
    options = parse(FlyArguments, arguments, "fly")
    check_name(options.run, "run")
    check_name(options.name, "name")
    within(0.1, 1000.0, rate=options.rate)
    within(1, 1000, hold=options.hold)
    positive(max_age=options.max_age)
    within(0.0, 1e9, patience=options.patience, seconds=0.0 if options.seconds is None else options.seconds)
    if options.listen and options.connect:
        raise UsageError("give --listen or --connect, not both.")
    pilot, agents = make_pilot(options)
    endpoint = Endpoint.parse(options.connect or options.listen or DEFAULT, options.tls)
    if endpoint.credentials is not None:
        endpoint.credentials.require("flight", options.name)
    stop = StopSignal()
    stop.install()
    if not options.connect:
        endpoint.require_private(options.insecure)
    with (
        Bus.connect(endpoint, "control", options.patience, lambda: not stop)
        if options.connect
        else Bus.listen(endpoint, "control")
    ) as bus:
        listens = None if options.connect else endpoint
        how = NodeOptions(options.run, options.name, options.rate, options.seconds, listens)
        node = FlightNode(how, pilot, agents, bus)
        log(f"flying {len(agents)} vehicles of run {options.run} at {options.rate:g} set-points a second.")
        node.run(stop)
    return 0


def make_pilot(options: FlyArguments) -> tuple[Pilot, tuple[str, ...]]:
    """Return the pilot and the names of the vehicles that it flies.

    Raises:
        UsageError: when policy, farm and vehicles do not fit together.
    """
    farm = farm_of(options.run_dir, options.config, preset_of(options.policy))
    name = options.policy or (str(options.run_dir / POLICY) if options.run_dir else None)
    if name is None:
        raise UsageError("nothing to fly: give --policy FILE, --policy trained or --run-dir DIR.")
    actors = fitted(load_policy(policy_path(name))[0], farm_team(farm))
    agents = vehicles_of(options.vehicle) or {agent: agent for agent in actors.team.agent_names}
    speed = farm.world.speed_x_max, farm.world.speed_y_max
    return Pilot(actors, agents, speed, Limits(options.hold, options.max_age)), tuple(agents)


def farm_of(run_dir: Path | None, config: Path | None, preset: str = "default") -> FarmConfig:
    """Return the farm of a run directory or a preset, with a file's values over it.

    Raises:
        UsageError: the directory is not a run's, or the configuration is not about the farm.
    """
    found = PRESETS[preset]
    if run_dir is not None:
        if not (run_dir / CONFIG).is_file():
            raise RunDirError(f"{run_dir} is not a run directory: it has no {CONFIG}.")
        found = RunDirectory(run_dir).configuration()
    if config is not None:
        found = from_toml(config, found)
    return require_farm(found, "only the farm's actors fly, and this configuration is about {}.")


def vehicles_of(pairs: Sequence[str]) -> dict[str, str]:
    """Return the agent of each vehicle from NAME=AGENT; raise UsageError for anything else."""
    found: dict[str, str] = {}
    for pair in pairs:
        vehicle, equals, agent = pair.partition("=")
        if not equals or not agent or vehicle in found:
            raise UsageError(f"--vehicle takes NAME=AGENT with each name once, not {pair!r}.")
        found[check_name(vehicle, "vehicle")] = agent
    return found
