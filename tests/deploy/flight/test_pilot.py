"""The pilot: which poses it refuses, when it commands hover and why, and what its set-points hold."""

import dataclasses

import numpy as np
import pytest

from eia_sec.common.actors import TeamActors
from eia_sec.common.config import ControlConfig, DynamicsConfig, FarmConfig, ObservationConfig
from eia_sec.common.config.presets import preset
from eia_sec.common.errors import ConfigError
from eia_sec.common.farm import farm_team
from eia_sec.common.protocol import frame
from eia_sec.common.protocol.messages import PoseMessage
from eia_sec.common.protocol.metrics import METRICS, undeclared
from eia_sec.deploy.flight.border import inside_border
from eia_sec.deploy.flight.pilot import CAUSES, ROWS, require_agents
from eia_sec.rollout.farm_files.projection import TangentPlane
from tests.deploy.flight.air import NOW, Clock, agents, envelope, make_pilot

WORLD = dataclasses.replace(preset("study").farm.world, communication_uavs=1, monitoring_uavs=2, collection_uavs=2)
FARM = dataclasses.replace(preset("study").farm, world=WORLD)
UAV, OTHER = "monitoring_0", "collection_1"
NONE_32, NONE_64 = np.zeros(0, np.int32), np.zeros(0, np.int64)


class Constant:
    """Decides the same velocity for every agent, and counts its decisions."""

    def __init__(self, share=(0.5, -0.25), agent_count=5):
        self.shares, self.decided = np.tile(np.float32(share), (agent_count, 1)), 0

    def begin(self, farm):
        """Nothing to prepare."""

    def decide(self, farm):
        """Return the velocity."""
        self.decided += 1
        return self.shares


def pose(agent, now=NOW, place=(200.0, 150.0), **changes) -> PoseMessage:
    """Return a pose in the field."""
    whole = PoseMessage(
        agent, int(now * 1e6), place, False, 20.0, (0.0, 0.0), (), (), None, (), False, 0, "", 0, "", NONE_32, NONE_64
    )
    return dataclasses.replace(whole, **changes)


class Team:
    """A pilot, and vehicles that tell where they are."""

    def __init__(self, config=FARM, decider=None, **options):
        self.clock, self.sequence = Clock(0.0), 0
        self.decider = decider or Constant()
        self.pilot = make_pilot(config, self.decider, clock=self.clock, **options)

    @property
    def now(self):
        """Seconds since 1970."""
        return NOW + self.clock.now

    def tell(self, *but, **changes):
        """Let every vehicle but some tell its pose; return whether all are used."""
        self.sequence += 1
        return all(
            [
                self.offer(name, vehicle.agent, **changes)
                for name, vehicle in self.pilot.vehicles.items()
                if name not in but
            ]
        )

    def offer(self, name, agent=None, sequence=None, start=1, late=0.0, **changes):
        """Let one vehicle tell its pose."""
        message = pose(agent or name, self.now - late, **changes)
        return self.pilot.offer(name, message.encode(), envelope(name, sequence or self.sequence, start), self.now)

    def period(self, seconds=0.1):
        """Let time pass and return the set-points of a period."""
        self.clock.now += seconds
        return self.pilot.decide(self.now)


def test_a_set_point_holds_the_decision_and_what_follows_from_it():
    """Velocity, target, height, number and validity; all of a step's periods repeat one decision."""
    team = Team(validity=0.4)
    team.tell()
    found = [team.period()[UAV]]
    for _ in range(25):
        team.tell()
        found.append(team.period()[UAV])
    first = found[0]
    assert first.velocity == (0.5 * WORLD.speed_x_max, -0.25 * WORLD.speed_y_max)
    assert first.target == (200.0 + first.velocity[0], 150.0 + first.velocity[1])
    assert (first.height, first.validity, first.hover, first.reason) == (WORLD.height_monitoring, 0.4, False, "")
    assert first.action == (0.5, -0.25)
    assert [message.period for message in found] == list(range(1, 27))
    numbers = [message.decision for message in found]
    assert numbers[0] == 1
    assert sorted(set(numbers)) == [1, 2, 3]
    assert team.decider.decided == 3
    assert numbers == sorted(numbers)
    assert 9 <= numbers.count(2) <= 11


def test_the_flight_begins_when_every_vehicle_has_told_where_it_is():
    """Until then all hover, and the reason names who is missing."""
    team = Team()
    team.tell(OTHER)
    found = team.period()
    assert all(message.hover for message in found.values())
    assert found[OTHER].reason == "no pose has come yet"
    assert found[UAV].reason == f"the flight begins with the first pose of {OTHER}"
    assert (team.pilot.map.begun, team.decider.decided) == (False, 0)
    team.tell()
    assert not any(message.hover for message in team.period().values())


def test_steps_that_were_slept_through_are_taken_over():
    """Counters follow from the clock, so after a pause the map is where it would be."""
    team = Team()
    team.tell()
    team.period()
    team.clock.now += 7.0
    team.sequence += 1
    stamp = int((team.now - 0.5) * 1e6)
    assert team.offer(UAV, served=np.array([3], np.int32), served_stamp=np.array([stamp]))
    team.tell(UAV)
    team.period()
    assert team.pilot.map.steps == 7
    assert team.decider.decided == 2
    assert team.pilot.map.farm.plots._visit[3] == 7


def test_the_map_has_vehicles_where_they_have_flown_since_their_poses():
    """A pose that is 0.4 s old tells where the vehicle was; one that cannot be trusted tells no way."""
    team = Team()
    team.tell()
    team.period()
    team.clock.now += 0.9
    team.tell(OTHER, late=0.4, place=(204.0, 150.0), velocity=(8.0, -5.0))
    team.offer(OTHER, late=0.4, place=(700.0, 150.0), velocity=(8.0, 0.0))
    team.period()
    rows = {name: vehicle.row for name, vehicle in team.pilot.vehicles.items()}
    assert team.pilot.map.steps == 1
    position = team.pilot.map.farm.position[0]
    # 0.4 s and the period of 0.1 s
    np.testing.assert_allclose(position[rows[UAV]], (204.0 + 0.5 * 8.0, 150.0 - 0.5 * 5.0), atol=1e-3)
    np.testing.assert_allclose(position[rows[OTHER]], (200.0, 150.0))


def test_set_points_are_no_faster_than_the_farms_uavs():
    """With inertia its simulator holds commands to the top speed over ground of the type, and so does the pilot."""
    dynamics = DynamicsConfig("inertial", speed=(8.4, 7.0, 6.0))
    team = Team(dataclasses.replace(FARM, dynamics=dynamics), Constant((1.0, -0.25)))
    team.tell()
    found = team.period()
    assert [found[name].velocity for name in ("communication_0", UAV, OTHER)] == [(8.4, -2.5), (7.0, -2.5), (6.0, -2.5)]
    assert found[UAV].action == (1.0, -0.25)
    np.testing.assert_allclose(team.pilot.map._commands[:2], [(8.4, -2.5), (7.0, -2.5)])


def test_reports_set_counters_to_0_in_the_step_in_which_they_were_served():
    """A report that comes steps later counts in the step of its time stamp; repeated ones count once."""
    quick = dataclasses.replace(FARM, world=dataclasses.replace(WORLD, vdf_cycle=3, sensor_cycles=(3,)))
    team = Team(quick)
    team.tell()
    team.period(0.0)
    for _ in range(10):
        team.tell()
        team.period(1.0)
    farm = team.pilot.map.farm
    assert farm.vdf[0, 0, 0] == farm.vdf[0, 2, 5] == 3.0
    stamp = int((NOW + 4.5) * 1e6)  # in the fifth step, so VDF has risen in steps 6 and 9 since
    report = {"served": np.array([2 * WORLD.plots_y + 5], np.int32), "served_stamp": np.array([stamp])}
    for _ in range(2):
        team.sequence += 1
        assert team.offer(UAV, **report)
        team.tell(UAV)
        team.period(0.5)
    assert (farm.vdf[0, 0, 0], farm.vdf[0, 2, 5]) == (3.0, 2.0)
    assert team.pilot.map.served == 1


def test_a_vehicle_whose_poses_stop_hovers_and_flies_again():
    """The others go on; the reason says for how long there was none."""
    team = Team(age=1.0)
    team.tell()
    team.period(0.0)
    for _ in range(10):
        team.tell(UAV)
        found = team.period()
    assert not found[UAV].hover
    team.tell(UAV)
    found = team.period()
    assert found[UAV].hover
    assert found[UAV].reason == "no pose for 1.1 s"
    assert found[UAV].target == (200.0, 150.0)
    assert not found[OTHER].hover
    assert team.pilot.report()["causes"]["late"] == 1
    team.tell()
    assert not team.period(1.0)[UAV].hover


def test_a_pose_from_another_field_is_not_flown_on():
    """Far outside the vehicle hovers; a little outside, as after an overshoot, it flies back."""
    team = Team()
    team.tell(place=(2.0, 150.0))
    team.period(0.0)
    team.sequence += 1
    assert team.offer(UAV, place=(-3.0, 150.0))
    team.tell(UAV)
    assert not team.period(0.1)[UAV].hover
    team = Team()
    team.tell(UAV)
    team.offer(UAV, place=(4000.0, 150.0))
    found = team.period()
    assert found[UAV].reason == "it is 3600 m outside the field; is it another one's?"
    assert not team.pilot.map.begun
    assert team.pilot.report()["causes"]["field"] == 1


def test_a_pose_that_jumps_is_not_flown_on_until_it_settles():
    """What no vehicle flies in that time is a jump: counted, named, and over after a second without another."""
    team = Team()
    team.tell()
    team.period(0.0)
    found = []
    for number in range(25):
        team.sequence += 1
        team.offer(UAV, place=(200.0 if number else 300.0, 150.0))
        team.tell(UAV)
        found.append(team.period())
    hovers = [messages[UAV].hover for messages in found]
    assert all(hovers[:11])
    assert not hovers[-1]
    assert found[0][UAV].reason == "its pose jumped by 100 m"
    assert found[0][UAV].target == (200.0, 150.0)
    assert not any(messages[OTHER].hover for messages in found)
    assert team.pilot.report()["jumps"] == 2


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"place": (1.0, 2.0, 3.0)}, "two numbers"),
        ({"velocity": (1e6, 0.0)}, "exceeds 1000"),
        ({"agent": "collection_0"}, "of agent 'collection_0'"),
        ({"late": 1.5}, "1.5 s old"),
        ({"late": -1.5}, "1.5 s ahead"),
        ({"geodetic": True, "place": (51.0, 7.0)}, "--origin"),
        ({"served": np.array([1], np.int32)}, "one list"),
        ({"sequence": 3}, "not newer"),
    ],
)
def test_what_cannot_be_used_is_refused(changes, reason):
    """Wrong numbers, agent, time, order or report: counted, and the reason is told when the poses before grow old."""
    team = Team(age=1.0)
    team.sequence = 2
    team.tell()
    assert not team.period(0.0)[UAV].hover
    team.sequence = 4
    assert not team.offer(UAV, **changes)
    team.tell(UAV)
    assert not team.period(0.5)[UAV].hover
    team.sequence += 1
    team.tell(UAV)
    assert not team.offer(UAV, **changes)
    found = team.period(0.6)[UAV]
    assert found.hover
    assert reason in found.reason
    assert team.pilot.report()["refused"] == 2
    assert team.offer(UAV, sequence=50)
    assert not team.period(0.9)[UAV].hover


def test_latitude_and_longitude_are_places_in_the_field():
    """With the corner's origin, degrees are metres east and north of it."""
    origin = TangentPlane(7.0, 51.0)
    team = Team(origin=origin)
    longitude, latitude = origin.to_degrees(np.array([[120.0, 80.0]]))[0].tolist()
    team.tell(geodetic=True, place=(latitude, longitude))
    team.period()
    np.testing.assert_allclose(team.pilot.map.farm.position[0], [[120.0, 80.0]] * 5, atol=1e-6)
    team.sequence += 1
    assert not team.offer(UAV, geodetic=True, place=(151.0, 7.0))


def test_a_start_number_from_the_future_shuts_no_vehicle_out():
    """A vehicle whose clock was ahead when it started before, or whose number was forged, flies again after `age`."""
    team = Team(age=1.0)
    assert team.offer(UAV, sequence=7, start=2**63 - 1)
    assert not team.offer(UAV, sequence=1, start=5)
    team.clock.now += 1.5
    assert team.offer(UAV, sequence=2, start=5)
    assert not team.offer(UAV, sequence=1, start=5)


def test_bytes_that_are_no_pose_are_refused():
    """Junk, another kind of message, and an envelope of somebody else never raise, and never fly."""
    team = Team()
    whole, mine = pose(UAV).encode(), envelope(UAV, 1)
    for payload, attachment in (
        (b"", b""),
        (b"junk", mine),
        (whole, b"junk"),
        (whole, envelope(OTHER, 1)),
        (mine, mine),
        (frame.encode(PoseMessage.KIND, {"agent": UAV, "stamp": 1}, {}), mine),
    ):
        assert not team.pilot.offer(UAV, payload, attachment, NOW)
    assert team.period()[UAV].hover
    assert team.pilot.report()["refused"] == 6


def test_a_restarted_vehicle_begins_its_numbers_anew():
    """A higher incarnation is newer whatever its sequence number; gaps inside one are counted."""
    team = Team()
    assert team.offer(UAV, sequence=1)
    assert team.offer(UAV, sequence=5)
    assert team.pilot.report()["missed"] == 3
    assert team.offer(UAV, sequence=1, start=2)
    assert team.pilot.report()["missed"] == 3


@pytest.mark.parametrize("discrete", [False, True])
def test_an_output_that_is_not_finite_is_never_flown(discrete):
    """Actors whose arithmetic overflows command hover, where the largest logit would be an option, too."""
    control = ControlConfig(communication="headings", monitoring="moves", collection="moves")
    seen = ObservationConfig(mirrored=False)
    farm = FarmConfig(world=WORLD, control=control, observation=seen) if discrete else FARM
    broken = TeamActors.initial(farm_team(farm), 16, 7)
    broken.flat[2][:] = np.random.default_rng(0).choice(np.float32([3e38, -3e38]), broken.flat[2].shape)
    team = Team(farm, broken)
    team.tell()
    with np.errstate(all="ignore"):
        found = team.period()
    assert (found[OTHER].hover, found[OTHER].velocity) == (True, (0.0, 0.0))
    assert found[OTHER].reason == "the policy's output is not finite"
    assert not found[UAV].hover


def test_what_is_not_finite_is_not_remembered():
    """An agent with memory whose output overflowed once decides again from what it remembered before."""
    actors = TeamActors.initial(farm_team(FARM), 16, 7, per_type=False, memory="gru")
    spoilt, healthy = Team(decider=actors.copy()), Team(decider=actors.copy())
    for team in (spoilt, healthy):
        team.tell()
        team.period(0.0)
    before = spoilt.pilot._decider._state.copy()
    parameters = spoilt.pilot._decider._actors.flat[0]
    kept = parameters.copy()
    parameters[:] = np.random.default_rng(0).choice(np.float32([3e38, -3e38]), parameters.shape)
    spoilt.tell()
    with np.errstate(all="ignore"):
        assert spoilt.period(1.0)["communication_0"].hover
    np.testing.assert_array_equal(spoilt.pilot._decider._state[0, 0], before[0, 0])
    assert np.isfinite(spoilt.pilot._decider._state).all()
    parameters[:] = kept
    spoilt.tell()
    assert not spoilt.period(1.0)["communication_0"].hover


def test_a_flight_is_over_with_the_farms_episode():
    """After the last step every vehicle hovers."""
    short = dataclasses.replace(FARM, world=dataclasses.replace(WORLD, steps=3))
    team = Team(short)
    for _ in range(5):
        team.tell()
        found = team.period(1.0)
    assert team.pilot.over
    assert {message.reason for message in found.values()} == {"the flight's 3 steps are over"}


def test_another_node_is_told_of():
    """Who obeys another flight node, or another start of this one, and who else claims them."""
    team = Team(name="main", start=7)
    team.tell(node="spare", node_start=5)
    team.period()
    assert "communication_0, collection_0" not in str(team.pilot.report()["alarms"])
    assert "obey the flight node spare; this one stands by." in team.pilot.report()["alarms"][0]
    assert team.pilot.report()["standing_by"] == 5
    team.tell(node="main", node_start=7, rival="spare")
    team.period()
    assert "obey this node; the flight node spare claims them." in team.pilot.report()["alarms"][0]
    assert team.pilot.report()["standing_by"] == 0
    team.tell(node="main", node_start=8)
    team.period()
    assert "obey the flight node main of another start" in team.pilot.report()["alarms"][0]


def test_a_node_flies_only_its_own():
    """The poses of others count in its map."""
    team = Team(only=(UAV,))
    team.tell(OTHER)
    assert team.period()[UAV].hover
    team.tell()
    assert list(team.period()) == [UAV]


def test_vehicles_must_tell_what_the_farm_needs():
    """With batteries they tell their charge, in wind the wind."""
    base = preset("battery").farm
    small = dataclasses.replace(base.world, communication_uavs=1, monitoring_uavs=2, collection_uavs=2)
    farm = dataclasses.replace(base, world=small)
    team = Team(farm)
    team.tell()
    assert team.period()[UAV].reason == "it does not tell its battery's charge"
    team.tell(charge=1e5)
    assert not team.period()[UAV].hover


def test_the_report_is_bounded_declared_and_names_who_hovers():
    """Its metrics are those of `common.protocol.metrics`, at most ROWS vehicles one by one, hovering ones first."""
    wide = dataclasses.replace(WORLD, communication_uavs=20, monitoring_uavs=20, collection_uavs=20)
    farm = dataclasses.replace(FARM, world=wide)
    team = Team(farm, Constant(agent_count=60))
    team.tell(*agents(farm)[:2])
    team.period()
    report = team.pilot.report()
    assert undeclared("flight", report) == []
    assert set(report["causes"]) == set(CAUSES)
    declared = next(metric for metric in METRICS["flight"] if metric.name == "causes/*")
    assert all(cause in declared.meaning for cause in CAUSES)
    assert len(report["vehicles"]) == ROWS
    assert report["alarms"][1] == "communication_0, communication_1 hover: no pose has come yet."
    team.tell()
    team.period()
    report = team.pilot.report()
    assert (report["decisions"], report["hovers"], report["alarms"]) == (60, 60, [])
    assert report["latency"]["median"] <= report["latency"]["p99"] <= report["latency"]["most"]
    ended = team.pilot.hover("the flight node ends")
    assert all(message.hover for message in ended.values())
    assert team.pilot.report()["alarms"] == [
        "communication_0, communication_1 and 58 others hover: the flight node ends."
    ]


def test_agents_must_exist_and_fly_one_vehicle_each():
    """An unknown agent, and one agent for two vehicles, are refused at the start."""
    known = agents(FARM)
    with pytest.raises(ConfigError, match="no agent 'collection_9'"):
        require_agents({"a": "collection_9"}, known, "the farm's")
    with pytest.raises(ConfigError, match="same agent"):
        require_agents({"a": UAV, "b": UAV}, known, "the farm's")


@pytest.mark.parametrize("model", ["instant", "inertial"])
@pytest.mark.parametrize("latency", [0.0, 0.9])
def test_the_border_limits_velocities_so_that_a_vehicle_stops_before_it(model, latency):
    """A vehicle with inertia is inside at the end: with late poses, and where the simulator does without inertia."""
    farm = dataclasses.replace(FARM, dynamics=DynamicsConfig(model=model))
    most, speed, dt, way = 3.0, 10.0, 0.01, [200.0]
    for step in range(6000):
        if step % 10 == 0:
            seen = way[max(0, len(way) - 1 - round(latency / dt))]
            wanted, _ = inside_border(farm, 0, np.array([10.0, 0.0]), (seen, 200.0), 1.5)
        speed += min(most * dt, max(-most * dt, wanted - speed))
        way.append(way[-1] + speed * dt)
    assert way[-1] > 395.0
    assert max(way) <= 400.0
    assert inside_border(farm, 0, np.array([10.0, -10.0]), (405.0, -5.0), 1.5) == (0.0, 0.0)
    assert inside_border(farm, 0, np.array([-10.0, 10.0]), (405.0, -5.0), 1.5) == (-10.0, 10.0)


def test_a_vehicle_whose_poses_stop_before_the_border_stops_inside():
    """The last set-point is flown to the end of its validity, then the vehicle brakes; the pilot allowed for it."""
    team = Team(FARM, Constant((1.0, 0.0)), validity=0.5)
    at, speed, told, until, flown = 300.0, 10.0, 300.0, 0.0, 0.0
    for step in range(3000):
        if step % 10 == 0:
            told = told if at > 370.0 and told > 365.0 else at
            team.sequence += 1
            if told == at:
                team.offer(UAV, place=(at, 150.0))
            team.tell(UAV)
            found = team.period(0.1)[UAV]
            flown, until = found.velocity[0], step + 50
        wanted = flown if step < until else 0.0
        speed += min(0.03, max(-0.03, wanted - speed))
        at += speed * 0.01
    assert 370.0 < at <= 400.0


def test_a_decision_that_was_made_without_a_pose_is_never_flown():
    """A vehicle whose pose is back within the step hovers until the policy has decided on it."""
    team = Team()
    team.tell()
    team.period(0.0)
    for _ in range(20):
        team.tell(UAV)
        found = team.period()
    assert found[UAV].reason == "no pose for 2.0 s"
    team.tell()
    found = team.period()
    assert not found[OTHER].hover
    assert found[UAV].reason == "its pose was not known when the policy decided; it flies the next decision"
    for _ in range(10):
        team.tell()
        found = team.period()
    assert not found[UAV].hover


def test_a_vehicle_far_from_its_height_hovers():
    """Take-off is the pilot's: on the ground, and at another type's height that is too far, nothing is decided."""
    team = Team()
    for height, hovers in ((0.0, True), (17.9, True), (18.1, False), (22.1, True)):
        team.sequence += 1
        team.offer(UAV, height=height)
        team.tell(UAV)
        assert team.period()[UAV].hover == hovers
    assert team.pilot.report()["causes"]["height"] == 3
    assert "22.1 m high, and its type flies at 20 m" in team.pilot.vehicles[UAV].reason


def test_two_vehicles_of_one_name_hover():
    """Whichever is heard last, none is flown while both are there; the sentence says why."""
    team = Team()
    for number in range(1, 30):
        team.tell(UAV)
        team.offer(UAV, sequence=number, start=5 if number % 2 else 9)
        found = team.period()[UAV]
        assert found.hover or number < 3
        assert found.vehicle_start in (5, 9)
    assert found.reason == "two vehicles have this name; stop one of them"
    assert team.pilot.report()["causes"]["doubled"] > 20
    for number in range(30, 60):
        team.tell(UAV)
        team.offer(UAV, sequence=number, start=9)
        found = team.period()[UAV]
    assert not found.hover


def test_a_wrong_report_is_counted_and_the_pose_is_flown_on():
    """A number that does not exist, or a time that has not come, spoils neither the pose nor the other reports."""
    team = Team()
    team.tell()
    team.period()
    stamp = int(team.now * 1e6)
    team.sequence += 1
    served, stamps = np.array([400, -1, 7, 3], np.int32), np.array([stamp, stamp, 2**60, stamp])
    assert team.offer(UAV, served=served, served_stamp=stamps)
    team.tell(UAV)
    assert not team.period(1.0)[UAV].hover
    report = team.pilot.report()
    assert (report["misreported"], report["served"], report["refused"]) == (3, 1, 0)


def test_the_machines_clock_may_jump_without_losing_vehicles():
    """Silence is by a clock that never goes back: nobody is lost because it was set."""
    failing = preset("failing").farm
    small = dataclasses.replace(failing.world, communication_uavs=1, monitoring_uavs=2, collection_uavs=2)
    team = Team(dataclasses.replace(failing, world=small))
    team.tell()
    team.period(0.0)
    found = team.pilot.decide(team.now + 3600.0)
    assert found[UAV].hover
    team.tell()
    assert not any(vehicle.lost for vehicle in team.pilot.vehicles.values())
    assert not team.period()[UAV].hover
