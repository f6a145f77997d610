"""The flight node's map of the farm: one step after the other, from poses, reports and the clock."""

from collections.abc import Sequence

import numpy as np

from eia_sec.common.config import FarmConfig
from eia_sec.common.farm import farm_team
from eia_sec.common.team import Float32
from eia_sec.deploy.flight.poses import LOST_SECONDS, Vehicle
from eia_sec.rollout.followed_farm import FollowedFarm, TeamState


class FarmMap:
    """What the farm's simulator knows, kept of a farm that vehicles fly.

    Args:
        config: the farm.
        seed: determines the sensors' places where the configuration has none, and phases.

    Attributes:
        farm: the farm; its observations are those of the team.
        begun: whether every vehicle has told where it is.
        served: visits that vehicles have reported.

    Raises:
        ConfigError: see `FollowedFarm`.
    """

    def __init__(self, config: FarmConfig, seed: int) -> None:
        self.farm = FollowedFarm(config, seed)
        self.begun = False
        self.served = 0
        self._commands = np.zeros((config.world.uavs, 2))
        self._kinds = np.repeat((0, 1, 2), config.world.counts)

    @property
    def steps(self) -> int:
        """Steps of the farm that are over."""
        return int(self.farm.time[0]) if self.begun else 0

    @property
    def over(self) -> bool:
        """Whether the episode is over."""
        return self.begun and bool(self.farm.ended[0])

    def commanded(self, row: int, velocity: tuple[float, float]) -> None:
        """Note the velocity that an agent was commanded last, m/s."""
        self._commands[row] = velocity

    def lose(self, vehicles: Sequence[Vehicle], now: float, since: float) -> None:
        """Take vehicles for lost that say so or have been silent, where the farm loses UAVs.

        Args:
            vehicles: the team.
            now: the pilot's monotonic clock, s.
            since: when the node began to listen, by the same.
        """
        if self.farm.config.loses_uavs:
            for vehicle in vehicles:
                heard = vehicle.began if vehicle.newest is not None else since
                told = vehicle.newest is not None and vehicle.newest.lost
                vehicle.lost |= told or now - heard > LOST_SECONDS

    def begin(self, vehicles: Sequence[Vehicle]) -> bool:
        """Begin with the vehicles where they are; return whether all have told it."""
        if not all(vehicle.lost or vehicle.place is not None for vehicle in vehicles):
            return False
        for vehicle in vehicles:
            list(vehicle.visits())  # what was served before the beginning
        self.farm.begin(self._state(vehicles))
        self.begun = True
        return True

    def follow(self, vehicles: Sequence[Vehicle], steps: int, now: float | None) -> Float32:
        """Take steps over up to the episode's end; return the row of observations [O].

        Args:
            vehicles: the team.
            steps: how many, at least 1.
            now: seconds since 1970, from which time stamps of reports count back; None takes all of them for ones of
                the last step, as those of simulators are.
        """
        last, seconds = self.steps + steps, self.farm.config.world.step_seconds
        for vehicle in vehicles:
            levels = (None, self.farm.plots, self.farm.sensors)[self._kinds[vehicle.row]]
            for item, stamp in vehicle.visits():
                if levels is not None:
                    number = item if levels is self.farm.plots else int(self.farm.sensor_of[item])
                    late = 0 if now is None else max(0, int((now - stamp / 1e6) / seconds))
                    levels.visit(np.array([number], np.int32), max(0, last - late))
                    self.served += 1
        for _ in range(min(steps, self.farm.config.world.steps - self.steps)):
            self.farm.follow(self._state(vehicles, now))
        row: Float32 = self.farm.observation[0]
        return row

    def _state(self, vehicles: Sequence[Vehicle], now: float | None = None) -> TeamState:
        """Return what is known of the vehicles; those that are silent are where they were last."""
        poses = [vehicle.newest for vehicle in vehicles]
        winds = [pose.wind for pose in poses if pose is not None and pose.wind]
        pairs = list(zip(poses, self._commands.tolist(), strict=True))
        return TeamState(
            position=np.array([vehicle.place_at(now) or (0.0, 0.0) for vehicle in vehicles]),
            velocity=np.array([pose.velocity if pose is not None else (0.0, 0.0) for pose in poses]),
            acceleration=np.array([vehicle.acceleration for vehicle in vehicles]),
            command=np.array([pose.commanded if pose is not None and pose.commanded else sent for pose, sent in pairs]),
            charge=np.array([(pose.charge or 0.0) if pose is not None else 0.0 for pose in poses]),
            wind=np.mean(winds, axis=0) if winds else np.zeros(2),
            lost=np.array([vehicle.lost for vehicle in vehicles]),
        )


def team_vehicles(config: FarmConfig, names: dict[str, str], flown: Sequence[str]) -> list[Vehicle]:
    """Return a team's vehicles in the order of its agents.

    Args:
        config: the farm.
        names: each agent's vehicle; others are named as their agents.
        flown: vehicles that this node flies; none for all.
    """
    world = config.world
    items = np.repeat((0, world.plots_x * world.plots_y, world.sensors), world.counts).tolist()
    heights = world.height_communication, world.height_monitoring, world.height_collection
    height = np.repeat(heights, world.counts).tolist()
    agents = farm_team(config).agent_names
    vehicles = [
        Vehicle(names.get(agent, agent), agent, row, items[row], height[row]) for row, agent in enumerate(agents)
    ]
    for vehicle in vehicles:
        vehicle.flown = not flown or vehicle.name in flown
    return vehicles
