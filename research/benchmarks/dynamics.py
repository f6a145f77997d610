"""How closely the farm's flight with inertia follows a simulated multirotor that gets the same set-points.

    pip install "rotorpy>=3,<4"
    python -m research.benchmarks.dynamics [--json] [--steps 60] [--seeds 4]

rotorpy (Folk et al. 2023) integrates the rigid body, its rotors, attitude control and drag. A velocity set-point a
second goes to an autopilot's trajectory generator, which limits acceleration and jerk at 50 Hz and hands the velocity
to one of two controllers: rotorpy's own velocity controller; or one with PX4's velocity gain (MPC_XY_VEL_P_ACC 1.8)
and the trajectory's acceleration as feed-forward, as PX4's position controller has. `raw` is rotorpy's controller
without a generator, which gets the set-point at once.

The way of each step is compared with the farm's: `instant`, and `inertial` with the default limits and several delays.
Both fly on their own from the same start; no state is handed over.
"""

import json
import sys
import time
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import tyro
from numpy.typing import NDArray

from eia_sec.common.config.farm.dynamics import DynamicsConfig
from eia_sec.rollout.heuristics.inertia import glide

Array = NDArray[np.float64]

RATE: Final = 50.0
"""Set-points of the trajectory generator per second, 1/s."""
SUBSTEPS: Final = 4
"""Steps of rotorpy between two of them."""
GAIN: Final = 1.8
"""PX4's MPC_XY_VEL_P_ACC, 1/s."""
INTEGRAL: Final = 0.4
"""PX4's MPC_XY_VEL_I_ACC, 1/s^2."""
GRAVITY: Final = 9.81
"""rotorpy's, m/s^2."""
CONTROLLERS: Final = ("px4", "cmd_vel", "raw")
DELAYS: Final = (0.0, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.4)
"""Delays to compare, s."""


@dataclass(frozen=True)
class Options:
    """What to measure."""

    json: bool = False
    """Print JSON."""
    steps: int = 60
    """Set-points of a flight, one a second."""
    seeds: int = 4
    """Flights of each controller."""


def set_points(seed: int, steps: int, top: float) -> Array:
    """Return velocities [steps, 2] m/s along eight headings or none, each held for one to five seconds."""
    random, found = np.random.default_rng(seed), list[Array]()
    while len(found) < steps:
        velocity = random.integers(-1, 2, 2) * top * random.choice([0.4, 1.0])
        found += [velocity] * int(random.integers(1, 6))
    return np.array(found[:steps])


def modelled(velocities: Array, limits: DynamicsConfig, delay: float) -> Array:
    """Return the way of each step [steps, 2] m as the farm has it."""
    most, jerk = limits.acceleration[0], limits.jerk[0]
    v, a, before, ways = np.zeros(2), np.zeros(2), np.zeros(2), []
    for wanted in velocities:
        first, v, a = glide(v, a, before, np.full(2, most), np.full(2, jerk), delay)
        then, v, a = glide(v, a, wanted, np.full(2, most), np.full(2, jerk), 1.0 - delay)
        before = wanted
        ways.append(first + then)
    return np.array(ways)


def flown(velocities: Array, limits: DynamicsConfig, controller: str) -> tuple[Array, float]:
    """Return the way of each step [steps, 2] m that rotorpy's Hummingbird flies, and how far its height strays, m."""
    from rotorpy.vehicles.hummingbird_params import quad_params  # noqa: PLC0415  (the extra of this benchmark)
    from rotorpy.vehicles.multirotor import Multirotor  # noqa: PLC0415  (the extra of this benchmark)

    vehicle = Multirotor(quad_params, control_abstraction="cmd_acc" if controller == "px4" else "cmd_vel")
    hover = np.sqrt(quad_params["mass"] * GRAVITY / 4.0 / quad_params["k_eta"])
    state: dict[str, Any] = {
        "x": np.array([0.0, 0.0, 20.0]),
        "v": np.zeros(3),
        "q": np.array([0.0, 0.0, 0.0, 1.0]),
        "w": np.zeros(3),
        "wind": np.zeros(3),
        "rotor_speeds": np.full(4, hover),
    }
    most, jerk = np.full(2, limits.acceleration[0]), np.full(2, limits.jerk[0])
    v, a, sum_of_errors, ways, stray = np.zeros(2), np.zeros(2), np.zeros(3), [], 0.0
    for wanted in velocities:
        start = state["x"][:2].copy()
        for _ in range(int(RATE)):
            _, v, a = glide(v, a, wanted, most, jerk, 1.0 / RATE)
            goal = np.append(wanted if controller == "raw" else v, 0.0)
            for _ in range(SUBSTEPS):
                if controller == "px4":
                    rise = np.array([0.0, 0.0, GRAVITY + 2.0 * (20.0 - state["x"][2])])
                    sum_of_errors += (goal - state["v"]) / RATE / SUBSTEPS
                    wished = GAIN * (goal - state["v"]) + INTEGRAL * sum_of_errors
                    control = {"cmd_acc": np.append(a, 0.0) + wished + rise}
                else:
                    control = {"cmd_v": goal}
                state = vehicle.step(state, control, 1.0 / RATE / SUBSTEPS)
            stray = max(stray, abs(float(state["x"][2]) - 20.0))
        ways.append(state["x"][:2] - start)
    return np.array(ways), stray


def measure(options: Options) -> dict[str, Any]:
    """Return the errors of a step's way at the 50th, 90th and 99th percentile, m, by controller and model."""
    limits, found = DynamicsConfig(), dict[str, Any]()
    for controller in CONTROLLERS:
        flights, strays = [], []
        for seed in range(options.seeds):
            velocities = set_points(seed, options.steps, limits.speed[0])
            ways, stray = flown(velocities, limits, controller)
            flights.append((velocities, ways))
            strays.append(stray)
        models = {"instant": [velocities for velocities, _ in flights]}
        models |= {f"inertial, delay {d:g} s": [modelled(v, limits, d) for v, _ in flights] for d in DELAYS}
        found[controller] = {"height strays, m": round(max(strays), 2)}
        for name, ways_of in models.items():
            errors = [np.linalg.norm(own - ways, axis=1) for own, (_, ways) in zip(ways_of, flights, strict=True)]
            shares = np.percentile(np.concatenate(errors), (50, 90, 99))
            found[controller][name] = [round(float(share), 3) for share in shares]
    return found


def main() -> None:
    """Measure and print."""
    options, began = tyro.cli(Options, description=__doc__), time.perf_counter()
    found = measure(options)
    lines = [json.dumps(found, indent=2)] if options.json else []
    for controller, rows in found.items() if not options.json else ():
        lines += [f"{controller}:", *(f"  {name}: {value}" for name, value in rows.items())]
    sys.stdout.write("\n".join([*lines, *([] if options.json else [f"{time.perf_counter() - began:.0f} s"])]) + "\n")


if __name__ == "__main__":
    main()
