"""The pilot: what it refuses, when it commands hover, and that its numbers are those of the actors."""

import dataclasses

import numpy as np
import pytest

from eia_sec.common.actions.adapters import SIGNS
from eia_sec.common.actors import TeamActors
from eia_sec.common.config import ControlConfig, FarmConfig, ObservationConfig
from eia_sec.common.config.presets import preset
from eia_sec.common.errors import ConfigError
from eia_sec.common.farm import farm_team
from eia_sec.common.protocol import frame
from eia_sec.common.protocol.messages import Envelope, ObservationMessage, SetpointMessage
from eia_sec.common.protocol.metrics import undeclared
from eia_sec.deploy.flight.pilot import LARGEST, ROWS, Limits, Pilot

TEAM = farm_team(preset("study").farm)
ACTORS = TeamActors.initial(TEAM, 16, 7, per_type=False)
NOW = 1_700_000_000.0
SPEED = (10.0, 8.3)
UAV, AGENT, SIZE = "uav-7", "collection_1", TEAM.groups[2].observation_size


def make(**limits) -> Pilot:
    return Pilot(ACTORS, {UAV: AGENT, "other": "monitoring_0"}, SPEED, Limits(**limits))


def seen(seed: int = 0, size: int = SIZE) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-1, 1, size).astype(np.float32)


def offer(pilot: Pilot, sequence: int, *, now: float = NOW, start: int = 1, values=None, **changes) -> bool:
    message = ObservationMessage(AGENT, int(NOW * 1e6), seen(sequence) if values is None else values)
    envelope = Envelope("vehicle", UAV, start, sequence)
    return pilot.offer(UAV, dataclasses.replace(message, **changes).encode(), envelope.encode(), now)


def test_set_points_are_the_actors_actions_in_metres_per_second():
    """A decision is what the whole team's actors would do, times the largest speed, and gives back the very action."""
    pilot = make()
    rng = np.random.default_rng(3)
    place = TEAM.observation_slices()[2].start + SIZE
    for sequence in range(1, 30):
        row = rng.uniform(-1, 1, (1, TEAM.observation_size)).astype(np.float32)
        assert offer(pilot, sequence, values=row[0, place : place + SIZE])
        found = pilot.decide(NOW)[UAV]
        wanted = ACTORS.act(row)[0].reshape(-1, 2)[TEAM.agent_names.index(AGENT)]
        assert (np.array(found.velocity) / SPEED).astype(np.float32).tobytes() == wanted.tobytes()
        assert (found.hover, found.answers, found.stamp, found.period) == (False, sequence, int(NOW * 1e6), sequence)
        assert found.latency > 0


@pytest.mark.parametrize("bad", [0.0, 0.5, -4.0])
def test_a_mirrored_agents_signs_are_1_or_minus_1(bad):
    """Others are refused, and the set-point of what is accepted points along the field's axes."""
    team = farm_team(preset("eia-sec").farm)
    actors = TeamActors.initial(team, 16, 7, per_type=False)
    pilot = Pilot(actors, {UAV: AGENT}, SPEED, Limits())
    size = team.groups[2].observation_size
    values, row = seen(1, size), np.zeros((1, team.observation_size), np.float32)
    values[SIGNS] = 1.0, bad
    assert not offer(pilot, 1, values=values)
    assert "signs" in pilot.decide(NOW)[UAV].reason
    values[SIGNS] = 1.0, -1.0
    assert offer(pilot, 2, values=values)
    place = team.observation_slices()[2].start + size
    row[0, place : place + size] = values
    across, along = actors.act(row)[0].reshape(-1, 2)[team.agent_names.index(AGENT)]
    np.testing.assert_allclose(pilot.decide(NOW)[UAV].velocity, (across * SPEED[0], -along * SPEED[1]), rtol=1e-6)


@pytest.mark.parametrize("hold", [1, 3])
def test_hover_follows_in_the_period_after_the_last_that_an_observation_serves(hold):
    """When observations stop, hover is commanded `hold` periods after the last one came: with 1, in the very next."""
    pilot = make(hold=hold)
    for sequence in range(1, 6):
        offer(pilot, sequence)
        assert not pilot.decide(NOW)[UAV].hover
    last = pilot.period
    courses = [pilot.decide(NOW)[UAV] for _ in range(hold + 2)]
    assert [message.period - last for message in courses if message.hover] == list(range(hold, hold + 3))
    assert all(message.velocity == (0.0, 0.0) for message in courses if message.hover)
    assert courses[hold - 1].reason == f"no observation for {hold} period{'s' if hold > 1 else ''}"
    offer(pilot, 6)
    assert not pilot.decide(NOW)[UAV].hover


def test_a_vehicle_that_never_observed_hovers_while_another_flies():
    """Each vehicle is judged alone."""
    pilot = make()
    offer(pilot, 1)
    found = pilot.decide(NOW)
    assert (found[UAV].hover, found["other"].hover) == (False, True)
    assert found["other"].reason == "no observation has come yet"


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"values": seen(size=SIZE - 1)}, "shape"),
        ({"values": np.full(SIZE, np.nan, np.float32)}, "not finite"),
        ({"values": np.full(SIZE, np.inf, np.float32)}, "not finite"),
        ({"values": np.full(SIZE, 2 * LARGEST, np.float32)}, "is it scaled"),
        ({"agent": "collection_0"}, "for agent 'collection_0'"),
        ({"stamp": int((NOW - 1.5) * 1e6)}, "1.5 s old"),
        ({"stamp": int((NOW + 1.5) * 1e6)}, "1.5 s ahead"),
        ({"sequence": 3}, "not newer"),
        ({"sequence": 9, "start": 0}, "not newer"),
    ],
)
def test_what_cannot_be_used_is_refused_and_the_vehicle_hovers(changes, reason):
    """Wrong shape, agent, numbers, time or order: counted, named, and hover in the same period."""
    pilot = make()
    assert offer(pilot, 3)
    assert not pilot.decide(NOW)[UAV].hover
    assert not offer(pilot, **{"sequence": 4, **changes})
    found = pilot.decide(NOW)[UAV]
    assert found.hover
    assert reason in found.reason
    assert pilot.report()["refused"] == 1
    assert offer(pilot, 5)
    assert not pilot.decide(NOW)[UAV].hover


def test_a_start_number_from_the_future_shuts_no_vehicle_out():
    """A vehicle whose clock was ahead when it started before, or whose number was forged, flies again after `age`."""
    pilot = make(age=1.0)
    assert offer(pilot, 7, start=2**63 - 1)
    assert not offer(pilot, 1, start=5)
    later = NOW + 1.5
    assert offer(pilot, 2, start=5, now=later, stamp=int(later * 1e6))
    assert not pilot.decide(later)[UAV].hover
    assert not offer(pilot, 1, start=5, now=later, stamp=int(later * 1e6))


def test_bytes_that_are_no_observation_are_refused():
    """Junk, another kind of message, and an envelope of somebody else never raise, and never fly."""
    pilot = make()
    whole = ObservationMessage(AGENT, int(NOW * 1e6), seen()).encode()
    mine, foreign = Envelope("vehicle", UAV, 1, 1), Envelope("vehicle", "other", 1, 1)
    for payload, attachment in (
        (b"", b""),
        (b"junk", mine.encode()),
        (whole, b"junk"),
        (whole, foreign.encode()),
        (whole, Envelope("rollout", UAV, 1, 1).encode()),
        (mine.encode(), mine.encode()),
        (frame.encode(ObservationMessage.KIND, {"agent": AGENT, "stamp": 1}, {}), mine.encode()),
    ):
        assert not pilot.offer(UAV, payload, attachment, NOW)
    assert pilot.decide(NOW)[UAV].hover
    assert pilot.report()["refused"] == 7


def test_an_observation_that_grows_old_while_it_is_held_is_not_flown_on():
    """With a long hold, the stamp's age at the moment of the decision still counts."""
    pilot = make(hold=100, age=1.0)
    offer(pilot, 1)
    assert not pilot.decide(NOW + 0.9)[UAV].hover
    late = pilot.decide(NOW + 1.1)[UAV]
    assert late.hover
    assert "too old: it is 1.1 s old" in late.reason


def test_a_restarted_vehicle_begins_its_numbers_anew():
    """A higher incarnation is newer whatever its sequence number; gaps inside one are counted."""
    pilot = make()
    offer(pilot, 1)
    offer(pilot, 5)
    assert pilot.report()["missed"] == 3
    assert offer(pilot, 1, start=2)
    assert not pilot.decide(NOW)[UAV].hover
    assert pilot.report()["missed"] == 3


def test_an_output_that_is_not_finite_is_never_flown():
    """Actors whose arithmetic overflows command hover."""
    broken = ACTORS.copy()
    for flat in broken.flat:
        flat[:] = np.random.default_rng(0).choice(np.float32([3e38, -3e38]), flat.shape)
    pilot = Pilot(broken, {UAV: AGENT}, SPEED, Limits())
    offer(pilot, 1)
    with np.errstate(all="ignore"):
        found = pilot.decide(NOW)[UAV]
    assert (found.hover, found.velocity) == (True, (0.0, 0.0))
    assert "not finite" in found.reason


def test_agents_must_exist_and_fly_one_vehicle_each():
    """An unknown agent, and one agent for two vehicles, are refused at the start."""
    with pytest.raises(ConfigError, match="no agent 'collection_9'"):
        Pilot(ACTORS, {"a": "collection_9"}, SPEED, Limits())
    with pytest.raises(ConfigError, match="same agent"):
        Pilot(ACTORS, {"a": AGENT, "b": AGENT}, SPEED, Limits())


def test_the_report_is_bounded_declared_and_names_who_hovers():
    """Its metrics are those of `common.protocol.metrics`, at most ROWS vehicles one by one, hovering ones first."""
    farm = preset("study").farm
    wide = dataclasses.replace(farm.world, communication_uavs=20, monitoring_uavs=20, collection_uavs=20)
    team = farm_team(dataclasses.replace(farm, world=wide))
    actors = TeamActors.initial(team, 4, 0)
    pilot = Pilot(actors, {name: name for name in team.agent_names}, SPEED, Limits())
    for index in range(2, 60):
        name = team.agent_names[index]
        size = next(group.observation_size for group in team.groups if name.startswith(group.name))
        message = ObservationMessage(name, int(NOW * 1e6), seen(size=size))
        assert pilot.offer(name, message.encode(), Envelope("vehicle", name, 1, 1).encode(), NOW)
    found = pilot.decide(NOW)
    report = pilot.report()
    assert undeclared("flight", report) == []
    assert len(report["vehicles"]) == ROWS
    assert list(report["vehicles"])[:2] == ["communication_0", "communication_1"]
    assert report["alarms"] == ["communication_0, communication_1 hover: no observation has come yet."]
    assert (report["decisions"], report["hovers"]) == (58, 2)
    assert report["latency"]["median"] <= report["latency"]["p99"] <= report["latency"]["most"]
    assert all(isinstance(message, SetpointMessage) for message in found.values())
    ended = pilot.hover("the flight node ends")
    assert all(message.hover for message in ended.values())
    assert pilot.report()["alarms"] == ["communication_0, communication_1 and 58 others hover: the flight node ends."]


CHOICES = ControlConfig(communication="headings", monitoring="moves", collection="moves")
"""Discrete control of every type."""


@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize("shared", [False, True])
def test_choices_become_set_points(mirrored, shared):
    """Moves and headings fly as velocities, with one row of parameters too, bit-equal to the actors' own."""
    team = farm_team(FarmConfig(control=CHOICES, observation=ObservationConfig(mirrored=mirrored)))
    actors = TeamActors.initial(team, 16, 7, per_type=False, shared=shared)
    pilot = Pilot(actors, {name: name for name in team.agent_names}, SPEED, Limits())
    draw, found = np.random.default_rng(3), []
    for sequence in range(1, 20):
        row = draw.uniform(-1, 1, (1, team.observation_size)).astype(np.float32)
        for own in team.split_observations(row):
            own[..., SIGNS] = draw.choice([-1.0, 1.0], own[..., SIGNS].shape)
        each = [agent for part in team.split_observations(row) for agent in part[0]]
        for name, values in zip(team.agent_names, each, strict=True):
            message = ObservationMessage(name, int(NOW * 1e6), np.ascontiguousarray(values))
            assert pilot.offer(name, message.encode(), Envelope("vehicle", name, 1, sequence).encode(), NOW)
        flown = np.array([message.velocity for message in pilot.decide(NOW).values()])
        wanted = actors.environment_actions(row)[0].reshape(-1, 2)
        np.testing.assert_array_equal((flown / SPEED).astype(np.float32), wanted)
        found.append(flown)
    assert len(np.unique(np.concatenate(found).round(3), axis=0)) > 5


def test_logits_that_are_not_finite_are_never_flown():
    """The largest of them would be an option like any other."""
    team = farm_team(FarmConfig(control=CHOICES, observation=ObservationConfig(mirrored=False)))
    broken = TeamActors.initial(team, 16, 7)
    broken.flat[2][:] = np.random.default_rng(0).choice(np.float32([3e38, -3e38]), broken.flat[2].shape)
    pilot = Pilot(broken, {UAV: AGENT, "other": "monitoring_0"}, SPEED, Limits())
    size = {group.name: group.observation_size for group in team.groups}
    other = ObservationMessage("monitoring_0", int(NOW * 1e6), seen(size=size["monitoring"]))
    assert offer(pilot, 1, values=seen(size=size["collection"]))
    assert pilot.offer("other", other.encode(), Envelope("vehicle", "other", 1, 1).encode(), NOW)
    with np.errstate(all="ignore"):
        found = pilot.decide(NOW)
    assert "not finite" in found[UAV].reason
    assert (found[UAV].hover, found["other"].hover) == (True, False)
