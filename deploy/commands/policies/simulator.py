"""`eia-sec simulator`: a simulated farm in the place of real vehicles, flown by `eia-sec fly`."""

import json
import math
import sys
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from eia_sec.common.config import FarmConfig
from eia_sec.common.config.checks import positive, within
from eia_sec.common.errors import UsageError
from eia_sec.common.farm import farm_team
from eia_sec.common.names import check_name
from eia_sec.common.process import StopSignal
from eia_sec.common.transport.bus import Bus
from eia_sec.common.transport.endpoint import DEFAULT, Endpoint
from eia_sec.deploy.commands.policies.fly import farm_of, vehicles_of
from eia_sec.deploy.flight.pilot import require_agents
from eia_sec.deploy.flight.simulator import Flight, SimulatedFleet
from eia_sec.deploy.flight.vehicle import VehicleLink
from eia_sec.deploy.listener import connected
from eia_sec.deploy.options import parse


@dataclass(frozen=True)
class SimulatorArguments:
    """Simulate vehicles for one episode: a farm's UAVs publish poses and obey a flight node's set-points."""

    run_dir: Path | None = None
    """Run directory whose farm to use."""
    config: Path | None = None
    """TOML file with the farm. Default: that of the preset inertial."""
    farm: int = 1000
    """Seed of the farm."""
    episode: int = 0
    """Number of the evaluation episode, as in `eia-sec evaluate`."""
    steps: int | None = None
    """Steps to fly. Default: the whole episode."""
    run: str = "farm"
    """Name of the run that vehicles and flight node share."""
    connect: str = DEFAULT
    """Endpoint where the flight node, a learner or a router listens."""
    tls: Path | None = None
    """Folder of `eia-sec keys` with a certificate vehicle.NAME for each vehicle; turns TLS on."""
    vehicle: tuple[str, ...] = ()
    """Vehicles as NAME=AGENT, one for each agent. Default: the agents' own names."""
    patience: float = 30.0
    """Seconds to wait for a listener and for each set-point."""
    json: bool = False
    """Print one JSON object instead of a sentence."""


def command(arguments: Sequence[str]) -> int:
    """Fly one episode; return 0."""
    options = parse(SimulatorArguments, arguments, "simulator")
    check_name(options.run, "run")
    within(0, 2**62, farm=options.farm, episode=options.episode)
    positive(patience=options.patience, steps=1 if options.steps is None else options.steps)
    farm = farm_of(options.run_dir, options.config)
    named = _names(options, farm)
    stop = StopSignal()
    stop.install()
    with ExitStack() as opened:
        links = _links(options, named, farm, opened, stop)
        flight = SimulatedFleet(farm, links, options.patience).fly(options.farm, options.episode, stop, options.steps)
        refused = sum(link.refused for link in links.values())
    _show(metrics(flight, refused), options.json)
    return 0


def _names(options: SimulatorArguments, farm: FarmConfig) -> dict[str, str]:
    """Return each agent's vehicle; raise UsageError for names that fit no agent, or two."""
    vehicles, names = vehicles_of(options.vehicle), farm_team(farm).agent_names
    require_agents(vehicles, names, "the farm's")
    named = {agent: agent for agent in names} | {agent: vehicle for vehicle, agent in vehicles.items()}
    _require_own_names(named)
    return named


def _links(
    options: SimulatorArguments, named: Mapping[str, str], farm: FarmConfig, opened: ExitStack, stop: StopSignal
) -> dict[str, VehicleLink]:
    """Return each agent's link: one session for all, or with TLS one per certificate."""
    fastest = farm.world.speed_x_max, farm.world.speed_y_max
    shared: Bus | None = None
    links = {}
    for agent, vehicle in named.items():
        if shared is None or options.tls is not None:
            folder = options.tls / f"vehicle.{vehicle}" if options.tls is not None else None
            endpoint = Endpoint.parse(options.connect, folder)
            shared = opened.enter_context(connected(endpoint, options.patience, lambda: not stop))
        links[agent] = VehicleLink(shared, options.run, vehicle, agent, fastest, heights=(0.0, math.inf))
    return links


def _require_own_names(named: Mapping[str, str]) -> None:
    """Raise UsageError when a vehicle is named as another agent's."""
    owners: dict[str, str] = {}
    for agent, vehicle in named.items():
        if (other := owners.setdefault(vehicle, agent)) != agent:
            raise UsageError(f"{other} and {agent} would both be the vehicle {vehicle}; name each one with --vehicle.")


def metrics(flight: Flight, refused: int) -> dict[str, Any]:
    """Return the metrics of a flight as plain numbers."""
    trips = 1e3 * np.array(flight.round_trips or [0.0])
    return {
        "steps": flight.summary.steps,
        "reward": float(np.mean(flight.summary.reward)),
        "round_trip_ms": {
            "median": round(float(np.median(trips)), 3),
            "p99": round(float(np.percentile(trips, 99)), 3),
            "most": round(float(trips.max()), 3),
        },
        "hovers": flight.hovers,
        "resent": flight.resent,
        "refused": refused,
    }


def _show(found: dict[str, Any], as_json: bool) -> None:
    if as_json:
        sys.stdout.write(json.dumps(found) + "\n")
        return
    trip = found["round_trip_ms"]
    sys.stdout.write(
        f"{found['steps']} steps, {found['reward']:.1f} reward per agent; decisions after {trip['median']} ms "
        f"(median), {trip['p99']} ms (99 of 100); {found['hovers']} hovers, {found['resent']} poses resent, "
        f"{found['refused']} set-points refused.\n"
    )
