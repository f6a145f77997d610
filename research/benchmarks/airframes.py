"""A whole farm flown by simulated multirotors over MAVLink, beside the same policy in the farm's own simulator.

    pip install "rotorpy>=3,<4" && pip install "eia-sec[mavlink]"
    python -m research.benchmarks.airframes --policy lawnmower

Each UAV is one of rotorpy's multirotors with PX4's trajectory generator and velocity controller, see `dynamics`, behind
the autopilot that the tests of the MAVLink bridge use: it takes set-points over UDP, in Offboard alone. Pilot, links
and bridges are those of `eia-sec fly` and `eia-sec bridge mavlink`; Zenoh between them is left out, and one clock
drives all. The pilot decides 8 times a second; bridges and autopilots turn twice as often, so a set-point is flown 1/16
s after it was decided. The farm's reference simulator judges: it photographs, collects and rewards at the places where
the multirotors are, and tells their vehicles what they served. `eia-sec watch` shows the flight where --listen says.

To step the way apart: `--airframe model` flies the farm's own dynamics in the place of rotorpy, `--bridge none` hands
set-points over at once, and `--delay` fits the farm's dynamics to a way.
"""

import json
import sys
from collections import defaultdict
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
import tyro
from numpy.typing import NDArray

from eia_sec.common.config import FarmConfig
from eia_sec.common.errors import SimulationError
from eia_sec.common.farm import farm_team
from eia_sec.common.policy_file import POLICY
from eia_sec.common.process import Presence
from eia_sec.common.protocol import keys
from eia_sec.common.protocol.messages import Envelope, SetpointMessage
from eia_sec.common.transport.bus import Bus
from eia_sec.common.transport.endpoint import Endpoint
from eia_sec.deploy.commands.policies.fly import FlyArguments, make_decider
from eia_sec.deploy.commands.policies.fly import farm_of as take_farm
from eia_sec.deploy.exit_codes import run_command
from eia_sec.deploy.flight.bridge import CLIMB_GAIN, Bridge
from eia_sec.deploy.flight.mavlink import MavlinkAutopilot, MavlinkOptions
from eia_sec.deploy.flight.node import FlightView
from eia_sec.deploy.flight.vehicle import Pose, VehicleLink
from eia_sec.rollout.evaluation import episode_seed
from eia_sec.rollout.followed_farm import sensor_numbers
from eia_sec.rollout.heuristics.farms import make_farms
from eia_sec.rollout.heuristics.inertia import glide
from eia_sec.rollout.policies import policy_of
from eia_sec.rollout.sim.layout import make_layout
from eia_sec.rollout.sim.reference.farm import ReferenceFarm
from eia_sec.rollout.sim.reference.power import flight_power
from research.benchmarks.dynamics import GAIN, GRAVITY, INTEGRAL
from tests.deploy.flight.air import Air, Clock, make_pilot
from tests.deploy.flight.mavlink_autopilot import FakeMavlink, free_port

Array = NDArray[np.float64]
PERIODS: Final = 8
"""The pilot's periods a second; a power of 2, so that steps begin when the clock says so."""
TURNS: Final = 2
"""Turns of autopilots and bridges in a period."""
SUBSTEP: Final = 0.025
"""About the period of the autopilots' own controllers, s; a turn has a whole number of them."""
BEFORE: Final = 16
"""Periods before the flight begins, in which set-points stream and the pilot chooses Offboard."""
GO: Final = 4
"""Periods of these after the pilot's go, in which bridges see it."""
RUN: Final = "farm"
"""As `eia-sec watch` supposes."""
NODE: Final = "main"
INTEGRATOR: Final = {"method": "RK23", "first_step": 0.0125, "rtol": 1e-2, "atol": 1e-2}
"""rotorpy's: three times as fast as its default, and 4 mm apart from it after five seconds."""


@dataclass(frozen=True)
class Arguments:
    """Fly one farm through the bridge."""

    policy: str = "lawnmower"
    """A heuristic, a policy that ships or a policy file."""
    run_dir: Path | None = None
    """Run directory whose farm and policy to fly, in the place of --policy and --preset."""
    preset: str = "inertial"
    """The farm's preset."""
    farm: int = 1000
    """Seed of the farm."""
    steps: int | None = None
    """Steps to fly. Default: the whole farm."""
    airframe: Literal["rotorpy", "model"] = "rotorpy"
    """rotorpy's multirotors, or the farm's own dynamics without their delay."""
    bridge: Literal["mavlink", "none"] = "mavlink"
    """MAVLink over UDP, or none: vehicles obey their links at once."""
    delay: float | None = None
    """`farm.dynamics.delay`, for simulator, policy and pilot alike. Default: the preset's."""
    listen: str | None = None
    """Endpoint where `eia-sec watch --connect` finds the flight. Default: nobody watches."""

    @property
    def flown(self) -> str:
        """The policy that is flown."""
        return self.policy if self.run_dir is None else str(self.run_dir / POLICY)


class Airframe:
    """A vehicle that flies by the farm's own limits; x is east, y north and z up.

    Args:
        config: the farm.
        kind: the vehicle's type.
        place: where it begins, [2] m.
        height: likewise, m.
    """

    def __init__(self, config: FarmConfig, kind: int, place: Array, height: float) -> None:
        limits = config.dynamics
        self._most, self._jerk = (np.full(2, limits.of_types(name)[kind]) for name in ("acceleration", "jerk"))
        self._top = limits.of_types("speed")[kind]
        self._v, self._a = np.zeros(2), np.zeros(2)
        self.place, self.velocity = np.array([*place, height]), np.zeros(3)

    def fly(self, wanted: Array, seconds: float) -> None:
        """Fly towards a velocity [3] m/s for some time."""
        goal = np.clip(wanted[:2], -self._top, self._top)
        way, self._v, self._a = glide(self._v, self._a, goal, self._most, self._jerk, seconds)
        self.velocity = np.append(self._v, wanted[2])
        self.place = self.place + np.append(way, wanted[2] * seconds)


class Rotorcraft(Airframe):
    """A Hummingbird of rotorpy behind PX4's trajectory generator and velocity controller."""

    def __init__(self, config: FarmConfig, kind: int, place: Array, height: float) -> None:
        from rotorpy.vehicles.hummingbird_params import quad_params  # noqa: PLC0415  (the extra of this benchmark)
        from rotorpy.vehicles.multirotor import Multirotor  # noqa: PLC0415  (the extra of this benchmark)

        super().__init__(config, kind, place, height)
        self._body = Multirotor(quad_params, control_abstraction="cmd_acc", integrator_kwargs=INTEGRATOR)
        hover = np.sqrt(quad_params["mass"] * GRAVITY / 4.0 / quad_params["k_eta"])
        self._sum = np.zeros(3)
        self._state: dict[str, Any] = {
            "x": self.place,
            "v": np.zeros(3),
            "q": np.array([0.0, 0.0, 0.0, 1.0]),
            "w": np.zeros(3),
            "wind": np.zeros(3),
            "rotor_speeds": np.full(4, hover),
        }

    def fly(self, wanted: Array, seconds: float) -> None:
        """Fly towards a velocity [3] m/s for some time."""
        goal = np.clip(wanted[:2], -self._top, self._top)
        parts = max(1, round(seconds / SUBSTEP))
        part = seconds / parts
        for _ in range(parts):
            _, self._v, self._a = glide(self._v, self._a, goal, self._most, self._jerk, part)
            error = np.append(self._v, wanted[2]) - self._state["v"]
            self._sum += error * part
            wished = np.append(self._a, GRAVITY) + GAIN * error + INTEGRAL * self._sum
            self._state = self._body.step(self._state, {"cmd_acc": wished}, part)
        self.place, self.velocity = self._state["x"], self._state["v"]


class Autopilot(FakeMavlink):
    """The tests' autopilot with an airframe."""

    def __init__(self, port: int, clock: Clock, airframe: Airframe) -> None:
        super().__init__(port, clock)
        self._airframe = airframe
        self._show()

    def move(self, wanted: list[float], dt: float) -> None:
        """Fly towards a velocity for some time, north, east and down."""
        self._airframe.fly(np.array([wanted[1], wanted[0], -wanted[2]]), dt)
        self._show()

    def _show(self) -> None:
        (x, y, z), (vx, vy, vz) = self._airframe.place.tolist(), self._airframe.velocity.tolist()
        self.place, self.velocity = [y, x, -z], [vy, vx, -vz]


class MavlinkWay:
    """A vehicle's way over MAVLink: bridge, UDP and autopilot.

    Args:
        link: the vehicle's link to the pilot.
        airframe: what flies.
        clock: of all.
    """

    def __init__(self, link: VehicleLink, airframe: Airframe, clock: Clock) -> None:
        port = free_port()
        options = MavlinkOptions(f"udpin:127.0.0.1:{port}", local=(0.0, 0.0))
        self._bridge = Bridge(link, MavlinkAutopilot(options, clock), clock)
        self.autopilot = Autopilot(port, clock, airframe)

    def fly(self) -> None:
        """Fly up to now."""
        self.autopilot.turn()

    def tell(self) -> None:
        """Tell where the vehicle is, and pass on what has been decided."""
        self._bridge.turn()

    def obey(self) -> None:
        """Do nothing: what has been decided waits for the bridge's next turn."""

    def arm(self) -> None:
        """Do what a pilot does; raise SimulationError where the autopilot refuses Offboard."""
        self.autopilot.armed = True
        if not self.autopilot.pilot_sets_mode("OFFBOARD"):
            raise SimulationError("set-points do not stream, so the autopilot refuses Offboard.")

    def close(self) -> None:
        """Close both ends."""
        self._bridge.close()
        self.autopilot.close()


class NoWay:
    """A vehicle that obeys its link at once, in the place of `MavlinkWay`."""

    def __init__(self, link: VehicleLink, airframe: Airframe, clock: Clock) -> None:
        self._link, self._airframe, self._clock = link, airframe, clock
        self._wanted, self._last = np.zeros(3), clock()

    def fly(self) -> None:
        """Fly up to now."""
        now = self._clock()
        self._airframe.fly(self._wanted, now - self._last)
        self._last = now

    def tell(self) -> None:
        """Tell where the vehicle is."""
        x, y, height = self._airframe.place.tolist()
        vx, vy, _ = self._airframe.velocity.tolist()
        self._link.publish(Pose((x, y), height, (vx, vy)))

    def obey(self) -> None:
        """Follow what has been decided, and keep the height as the bridge does."""
        message = self._link.setpoint()
        climb = 0.0 if message.hover else float(np.clip(CLIMB_GAIN * (message.height - self._airframe.place[2]), -1, 1))
        self._wanted = np.array([*message.velocity, climb])

    def arm(self) -> None:
        """Do nothing."""

    def close(self) -> None:
        """Do nothing."""


class Judge(ReferenceFarm):
    """The reference farm at the places where others fly.

    Attributes:
        visits: for each UAV the plots or sensors that it served in the last step.
        total: rewards so far.
        stray: how far a height has strayed, m.
    """

    stray = 0.0
    total: Array = np.zeros(1)

    def look_at(self, airframes: list[Airframe], action: Array) -> None:
        """Judge a step that ended with the airframes where they are; actions are [n, 2]."""
        self._where = np.array([airframe.place[:2] for airframe in airframes])
        self._speeds = np.array([airframe.velocity[:2] for airframe in airframes])
        self.stray = max(self.stray, *(abs(a.place[2] - self.height[u]) for u, a in enumerate(airframes)))
        self.visits: dict[int, list[int]] = defaultdict(list)
        self.step(action.astype(np.float32).ravel())
        self.total = self.total + self.reward

    def _fly(self, velocity: Array) -> tuple[Array, Array]:
        """Return the ways that were flown, and their energy as the farm counts it."""
        energy, seconds = self.config.energy, self.config.world.step_seconds
        way, before = self._where - self.position, self.velocity
        self.velocity = self._speeds
        change = np.linalg.norm(self._speeds - before, axis=1) / seconds
        load = np.sqrt(1.0 + (change / energy.gravity) ** 2)
        speed = np.linalg.norm(way / seconds, axis=1)
        gained = energy.mass / 2.0 * ((self._speeds**2).sum(axis=1) - (before**2).sum(axis=1))
        power = np.array([flight_power(energy, v, n) for v, n in zip(speed, load, strict=True)])
        return way, power * seconds + np.maximum(0.0, gained)

    def _serve(self, counter: Array, item: tuple[int, ...], u: int, served: bool, due: bool, cap: int) -> None:
        if served:
            self.visits[u].append(item[0] * self.config.world.plots_y + item[1] if len(item) > 1 else item[0])
        super()._serve(counter, item, u, served, due, cap)

    def _look(self) -> None:
        """Find the directions alone: nobody observes here."""
        self._find_directions()


def farm_of(arguments: Arguments) -> FarmConfig:
    """Return the farm that is flown."""
    config = take_farm(arguments.run_dir, None, arguments.preset)
    if arguments.delay is None:
        return config
    return replace(config, dynamics=replace(config.dynamics, delay=(arguments.delay,)))


def fly(arguments: Arguments) -> dict[str, Any]:
    """Fly through the bridge; return rewards per agent and what was counted."""
    if arguments.listen is None:
        return _fly(arguments, None)
    endpoint = Endpoint.parse(arguments.listen)
    endpoint.require_private(insecure=False, advice="listen on this machine")
    with Bus.listen(endpoint, "control") as bus:
        presence = Presence(bus, RUN, "flight", NODE, 1)
        found = _fly(arguments, bus)
        presence.report({"alarms": []})
        return found


def _fly(arguments: Arguments, bus: Bus | None) -> dict[str, Any]:
    config, clock, air = farm_of(arguments), Clock(), Air()
    steps = config.world.steps if arguments.steps is None else min(arguments.steps, config.world.steps)
    judge = Judge(config, make_layout(config, arguments.farm), episode_seed(arguments.farm, 0))
    numbers = sensor_numbers(config, judge.layout)
    decider = make_decider(FlyArguments(policy=arguments.flown), config)
    pilot = make_pilot(config, decider, seed=arguments.farm, clock=clock)
    names = farm_team(config).agent_names
    fastest = config.world.speed_x_max, config.world.speed_y_max
    links = [VehicleLink(air, RUN, v, v, fastest, clock, clock) for v in names]
    made = Rotorcraft if arguments.airframe == "rotorpy" else Airframe
    airframes = [made(config, int(judge.kind[u]), judge.position[u], float(judge.height[u])) for u in range(len(names))]
    kind = MavlinkWay if arguments.bridge == "mavlink" else NoWay
    ways = [kind(link, airframe, clock) for link, airframe in zip(links, airframes, strict=True)]
    incoming = {v: air.subscribe(keys.POSE.key(RUN, vehicle=v), 16) for v in names}
    outgoing = {v: air.publish(keys.SETPOINT.key(RUN, vehicle=v)) for v in names}
    show = FlightView(bus, RUN, NODE, 1, pilot.map).poll if bus is not None else lambda: False
    found: dict[str, SetpointMessage] = {}
    for period in range(BEFORE + PERIODS * steps + 1):
        for turn in range(1, TURNS + 1):
            clock.now += 1.0 / PERIODS / TURNS
            for way in ways:
                way.fly()
            if turn == TURNS and period > BEFORE and (period - BEFORE) % PERIODS == 0:
                judge.look_at(airframes, np.array([found[v].action for v in names]))
                for u, items in judge.visits.items():
                    links[u].serve(numbers[items].tolist() if judge.kind[u] == 2 else items)
            for way in ways:
                if period == BEFORE - GO and turn == TURNS:
                    way.arm()
                way.tell()
        for v, poses in incoming.items():
            begins = v == names[-1]  # the flight, with its first pose
            for sample in poses.drain() if period >= BEFORE or not begins else ():
                pilot.offer(v, sample.payload, sample.attachment, clock.now)
        found = pilot.decide(clock.now)
        show()
        for v, message in found.items():
            outgoing[v].put(message.encode(), Envelope("flight", NODE, 1, message.period).encode())
        for way in ways:
            way.obey()
    for way in ways:
        way.close()
    report, simulated = pilot.report(), simulate(arguments, config, steps)
    autopilots = [way.autopilot for way in ways if isinstance(way, MavlinkWay)]
    return {
        **{name: str(value) if isinstance(value, Path) else value for name, value in vars(arguments).items()},
        "steps": pilot.map.steps,
        "reward flown": round(float(judge.total.mean()), 1),
        "reward in the simulator": round(float(simulated.mean()), 1),
        "share": round(float(judge.total.mean() / simulated.mean()), 3),
        "flown, by type": _by_type(judge.total, judge.kind),
        "in the simulator, by type": _by_type(simulated, judge.kind),
        "hovers": sum(number for cause, number in report["causes"].items() if cause not in ("missing", "end")),
        "left Offboard": sum(autopilot.failsafes for autopilot in autopilots),
        "set-points that the autopilots refused": sum(len(autopilot.rejected) for autopilot in autopilots),
        "set-points that the border limited": report["limited"],
        "height strays, m": round(judge.stray, 2),
    }


def _by_type(rewards: Array, kind: NDArray[np.int64]) -> list[float]:
    return [round(float(rewards[kind == number].mean()), 1) for number in range(3)]


def simulate(arguments: Arguments, config: FarmConfig, steps: int) -> Array:
    """Return each agent's reward [n] for the same steps in the farm's own simulator."""
    farms, policy = make_farms(config, 1), policy_of(arguments.flown, config)
    farms.reset(0, arguments.farm, episode_seed(arguments.farm, 0))
    policy.reset(farms, 0)
    for _ in range(steps):
        farms.step(policy.act(farms))
    return np.array(farms.summary(0).reward, np.float64)


def main() -> int:
    """Fly and print; return 0."""
    found = fly(tyro.cli(Arguments, prog="python -m research.benchmarks.airframes"))
    sys.stdout.write(json.dumps(found, indent=2) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(run_command(main))
