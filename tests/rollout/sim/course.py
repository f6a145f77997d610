"""The course of one flown episode: every public array of the batch, after the start and after every step."""

from dataclasses import dataclass

import numpy as np

from eia_sec.common.transitions import EpisodeSummary
from eia_sec.rollout.sim.batch import FarmBatch
from eia_sec.rollout.sim.layout import Layout
from tests.rollout.sim.properties.strategies import Flight, placed


@dataclass(frozen=True, eq=False)
class Course:
    """T steps; arrays with T + 1 rows begin with the start.

    Attributes:
        flight: what was flown.
        layout: where the sensors stand.
        wanted: [T, n, 2] where the commands lead, m, borders or not.
        velocity: [T, n, 2] commanded, m/s.
        position, direction: [T + 1, n, 2].
        aoi: [T + 1, S].
        vdf: [T + 1, n_px, n_py].
        assignment: [T + 1, n_m + n_d].
        service: [T + 1, n_c].
        observation: [T + 1, O].
        reward, energy, utility: [T, n].
        parts: [T, n, K].
        served_sensors: [T, n_d].
        summary: of the episode.
    """

    flight: Flight
    layout: Layout
    wanted: np.ndarray
    velocity: np.ndarray
    position: np.ndarray
    direction: np.ndarray
    aoi: np.ndarray
    vdf: np.ndarray
    assignment: np.ndarray
    service: np.ndarray
    observation: np.ndarray
    reward: np.ndarray
    energy: np.ndarray
    utility: np.ndarray
    parts: np.ndarray
    served_sensors: np.ndarray
    summary: EpisodeSummary

    @property
    def steps(self) -> int:
        """T."""
        return len(self.reward)

    @property
    def kinds(self) -> np.ndarray:
        """[n] 0 communication, 1 monitoring, 2 data collection."""
        return kinds(self.flight)

    @property
    def heights(self) -> np.ndarray:
        """[n] m."""
        world = self.flight.config.world
        return np.array([world.height_communication, world.height_monitoring, world.height_collection])[self.kinds]

    def place(self) -> np.ndarray:
        """[T + 1, n, 3] positions with their heights, m."""
        height = np.broadcast_to(self.heights[:, None], (*self.position.shape[:2], 1))
        return np.concatenate([self.position, height], axis=2)

    def due(self) -> tuple[np.ndarray, np.ndarray]:
        """Return at which of the T steps AoI [T, S] and VDF [T, n_px, n_py] are due to rise."""
        world, step = self.flight.config.world, np.arange(1, self.steps + 1)
        age = step[:, None] % self.layout.sensor_cycle_steps == 0
        cycle = round(world.vdf_cycle / world.step_seconds)
        return age, np.broadcast_to((step % cycle == 0)[:, None, None], (len(step), world.plots_x, world.plots_y))


STARTING = ("position", "direction", "aoi", "vdf", "assignment", "service", "observation")
STEPPING = ("reward", "energy", "utility", "parts", "served_sensors")


def kinds(flight: Flight) -> np.ndarray:
    """Return the type of each UAV, [n]."""
    world = flight.config.world
    return np.repeat((0, 1, 2), (world.communication_uavs, world.monitoring_uavs, world.collection_uavs))


def begin(flight: Flight, batch: FarmBatch | None = None, index: int = 0) -> FarmBatch:
    """Start a flight in an environment of a batch, or in a batch of its own."""
    batch = FarmBatch(flight.config, 1) if batch is None else batch
    with placed(flight.layout(), flight.positions()):
        batch.reset(index, flight.farm, flight.episode)
    return batch


def fly(flight: Flight) -> Course:
    """Fly a whole episode alone."""
    world, batch, actions = flight.config.world, begin(flight), flight.actions()
    course = {name: [getattr(batch, name)[0].copy()] for name in STARTING}
    course |= {name: [] for name in STEPPING}
    for action in actions:
        batch.step(action[None])
        for name, values in course.items():
            values.append(getattr(batch, name)[0].copy())
    stacked = {name: np.stack(values) for name, values in course.items()}
    shares = np.clip(actions.astype(np.float64), -1.0, 1.0).reshape(len(actions), -1, 2)
    velocity = shares * (world.speed_x_max, world.speed_y_max)
    wanted = stacked["position"][:-1] + velocity * world.step_seconds
    return Course(flight, flight.layout(), wanted, velocity, summary=batch.summary(0), **stacked)
