"""Actors with memory in flight: one step for each observation that they decided on, however often it comes."""

import dataclasses

import numpy as np
import pytest

from eia_sec.common.actors import TeamActors
from eia_sec.common.config.presets import preset
from eia_sec.common.farm import farm_team
from eia_sec.common.protocol.messages import Envelope, ObservationMessage
from eia_sec.deploy.flight.pilot import Limits, Pilot

TEAM = farm_team(preset("study").farm)
ACTORS = TeamActors.initial(TEAM, 16, 7, per_type=False, memory="gru")
ACTORS = dataclasses.replace(ACTORS, flat=tuple(flat * np.float32(4.0) for flat in ACTORS.flat))
NOW = 1_700_000_000.0
SPEED = (10.0, 8.3)
NAMES = TEAM.agent_names


def row(step):
    return np.random.default_rng(step).uniform(-1, 1, (1, TEAM.observation_size)).astype(np.float32)


def offer(pilot, step, agents=NAMES, *, start=1, number=None, delay=0.0):
    """Let vehicles observe a step of an episode."""
    seen = [agent for part in TEAM.split_observations(row(step)) for agent in part[0]]
    for agent, values in zip(NAMES, seen, strict=True):
        if agent in agents:
            message = ObservationMessage(agent, int((NOW + delay) * 1e6), np.ascontiguousarray(values))
            envelope = Envelope("vehicle", agent, start, number or step)
            assert pilot.offer(agent, message.encode(), envelope.encode(), NOW)


def flown(pilot):
    """Return what the next period commands, as shares of full speed; hover is not a number."""
    found = pilot.decide(NOW)
    return np.array([(np.nan, np.nan) if found[a].hover else found[a].velocity for a in NAMES]) / SPEED


def alone(steps):
    """Return the actions of an episode inside one process."""
    state = ACTORS.initial_state(1)
    return [ACTORS.environment_actions(row(step), state)[0].reshape(-1, 2) for step in steps]


@pytest.fixture
def pilot():
    return Pilot(ACTORS.copy(), {name: name for name in NAMES}, SPEED, Limits(hold=2))


def test_an_episode_is_flown_as_in_one_process(pilot):
    """With an observation in every period, decisions are bit-equal to those of actors that go through the episode."""
    for step, wanted in enumerate(alone(range(1, 9)), 1):
        offer(pilot, step)
        assert flown(pilot).astype(np.float32).tobytes() == wanted.tobytes()


def test_a_decision_is_repeated_and_not_a_step(pilot):
    """An observation that is held, or repeated under its number, gets the same decision; the next one goes on."""
    wanted = alone(range(1, 6))
    for step in range(1, 6):
        offer(pilot, step)
        for period in range(3):
            np.testing.assert_array_equal(flown(pilot).astype(np.float32), wanted[step - 1])
            offer(pilot, step, delay=0.1 * (period + 1))


def test_who_hovers_remembers_what_it_decided_on(pilot):
    """An agent without observations for a while goes on from its last decision; the others are not disturbed."""
    for step in range(1, 4):
        offer(pilot, step)
        flown(pilot)
    for step in range(4, 7):
        offer(pilot, step, NAMES[1:])
        last = flown(pilot)
    assert np.isnan(last[0]).all()
    np.testing.assert_array_equal(last[1:].astype(np.float32), alone(range(1, 7))[-1][1:])
    offer(pilot, 7)
    found = flown(pilot).astype(np.float32)
    np.testing.assert_array_equal(found[0], alone([1, 2, 3, 7])[-1][0])
    np.testing.assert_array_equal(found[1:], alone(range(1, 8))[-1][1:])


def test_a_new_start_begins_an_episode(pilot):
    """A vehicle that starts again is remembered no more, while the others go on."""
    for step in range(1, 4):
        offer(pilot, step)
        flown(pilot)
    offer(pilot, 4, NAMES[1:])
    offer(pilot, 4, NAMES[:1], start=2, number=1)
    found = flown(pilot).astype(np.float32)
    np.testing.assert_array_equal(found[0], alone([4])[-1][0])
    np.testing.assert_array_equal(found[1:], alone(range(1, 5))[-1][1:])
    assert np.abs(alone([4])[-1][0] - alone(range(1, 5))[-1][0]).max() > 1e-3


def test_what_is_not_finite_is_not_remembered(pilot):
    """An agent whose output overflowed once hovers, and decides again on the next observation."""
    offer(pilot, 1)
    flown(pilot)
    parameters = pilot._actors.flat[0]
    parameters[:] = np.random.default_rng(0).choice(np.float32([3e38, -3e38]), parameters.shape)
    offer(pilot, 2)
    with np.errstate(all="ignore"):
        assert np.isnan(flown(pilot)[0]).all()
    parameters[:] = ACTORS.flat[0]
    offer(pilot, 3)
    np.testing.assert_array_equal(flown(pilot).astype(np.float32)[0], alone([1, 3])[-1][0])
