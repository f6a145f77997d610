"""`eia-sec fly`: trained actors as a node that turns vehicles' observations into velocity set-points."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from common.config import FarmConfig
from common.config.checks import positive, within
from common.config.files import from_toml
from common.config.presets import PRESETS
from common.errors import RunDirError, UsageError
from common.farm import farm_team, require_farm
from common.names import check_name
from common.policy_file import load_policy
from common.process import StopSignal, log
from common.transport.bus import Bus
from common.transport.endpoint import DEFAULT, Endpoint
from deploy.flight.node import FlightNode, NodeOptions
from deploy.flight.pilot import Limits, Pilot
from deploy.local.run_directory import CONFIG, POLICY, RunDirectory
from deploy.options import parse
from rollout.policies import TRAINED, fitted


@dataclass(frozen=True)
class FlyArguments:
    """Fly vehicles with trained actors: observations in, velocity set-points out (docs/how-to/vehicles.md)."""

    policy: str | None = None
    """Policy file, or trained for the one that ships. Default: that of --run-dir."""
    run_dir: Path | None = None
    """A run's directory: its configuration, and its policy unless another is named."""
    config: Path | None = None
    """TOML file with the farm that the policy was trained for; speeds and the team follow from it."""
    run: str = "farm"
    """Name under which vehicles and this node meet."""
    connect: str | None = None
    """Endpoint of a router or of a listening learner."""
    listen: str | None = None
    """Endpoint to listen on instead, so that vehicles connect to this node. Default: tcp/127.0.0.1:7447."""
    tls: Path | None = None
    """Folder with the node's certificate, made by `eia-sec keys issue flight NAME --host HOST`; links are TLS then."""
    insecure: bool = False
    """Listen on an address that other machines reach, without authentication."""
    name: str = "main"
    """Name of this node."""
    vehicle: tuple[str, ...] = ()
    """Vehicles to fly, NAME=AGENT, uav-7=monitoring_0 for instance. Default: every agent, under its own name."""
    rate: float = 10.0
    """Set-points per second and vehicle."""
    hold: int = 1
    """Periods for which one observation serves; without a newer one the vehicle is then told to hover."""
    max_age: float = 1.0
    """Seconds by which an observation's stamp and this machine's clock may differ."""
    patience: float = 10.0
    """Seconds to wait for somebody to listen at the endpoint."""
    seconds: float | None = None
    """Stop after this time. Default: fly until interrupted."""


def command(arguments: Sequence[str]) -> int:
    """Fly until interrupted or the time is over; return 0."""
    options = parse(FlyArguments, arguments, "fly")
    check_name(options.run, "run")
    check_name(options.name, "name")
    within(0.1, 1000.0, rate=options.rate)
    within(1, 1000, hold=options.hold)
    positive(max_age=options.max_age)
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
        node = FlightNode(NodeOptions(options.run, options.name, options.rate, options.seconds), pilot, agents, bus)
        log(f"flying {len(agents)} vehicles of run {options.run} at {options.rate:g} set-points a second.")
        node.run(stop)
    return 0


def make_pilot(options: FlyArguments) -> tuple[Pilot, tuple[str, ...]]:
    """Return the pilot that the options ask for, and the vehicles that it flies.

    Raises:
        UsageError: when policy, farm and vehicles do not fit together.
    """
    farm = farm_of(options.run_dir, options.config)
    name = options.policy or (str(options.run_dir / POLICY) if options.run_dir else None)
    if name is None:
        raise UsageError("nothing to fly: give --policy FILE, --policy trained or --run-dir DIR.")
    actors = fitted(load_policy(TRAINED if name == "trained" else Path(name))[0], farm_team(farm))
    agents = vehicles_of(options.vehicle) or {agent: agent for agent in actors.team.agent_names}
    speed = farm.world.speed_x_max, farm.world.speed_y_max
    return Pilot(actors, agents, speed, Limits(options.hold, options.max_age)), tuple(agents)


def farm_of(run_dir: Path | None, config: Path | None) -> FarmConfig:
    """Return the farm of a run directory with a file's values over it, else the default's.

    Raises:
        UsageError: when there is none, or it is about another environment.
    """
    found = PRESETS["default"]
    if run_dir is not None:
        if not (run_dir / CONFIG).is_file():
            raise RunDirError(f"{run_dir} is no run directory: it holds no {CONFIG}.")
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
            raise UsageError(f"--vehicle takes NAME=AGENT, each name once, not {pair!r}.")
        found[check_name(vehicle, "vehicle")] = agent
    return found
