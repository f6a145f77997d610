"""`eia-sec fly`: a node that keeps the farm's map from vehicles' poses, and sends set-points of a trained policy."""

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

from eia_sec.common.config import FarmConfig, RunConfig
from eia_sec.common.config.checks import within
from eia_sec.common.config.files import from_toml, to_toml
from eia_sec.common.config.presets import PRESETS
from eia_sec.common.errors import UsageError
from eia_sec.common.farm import farm_team, require_farm
from eia_sec.common.incarnation import new_incarnation
from eia_sec.common.log import log
from eia_sec.common.names import check_name
from eia_sec.common.policy_file import POLICY, load_policy
from eia_sec.common.process import StopSignal
from eia_sec.common.transport.bus import Bus
from eia_sec.common.transport.endpoint import DEFAULT, Endpoint
from eia_sec.deploy.flight.deciders import ActorDecider, Decider, HeuristicDecider
from eia_sec.deploy.flight.farm_map import FarmMap, team_vehicles
from eia_sec.deploy.flight.node import FlightNode, NodeOptions, require_absent
from eia_sec.deploy.flight.pilot import Pilot, PilotOptions, require_agents
from eia_sec.deploy.flight.poses import Field
from eia_sec.deploy.flight.record import FlightRecord
from eia_sec.deploy.flight.vehicle import LONGEST_VALIDITY, OLDEST_POSE
from eia_sec.deploy.listener import connected
from eia_sec.deploy.local.run_directory import RunDirectory
from eia_sec.deploy.options import parse
from eia_sec.rollout.farm_files.projection import TangentPlane
from eia_sec.rollout.heuristics.registry import heuristic
from eia_sec.rollout.policies import fitted
from eia_sec.rollout.shipped_policies import policy_path, preset_of


@dataclass(frozen=True)
class FlyArguments:
    """Fly vehicles with a trained policy: poses in, set-points out (docs/how-to/vehicles.md)."""

    policy: str | None = None
    """Policy file, "trained" for the one that ships, "trained:battery" for that of the preset battery, or a heuristic,
    "lawnmower" for instance. Default: the policy of --run-dir."""
    run_dir: Path | None = None
    """Run directory: its configuration, and its policy unless --policy names another."""
    config: Path | None = None
    """TOML file with the farm; it determines the field, the sensors, speeds, the team and its counters."""
    farm: int = 1000
    """Seed of the farm: the sensors' places where the configuration has none."""
    origin: str | None = None
    """LATITUDE,LONGITUDE of the field's corner where x and y are 0, for vehicles that tell degrees; x leads east."""
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
    """Names of vehicles as NAME=AGENT, for example uav-7=monitoring_0. Default: the agents' own names."""
    only: tuple[str, ...] = ()
    """Vehicles that this node flies; the others' poses count in its map. Default: all."""
    rate: float = 10.0
    """Set-points per second for each vehicle, at least 2; the policy decides once in each step of the farm."""
    validity: float = 0.5
    """Seconds for which a vehicle may follow a set-point, at most 1; after that it hovers by itself."""
    max_age: float = 1.0
    """Oldest pose that is used, and largest difference between the vehicle's clock and this machine's, seconds; at most
    1, because vehicles refuse decisions on older ones."""
    lockstep: bool = False
    """Begin each step when all vehicles have flown the one before instead of by the clock; for `eia-sec simulator`."""
    record: Path | None = None
    """MCAP file for poses, set-points, reasons and the farm's map, which Foxglove opens."""
    patience: float = 10.0
    """Seconds to wait for a listener at the endpoint."""
    seconds: float | None = None
    """Seconds until it stops. Default: fly to the end of the farm's episode, or until interrupted."""


def command(arguments: Sequence[str]) -> int:
    """Fly until interrupted, or the episode or the time is over; return 0."""
    options = parse(FlyArguments, arguments, "fly")
    check_name(options.run, "run")
    check_name(options.name, "name")
    within(0, 2**62, farm=options.farm)
    within(2.0, 1000.0, rate=options.rate)
    within(1.0 / options.rate, LONGEST_VALIDITY, validity=options.validity)
    within(0.01, OLDEST_POSE, max_age=options.max_age)
    within(0.0, 1e9, patience=options.patience, seconds=0.0 if options.seconds is None else options.seconds)
    if options.listen and options.connect:
        raise UsageError("give --listen or --connect, not both.")
    start = new_incarnation()
    pilot = make_pilot(options, start)
    endpoint = Endpoint.parse(options.connect or options.listen or DEFAULT, options.tls)
    if endpoint.credentials is not None:
        endpoint.credentials.require("flight", options.name)
    stop = StopSignal()
    stop.install()
    if not options.connect:
        endpoint.require_private(options.insecure)
    with ExitStack() as opened:
        record = opened.enter_context(make_record(options, pilot)) if options.record is not None else None
        bus = opened.enter_context(
            connected(endpoint, options.patience, lambda: not stop)
            if options.connect
            else Bus.listen(endpoint, "control")
        )
        if options.connect:
            require_absent(bus, options.run, options.name)
        listens = None if options.connect else endpoint
        how = NodeOptions(options.run, options.name, start, options.rate, options.seconds, listens)
        node = FlightNode(how, pilot, bus, record)
        flown = sum(vehicle.flown for vehicle in pilot.vehicles.values())
        log(f"flying {flown} vehicles of run {options.run} at {options.rate:g} set-points a second.")
        node.run(stop)
    return 0


def make_pilot(options: FlyArguments, start: int) -> Pilot:
    """Return the pilot of a node with this incarnation.

    Raises:
        UsageError: when policy, farm and vehicles do not fit together.
    """
    farm = farm_of(options.run_dir, options.config, preset_of(options.policy))
    names = vehicles_of(options.vehicle)
    require_agents(names, farm_team(farm).agent_names, "the farm's")
    vehicles = team_vehicles(farm, {agent: vehicle for vehicle, agent in names.items()}, options.only)
    known = [vehicle.name for vehicle in vehicles]
    if len(set(known)) != len(known):
        raise UsageError("two agents would have the same vehicle; name each one with --vehicle.")
    if strangers := sorted(set(options.only) - set(known)):
        raise UsageError(f"--only names {strangers[0]}, but the vehicles are {', '.join(known)}.")
    decider = make_decider(options, farm)
    limits = Field(farm, origin_of(options.origin), options.max_age)
    how = PilotOptions(options.name, start, options.validity, options.lockstep)
    return Pilot(decider, FarmMap(farm, options.farm), vehicles, limits, how)


def make_record(options: FlyArguments, pilot: Pilot) -> FlightRecord:
    """Begin a flight's record; raise UsageError when that is impossible."""
    config = pilot.map.farm.config
    about = {
        "policy": options.policy or str(options.run_dir),
        "farm": str(options.farm),
        "run": options.run,
        "node": options.name,
        "version": version("eia-sec"),
    }
    return FlightRecord(options.record or Path(), about, to_toml(RunConfig(farm=config)), config)


def make_decider(options: FlyArguments, farm: FarmConfig) -> Decider:
    """Return what decides: the heuristic of a name, or the actors of a file.

    Raises:
        UsageError: there is none, or it is for another farm.
    """
    name = options.policy or (str(options.run_dir / POLICY) if options.run_dir else None)
    if name is None:
        raise UsageError("nothing to fly: give --policy FILE, --policy trained or --run-dir DIR.")
    if (rule := heuristic(name, farm)) is not None:
        return HeuristicDecider(rule)
    return ActorDecider(fitted(load_policy(policy_path(name))[0], farm_team(farm)))


def origin_of(text: str | None) -> TangentPlane | None:
    """Return the plane at LATITUDE,LONGITUDE, if any; raise UsageError for anything else."""
    if text is None:
        return None
    try:
        latitude, longitude = map(float, text.split(","))
    except ValueError:
        raise UsageError(f"--origin takes LATITUDE,LONGITUDE in degrees, not {text!r}.") from None
    if not (abs(latitude) <= 90.0 and abs(longitude) <= 180.0):
        raise UsageError(f"--origin {text} is no latitude and longitude.")
    return TangentPlane(longitude, latitude)


def farm_of(run_dir: Path | None, config: Path | None, preset: str = "inertial") -> FarmConfig:
    """Return the farm of a run directory or a preset, with a file's values over it.

    Raises:
        UsageError: the directory is not a run's, or the configuration is not about the farm.
    """
    found = PRESETS[preset]
    if run_dir is not None:
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
