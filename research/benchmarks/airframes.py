"""A whole farm flown by simulated multirotors over MAVLink, beside the same policy in the farm's own simulator.

    pip install "rotorpy>=3,<4" && pip install "eia-sec[mavlink]"
    python -m research.benchmarks.airframes --policy lawnmower --steps 100

Each UAV is one of rotorpy's multirotors with PX4's trajectory generator and velocity controller, see `dynamics`, behind
the autopilot that the tests of the MAVLink bridge use: it takes set-points over UDP, in Offboard alone. Pilot, links
and bridges are those of `eia-sec fly` and `eia-sec bridge mavlink`; Zenoh between them is left out, and one clock
drives all. Set-points pass 8 times a second. The farm's reference simulator judges: it photographs, collects and
rewards at the places where the multirotors are, and tells their vehicles what they served.
"""

import json
import sys
from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import tyro
from numpy.typing import NDArray

from eia_sec.common.config import FarmConfig
from eia_sec.common.config.presets import PRESETS
from eia_sec.common.errors import SimulationError
from eia_sec.common.farm import farm_team
from eia_sec.common.protocol import keys
from eia_sec.common.protocol.messages import Envelope, SetpointMessage
from eia_sec.deploy.commands.policies.fly import FlyArguments, make_decider
from eia_sec.deploy.exit_codes import run_command
from eia_sec.deploy.flight.mavlink import BridgeOptions, MavlinkBridge
from eia_sec.deploy.flight.vehicle import VehicleLink
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
from tests.deploy.flight.autopilot import FakeAutopilot, free_port

Array = NDArray[np.float64]
PERIODS: Final = 8
"""Periods a second; a power of 2, so that steps begin when the clock says so."""
SUBSTEP: Final = 0.025
"""Step of rotorpy, s."""
BEFORE: Final = 16
"""Periods before the flight begins, in which set-points stream and the pilot chooses Offboard."""
GO: Final = 4
"""Periods of these after the pilot's go, in which bridges see it."""
RUN: Final = "airframes"


@dataclass(frozen=True)
class Arguments:
    """Fly one farm through the bridge."""

    policy: str = "lawnmower"
    """A heuristic, a policy that ships or a policy file."""
    preset: str = "inertial"
    """The farm's preset."""
    farm: int = 1000
    """Seed of the farm."""
    steps: int = 100
    """Steps to fly."""


class Rotor(FakeAutopilot):
    """The tests' autopilot with a multirotor of rotorpy as its airframe."""

    def __init__(self, port: int, clock: Clock, config: FarmConfig, kind: int, place: Array, height: float) -> None:
        from rotorpy.vehicles.hummingbird_params import quad_params  # noqa: PLC0415  (the extra of this benchmark)
        from rotorpy.vehicles.multirotor import Multirotor  # noqa: PLC0415  (the extra of this benchmark)

        super().__init__(port, clock, height=height)
        self._airframe = Multirotor(quad_params, control_abstraction="cmd_acc")
        hover = np.sqrt(quad_params["mass"] * GRAVITY / 4.0 / quad_params["k_eta"])
        limits = config.dynamics
        self._most, self._jerk = (np.full(2, limits.of_types(name)[kind]) for name in ("acceleration", "jerk"))
        self._top = limits.of_types("speed")[kind]
        self._v, self._a, self._sum = np.zeros(2), np.zeros(2), np.zeros(3)
        self._state: dict[str, Any] = {
            "x": np.array([*place, height]),
            "v": np.zeros(3),
            "q": np.array([0.0, 0.0, 0.0, 1.0]),
            "w": np.zeros(3),
            "wind": np.zeros(3),
            "rotor_speeds": np.full(4, hover),
        }
        self._show()

    def move(self, wanted: list[float], dt: float) -> None:
        """Fly towards a velocity for some time, north, east and down; rotorpy's x is east, y north and z up."""
        goal = np.clip([wanted[1], wanted[0]], -self._top, self._top)
        for _ in range(round(dt / SUBSTEP)):
            _, self._v, self._a = glide(self._v, self._a, goal, self._most, self._jerk, SUBSTEP)
            error = np.array([*self._v, -wanted[2]]) - self._state["v"]
            self._sum += error * SUBSTEP
            wished = np.append(self._a, GRAVITY) + GAIN * error + INTEGRAL * self._sum
            self._state = self._airframe.step(self._state, {"cmd_acc": wished}, SUBSTEP)
        self._show()

    def _show(self) -> None:
        x, v = self._state["x"].tolist(), self._state["v"].tolist()
        self.place, self.velocity = [x[1], x[0], -x[2]], [v[1], v[0], -v[2]]


class Judge(ReferenceFarm):
    """The reference farm at the places where others fly.

    Attributes:
        visits: for each UAV the plots or sensors that it served in the last step.
        total: rewards so far.
        stray: how far a height has strayed, m.
    """

    stray = 0.0
    total: Array = np.zeros(1)

    def look_at(self, rotors: "list[Rotor]", action: Array) -> None:
        """Judge a step that ended with the multirotors where they are; actions are [n, 2]."""
        self._where = np.array([[r.place[1], r.place[0]] for r in rotors])
        self._speeds = np.array([[r.velocity[1], r.velocity[0]] for r in rotors])
        self.stray = max(self.stray, *(abs(-r.place[2] - self.height[u]) for u, r in enumerate(rotors)))
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


def fly(arguments: Arguments) -> dict[str, Any]:
    """Fly through the bridge; return rewards per agent and what was counted."""
    config, clock, air = PRESETS[arguments.preset].farm, Clock(), Air()
    judge = Judge(config, make_layout(config, arguments.farm), episode_seed(arguments.farm, 0))
    numbers = sensor_numbers(config, judge.layout)
    decider = make_decider(FlyArguments(policy=arguments.policy), config)
    pilot = make_pilot(config, decider, seed=arguments.farm, clock=clock)
    names = farm_team(config).agent_names
    fastest = config.world.speed_x_max, config.world.speed_y_max
    links = {v: VehicleLink(air, RUN, v, v, fastest, clock, clock) for v in names}
    ports = [free_port() for _ in names]
    bridges = {
        v: MavlinkBridge(links[v], BridgeOptions(f"udpin:127.0.0.1:{port}", local=(0.0, 0.0)), clock)
        for v, port in zip(names, ports, strict=True)
    }
    rotors = {
        v: Rotor(ports[u], clock, config, int(judge.kind[u]), judge.position[u], float(judge.height[u]))
        for u, v in enumerate(names)
    }
    incoming = {v: air.subscribe(keys.POSE.key(RUN, vehicle=v), 16) for v in names}
    outgoing = {v: air.publish(keys.SETPOINT.key(RUN, vehicle=v)) for v in names}
    found: dict[str, SetpointMessage] = {}
    for period in range(BEFORE + PERIODS * arguments.steps + 1):
        clock.now += 1.0 / PERIODS
        for rotor in rotors.values():
            rotor.turn()
        if period == BEFORE - GO:
            _arm(rotors.values())
        elif period > BEFORE and (period - BEFORE) % PERIODS == 0:
            judge.look_at(list(rotors.values()), np.array([found[v].action for v in names]))
            for u, items in judge.visits.items():
                links[names[u]].serve(numbers[items].tolist() if judge.kind[u] == 2 else items)
        for bridge in bridges.values():
            bridge.turn()
        for v, poses in incoming.items():
            begins = v == names[-1]  # the flight, with its first pose
            for sample in poses.drain() if period >= BEFORE or not begins else ():
                pilot.offer(v, sample.payload, sample.attachment, clock.now)
        found = pilot.decide(clock.now)
        for v, message in found.items():
            outgoing[v].put(message.encode(), Envelope("flight", "main", 1, message.period).encode())
    report = pilot.report()
    for end in (*bridges.values(), *rotors.values()):
        end.close()
    flown = float(judge.total.mean())
    simulated = simulate(arguments, config)
    return {
        **vars(arguments),
        "steps flown": pilot.map.steps,
        "reward over MAVLink": round(flown, 1),
        "reward in the simulator": round(simulated, 1),
        "share": round(flown / simulated, 3),
        "hovers after the beginning": report["hovers"] - len(names) * BEFORE,
        "left Offboard": sum(rotor.failsafes for rotor in rotors.values()),
        "set-points that the autopilots refused": sum(len(rotor.rejected) for rotor in rotors.values()),
        "set-points that the border limited": report["limited"],
        "height strays, m": round(judge.stray, 2),
    }


def _arm(rotors: Iterable[Rotor]) -> None:
    """Do what a pilot does; raise SimulationError where an autopilot refuses Offboard."""
    for rotor in rotors:
        rotor.armed = True
        if not rotor.pilot_sets_mode("OFFBOARD"):
            raise SimulationError("set-points do not stream, so the autopilot refuses Offboard.")


def simulate(arguments: Arguments, config: FarmConfig) -> float:
    """Return the reward per agent of the same steps in the farm's own simulator."""
    farms, policy = make_farms(config, 1), policy_of(arguments.policy, config)
    farms.reset(0, arguments.farm, episode_seed(arguments.farm, 0))
    policy.reset(farms, 0)
    for _ in range(arguments.steps):
        farms.step(policy.act(farms))
    return float(np.mean(farms.summary(0).reward))


def main() -> int:
    """Fly and print; return 0."""
    found = fly(tyro.cli(Arguments, prog="python -m research.benchmarks.airframes"))
    sys.stdout.write(json.dumps(found, indent=2) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(run_command(main))
