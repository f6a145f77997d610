"""A flight's map: with the simulator as the vehicles, its observations and decisions are the simulator's own."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest

from eia_sec.common.actors import TeamActors
from eia_sec.common.config.presets import PRESETS
from eia_sec.common.errors import ConfigError
from eia_sec.common.farm import farm_team
from eia_sec.common.protocol import keys
from eia_sec.common.protocol.messages import Envelope
from eia_sec.deploy.flight.deciders import HeuristicDecider
from eia_sec.deploy.flight.simulator import SimulatedFleet
from eia_sec.deploy.flight.vehicle import VehicleLink
from eia_sec.rollout.evaluation import episode_seed
from eia_sec.rollout.followed_farm import FollowedFarm, Levels
from eia_sec.rollout.heuristics.farms import make_farms
from eia_sec.rollout.heuristics.registry import heuristic
from eia_sec.rollout.policies import ActorPolicy
from tests.deploy.flight.air import Air, Clock, make_pilot

RUN, FARM = "run", 1003


class Flown:
    """An episode that a pilot flies in lockstep with the simulator; a period passes whenever the simulator waits.

    Attributes:
        flight: what the simulator says.
        pilot: the pilot.
        rows: its observations in each step.
    """

    def __init__(self, config, decider, steps=None, loss=0.0):
        self._clock, air, self.rows = Clock(), Air(), []
        self._random, self._loss = np.random.default_rng(0), loss
        self.pilot = make_pilot(config, decider, seed=FARM, lockstep=True, clock=self._clock)
        fastest = config.world.speed_x_max, config.world.speed_y_max
        names = list(self.pilot.vehicles)
        links = {v: VehicleLink(air, RUN, v, v, fastest, self._clock, self._clock) for v in names}
        self._incoming = {v: air.subscribe(keys.POSE.key(RUN, vehicle=v), 16) for v in names}
        self._outgoing = {v: air.publish(keys.SETPOINT.key(RUN, vehicle=v)) for v in names}
        stop = _Never(event=SimpleNamespace(wait=self._period))
        self.flight = SimulatedFleet(config, links, 600.0, self._clock).fly(FARM, 0, stop, steps)
        self._loss = 0.0
        self._period(0.0)

    def _period(self, seconds):
        self._clock.now += 0.02
        for vehicle, incoming in self._incoming.items():
            for sample in incoming.drain():
                if self._random.random() >= self._loss:
                    self.pilot.offer(vehicle, sample.payload, sample.attachment, self._clock.now)
        before = self.pilot.map.begun, self.pilot.map.steps
        found = self.pilot.decide(self._clock.now)
        if before != (self.pilot.map.begun, self.pilot.map.steps):
            self.rows.append(self.pilot.map.farm.observation[0].copy())
        for vehicle, message in found.items():
            if self._random.random() >= self._loss:
                sender = Envelope("flight", "main", 1, message.period)
                self._outgoing[vehicle].put(message.encode(), sender.encode())


class _Never(SimpleNamespace):
    """A stop signal that nobody gives."""

    def __bool__(self):
        return False


def alone(config, policy, steps):
    """Return the observations and actions of the same episode inside the simulator, and its summary."""
    farms, rows, actions = make_farms(config, 1), [], []
    farms.reset(0, FARM, episode_seed(FARM, 0))
    policy.reset(farms, 0)
    for _ in range(steps):
        rows.append(farms.observation[0].copy())
        gone = farms.gone[0].copy()
        action = policy.act(farms)[0]
        farms.step(action[None])
        actions.append(np.where(np.repeat(gone, 2), np.float32(0.0), action))
    rows.append(farms.observation[0].copy())
    return np.stack(rows), np.stack(actions), farms.summary(0)


def bold(config, memory="none"):
    """Return actors that move."""
    actors = TeamActors.initial(farm_team(config), 16, 5, per_type=False, memory=memory)
    for parameters in actors.flat:
        np.multiply(parameters, 8.0, out=parameters)
    return actors


def of(name):
    """Return the farm of a preset, without patches of stress."""
    farm = PRESETS[name].farm
    return dataclasses.replace(farm, stress=dataclasses.replace(farm.stress, patches=0))


def equal(flown, config, policy, steps):
    """Compare a flight with the simulator alone; return True."""
    rows, actions, summary = alone(config, policy, steps)
    assert len(flown.rows) == steps + 1
    assert np.stack(flown.rows).tobytes() == rows.tobytes()
    assert np.stack(flown.flight.actions).tobytes() == actions.tobytes()
    assert flown.flight.summary == summary
    assert flown.pilot.map.served > 0
    return True


@pytest.mark.parametrize("name", ["instant", "inertial", "failing"])
def test_whole_episodes_are_those_of_the_simulator_bit_for_bit(name):
    """Observations, actions and result are equal; UAVs with inertia, and ones that fail, too."""
    config = of(name)
    actors = bold(config)
    flown = Flown(config, actors)
    assert flown.pilot.over
    assert np.abs(np.stack(flown.flight.actions)).max() > 0.5
    assert equal(flown, config, ActorPolicy(actors), config.world.steps)


@pytest.mark.parametrize("name", ["paper", "long", "connected", "eia-sec", "battery", "field", "uneven"])
def test_all_that_presets_observe_is_known_to_the_map(name):
    """Plans, routes, links, charge, wind and zones follow from poses and reports."""
    config = of(name)
    actors = bold(config)
    assert equal(Flown(config, actors, 60), config, ActorPolicy(actors), 60)


def test_sensors_are_known_by_their_place_in_the_farms_file():
    """Measured positions are numbered as their list is, whatever the simulator's own order is."""
    base = of("eia-sec")
    places = np.random.default_rng(4).uniform(0.0, 400.0, (base.world.sensors, 2)).round(1)
    world = dataclasses.replace(base.world, sites=tuple((x, y) for x, y in places.tolist()))
    config = dataclasses.replace(base, world=world)
    farm = FollowedFarm(config, FARM)
    np.testing.assert_array_equal(farm.layout(0).sensor_xy[farm.sensor_of], places)
    assert (farm.sensor_of != np.arange(base.world.sensors)).any()
    actors = bold(config)
    assert equal(Flown(config, actors, 30), config, ActorPolicy(actors), 30)


def test_memory_takes_a_step_for_each_of_the_farm():
    """Actors with memory decide as in one process, however many periods a step has."""
    config = of("eia-sec")
    actors = bold(config, "gru")
    assert equal(Flown(config, actors, 30), config, ActorPolicy(actors), 30)


@pytest.mark.parametrize("name", ["lawnmower", "greedy"])
def test_heuristics_fly_as_in_the_simulator(name):
    """They read the map instead of observations."""
    config = of("inertial")
    assert equal(Flown(config, HeuristicDecider(heuristic(name, config)), 40), config, heuristic(name, config), 40)


def test_lost_messages_change_nothing():
    """With a fifth of all messages lost either way, the flight is the same."""
    base = of("eia-sec")
    config = dataclasses.replace(base, world=dataclasses.replace(base.world, vdf_cycle=3, sensor_cycles=(3,)))
    actors = bold(config)
    flown = Flown(config, actors, 12, loss=0.2)
    assert flown.flight.resent > 0
    assert equal(flown, config, ActorPolicy(actors), 12)


def test_levels_follow_from_the_last_visit():
    """A level counts its rises since the last visit, up to the largest; the order of reports does not matter."""
    levels = Levels(np.array([3, 10, 2**30]), np.array([0.0, 2.0, 1.0]), 4)
    assert levels.at(0).tolist() == [0.0, 2.0, 1.0]
    assert levels.at(9).tolist() == [3.0, 2.0, 1.0]
    assert levels.at(100).tolist() == [4.0, 4.0, 1.0]
    assert levels.due(9).tolist() == [12, 10, 2**30]
    levels.visit(np.array([0, 1], np.int32), 9)
    levels.visit(np.array([0], np.int32), 4)
    assert levels.at(9).tolist() == [0.0, 0.0, 1.0]
    assert levels.at(15).tolist() == [2.0, 1.0, 1.0]


def test_patches_of_stress_are_refused():
    """Nobody maps them, so a flight over such a farm does not begin."""
    with pytest.raises(ConfigError, match=r"farm\.stress\.patches"):
        FollowedFarm(PRESETS["uneven"].farm, 0)
