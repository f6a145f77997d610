"""A farm that real vehicles fly: the simulator's own observations of it, from where they are and what they have served.

Counters need no state of their own. A counter rises at known steps, so its level follows from the step of its last
visit.
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from eia_sec.common.config import FarmConfig
from eia_sec.common.errors import ConfigError
from eia_sec.common.team import Float32
from eia_sec.rollout.sim.batch import FarmBatch
from eia_sec.rollout.sim.conditions.stress import first_counters
from eia_sec.rollout.sim.core.dynamics import ACCELERATION, COMMAND, VELOCITY
from eia_sec.rollout.sim.core.step import BEGIN, FOLLOW, step_range
from eia_sec.rollout.sim.layout import Layout
from eia_sec.rollout.sim.sweep_routes import plot_centres

Array = NDArray[np.float64]
NEVER_VISITED = -1


class Levels:
    """The levels of counters of one sort, [N], from the steps of their last visits.

    Args:
        cycle: steps from one rise to the next, and to the first.
        start: levels at the beginning.
        most: largest level.
    """

    def __init__(self, cycle: NDArray[np.int64], start: Array, most: int) -> None:
        self._cycle, self._start, self._most = cycle.ravel(), start.ravel(), most
        self._visit = np.full(self._cycle.shape, NEVER_VISITED)

    def rises(self, step: NDArray[np.int64] | int) -> NDArray[np.int64]:
        """Return how often each counter has risen up to a step, that included."""
        found: NDArray[np.int64] = step // self._cycle
        return found

    def due(self, step: int) -> NDArray[np.int64]:
        """Return the step of each counter's first rise after a step."""
        found: NDArray[np.int64] = self._cycle * (self.rises(step) + 1)
        return found

    def visit(self, items: NDArray[np.int32], step: int) -> None:
        """Note that counters were set to 0 in a step, unless they were visited later."""
        self._visit[items] = np.maximum(self._visit[items], step)

    def at(self, step: int) -> Array:
        """Return the levels after a step."""
        since = self.rises(step) - np.where(self._visit == NEVER_VISITED, 0, self.rises(self._visit))
        start = np.where(self._visit == NEVER_VISITED, self._start, 0.0)
        return np.clip(start + since, 0.0, self._most)


@dataclass(frozen=True)
class TeamState:
    """What is known of a team's vehicles at the end of a step; rows as the team's agents.

    Attributes:
        position: [n, 2] m.
        velocity: [n, 2] over ground, m/s.
        acceleration: [n, 2] m/s^2.
        command: [n, 2] velocity commanded last, m/s.
        charge: [n] of the batteries, J; ignored without batteries.
        wind: [2] m/s; ignored without wind.
        lost: [n] whether a vehicle is lost for good; where the farm loses UAVs.
    """

    position: Array
    velocity: Array
    acceleration: Array
    command: Array
    charge: Array
    wind: Array
    lost: NDArray[np.bool_]


def sensor_numbers(config: FarmConfig, layout: Layout) -> NDArray[np.int64]:
    """Return the number by which vehicles know each sensor of a layout, [S]: its place in the list of measured sites.

    Where positions are sampled, it is the layout's own.
    """
    numbers = np.arange(config.world.sensors)
    if config.world.sites:
        sites = np.array(config.world.sites, np.float64)[:, :2]
        numbers[np.lexsort(layout.sensor_xy.T)] = np.lexsort(sites.T)
    return numbers


class FollowedFarm(FarmBatch):
    """One farm whose UAVs fly by themselves.

    Args:
        config: the farm.
        seed: determines the sensors' places where the configuration has none.

    Attributes:
        plots: levels of the plots' VDF, numbered column by column.
        sensors: levels of the sensors' AoI.
        sensor_of: [S] the sensor of each number by which vehicles know sensors.

    Raises:
        ConfigError: the farm has patches of stress, which nobody maps yet.
    """

    failsafe: ClassVar[bool] = True  # autopilots are the vehicles' own

    def __init__(self, config: FarmConfig, seed: int) -> None:
        if config.stress.patches:
            raise ConfigError("a flight keeps no map of patches of stress; set farm.stress.patches to 0.")
        super().__init__(config, 1)
        self._begun_flight = False
        super().reset(0, seed, 0)
        self._make_levels(self.layout(0))
        self.sensor_of = np.argsort(sensor_numbers(config, self.layout(0)))
        self._state.wind[:] = 0.0
        self._state.failure[:] = np.iinfo(np.int32).max

    def begin(self, team: TeamState) -> Float32:
        """Begin the episode where the vehicles are; return the row of observations [O]."""
        self._place(team)
        if self.config.observation.route:
            self._divide_field(0)
        step_range(self._arguments[0].address, 0, 1, False, BEGIN)
        row: Float32 = self.observation[0]
        return row

    def follow(self, team: TeamState) -> Float32:
        """Take a step over that the vehicles have flown, with the visits noted so far; return the observations [O]."""
        self._divide_again()
        self._arguments[0].workspace.scratch.previous[:] = self._state.position[0]
        self._place(team)
        step_range(self._arguments[0].address, 0, 1, False, FOLLOW)
        row: Float32 = self.observation[0]
        return row

    def _make_levels(self, layout: Layout) -> None:
        """Set up the counters with the levels at the beginning."""
        counters, world = first_counters(self.config, layout), self.config.world
        age, level = self._state.age[0].copy(), self._state.level[0].copy()
        self.plots = Levels(counters.plot_cycle, level, world.vdf_max)
        self.sensors = Levels(counters.sensor_cycle, age, world.aoi_max)

    def _place(self, team: TeamState) -> None:
        """Write what is known after the coming step, or before the first, to the state."""
        state, world = self._state, self.config.world
        step = int(self.time[0]) + (1 if self._begun_flight else 0)
        self._begun_flight = True
        flying = ~self.gone[0]
        inside = np.clip(team.position, 0.0, (world.field_x, world.field_y))
        state.position[0, flying] = inside[flying]
        if self.config.dynamics.inertial:
            motion = state.motion[0]
            motion[:, VELOCITY : VELOCITY + 2] = team.velocity
            motion[:, ACCELERATION : ACCELERATION + 2] = self._limited(team.acceleration)
            motion[:, COMMAND : COMMAND + 2] = team.command
        if self.config.battery.some:
            state.charge[0] = np.minimum(team.charge, self.config.battery.capacity)
        if self.config.wind.some:
            state.wind[0, step] = team.wind
        if self.config.loses_uavs:
            state.failure[0, team.lost] = np.minimum(state.failure[0, team.lost], step)
        state.level[0] = self.plots.at(step).reshape(state.level[0].shape)
        state.level_due[0] = self.plots.due(step).reshape(state.level_due[0].shape)
        state.age[0], state.age_due[0] = self.sensors.at(step), self.sensors.due(step)

    def _limited(self, acceleration: Array) -> Array:
        """Return accelerations [n, 2] within the types' limits, as motion along an axis expects them."""
        limits = np.repeat(self.config.dynamics.of_types("acceleration"), self.config.world.counts)[:, None]
        return np.clip(acceleration, -limits, limits)


def served_in(
    farms: FarmBatch, level: Array, age: Array, first: int, second: int
) -> tuple[tuple[int, int, Array, NDArray[np.int64]], ...]:
    """Return what the monitors and the collectors of a simulated farm served in its last step.

    Args:
        farms: one farm after the step.
        level: [n_px, n_py] VDF before it.
        age: [S] AoI before it.
        first: the first monitor.
        second: the first collector.

    Returns:
        for either type its first UAV and the one past its last, and the places [k, 2] m of the plots or sensors that
        it served, and the numbers [k] by which vehicles know them.
    """
    config, layout, step = farms.config, farms.layout(0), int(farms.time[0])
    counters = first_counters(config, layout)
    centres = plot_centres(config.world)
    found = []
    for cycle, before, after, places, own in (
        (counters.plot_cycle, level, farms.vdf[0], centres, (first, second)),
        (counters.sensor_cycle, age, farms.aoi[0], layout.sensor_xy, (second, config.world.uavs)),
    ):
        rises = step % cycle.ravel() == 0
        items = np.flatnonzero((after.ravel() == 0.0) & ((before.ravel() > 0.0) | rises))
        found.append((*own, places[items], items))
    *rest, (first, last, places, sensors) = found
    return *rest, (first, last, places, sensor_numbers(config, layout)[sensors])
