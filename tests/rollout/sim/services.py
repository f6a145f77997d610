"""Every service of a plot or a sensor in an episode, and the same episode with some of them left out."""

import itertools
from collections import defaultdict
from dataclasses import dataclass

import numpy as np

from eia_sec.rollout.sim.reference.farm import ReferenceFarm
from tests.rollout.sim.properties.strategies import Flight, placed

Item = tuple[int, ...]
"""(column, row) of a plot, or (number,) of a sensor."""
UTILITY = 4
"""Column of the reward's parts."""


@dataclass(frozen=True)
class Service:
    """A good image or a delivered packet.

    Attributes:
        step: from 1.
        agent: row index of the UAV.
        value: the counter that it found.
    """

    step: int
    agent: int
    value: float


class LoggedFarm(ReferenceFarm):
    """A reference farm that logs its services.

    Args:
        flight: what will be flown.
        left_out: (step, item) of services that do not happen.

    Attributes:
        services: of each item, in order.
        due: the steps at which each item's counter is due to rise.
        earned: utility parts of the rewards, summed over steps and UAVs.
    """

    def __init__(self, flight: Flight, left_out: frozenset[tuple[int, Item]] = frozenset()) -> None:
        self.services: dict[Item, list[Service]] = defaultdict(list)
        self.due: dict[Item, set[int]] = defaultdict(set)
        self.earned = 0.0
        self._left_out = left_out
        layout = flight.layout()
        with placed(layout, flight.positions()):
            super().__init__(flight.config, layout, flight.episode)

    def step(self, action: np.ndarray, assignment: np.ndarray | None = None) -> None:
        super().step(action, assignment)
        self.earned += self.parts[:, UTILITY].sum()

    def _serve(self, counter: np.ndarray, item: Item, u: int, share: float, due: bool, cap: int) -> None:
        if due:
            self.due[item].add(self.time)
        if (self.time, item) in self._left_out:
            share = 0.0
        if share > 0.0:
            assert share == 1.0
            self.services[item].append(Service(self.time, u, counter[item]))
        super()._serve(counter, item, u, share, due, cap)

    def visits(self, item: Item) -> list[list[Service]]:
        """Return the visits of an item: each begins with a service that pays, the ones that pay nothing follow it."""
        visits: list[list[Service]] = []
        for service in self.services[item]:
            if service.value > 0.0:
                visits.append([service])
            elif visits:
                visits[-1].append(service)
        return visits

    def corrections(self) -> np.ndarray:
        """Return what hindsight adds to the rewards, [T, n]: what the next visit would be paid more without this one.

        Counts the counter on from each visit, step by step, as if nobody had come until the next visit.
        """
        world, weights = self.config.world, self.config.reward
        found = np.zeros((world.steps, world.uavs))
        for item in self.services:
            plot = len(item) == 2
            cap = world.vdf_max if plot else world.aoi_max
            unit = (weights.monitoring if plot else weights.collection) * world.step_seconds
            visits = self.visits(item)
            for (visit, *_), (following, *_) in itertools.pairwise(visits):
                counter = visit.value
                for step in range(visit.step, following.step):
                    counter = min(counter + (step in self.due[item]), cap)
                found[visit.step - 1, visit.agent] -= unit * (counter - following.value)
        return found

    def services_of(self, agent: int, step: int) -> frozenset[tuple[int, Item]]:
        """Return (step, item) of all services of the visits that an agent began in a step."""
        return frozenset(
            (service.step, item)
            for item in list(self.services)
            for visit in self.visits(item)
            if (visit[0].agent, visit[0].step) == (agent, step)
            for service in visit
        )
