"""Wind and no-fly zones: cases worked out by hand, and the statistics of gusts."""

from dataclasses import replace

import numpy as np
import pytest

from eia_sec.common.config import FarmConfig, ObservationConfig, WindConfig, WorldConfig, ZoneConfig
from eia_sec.common.errors import ConfigError
from eia_sec.common.farm import farm_environment, lattice_of
from eia_sec.rollout.sim.batch import REWARD_PARTS, FarmBatch
from eia_sec.rollout.sim.conditions.wind import wind_series
from eia_sec.rollout.sim.layout import make_layout
from eia_sec.rollout.sim.reference.farm import ReferenceFarm
from eia_sec.rollout.sim.reference.power import flight_power, other_power
from tests.rollout.sim.properties.strategies import placed

BASE = FarmConfig(
    world=WorldConfig(communication_uavs=1, monitoring_uavs=1, collection_uavs=1),
    observation=ObservationConfig(zones=True, wind=True, mirrored=False),
)
WINDY = replace(BASE, wind=WindConfig(speed=4.0))
BOX = ((100.0, 100.0), (140.0, 100.0), (140.0, 140.0), (100.0, 140.0))
ZONED = replace(BASE, zones=ZoneConfig((BOX,)))
BOUNDARY = REWARD_PARTS.index("boundary")


def flown(config: FarmConfig, position: list[tuple[float, float]], action: list[float]) -> FarmBatch:
    """Return a batch after one step from given places."""
    batch = FarmBatch(config, 1)
    with placed(make_layout(config, 0), np.array(position)):
        batch.reset(0, 0, 0)
    batch.step(np.array([action], np.float32))
    return batch


def test_a_wind_of_4_m_s_costs_airspeed_with_it_and_against_it():
    """Along x, with it at 10 m/s and against it, which takes more than the 10 m/s that are possible; standing."""
    x, y = wind_series(WINDY, 0, 0)[1]
    assert np.hypot(x, y) == pytest.approx(4.0)
    assert abs(x) > 1.0
    way = np.sign(x)
    batch = flown(WINDY, [(50.0, 50.0), (200.0, 200.0), (300.0, 300.0)], [way, 0.0, -way, 0.0, 0.0, 0.0])
    np.testing.assert_allclose(batch.wind[0], [x, y])
    against = 200.0 - way * (10.0 - abs(x))
    np.testing.assert_allclose(
        batch.position[0], [(50.0 + 10.0 * way, 50.0), (against, 200.0), (300.0, 300.0)], atol=1e-9
    )
    air = (np.hypot(10.0 - abs(x), y), np.hypot(10.0, y), 4.0)
    wanted = [flight_power(BASE.energy, speed) + other_power(BASE.energy, kind) for kind, speed in enumerate(air)]
    np.testing.assert_allclose(batch.energy[0], wanted, rtol=1e-12)


def test_a_zone_stops_what_ends_in_it_and_what_would_fly_through():
    """Into the box, through its corner in one step, and past it: the first two stay and pay alpha_4."""
    batch = flown(ZONED, [(95.0, 120.0), (99.0, 104.0), (99.0, 120.0)], [1.0, 0.0, 0.5, -0.5, 0.0, 1.0])
    np.testing.assert_array_equal(batch.position[0], [(95.0, 120.0), (99.0, 104.0), (99.0, 130.0)])
    np.testing.assert_array_equal(batch.parts[0, :, BOUNDARY], [-10.0, -10.0, 0.0])


def test_uavs_see_the_moves_that_a_zone_refuses():
    """West of the box, 5 m from it: the three moves to the east end in it, the others do not."""
    batch = flown(ZONED, [(95.0, 120.0), (300.0, 300.0), (95.0, 120.0)], [0.0] * 6)
    spec = farm_environment(ZONED)
    for index, refused in ((0, 3), (1, 0), (2, 3)):
        rows = batch.team.split_observations(batch.observation[0])[index]
        names = spec.tensor_names[spec.team.groups[index].name].observation
        seen = {name: value for name, value in zip(names, rows[0], strict=True) if name.startswith("refused")}
        assert sum(seen.values()) == refused
        assert all(seen[f"refused_move_1_{k}"] == (refused > 0) for k in (-1, 0, 1))


def test_gusts_have_their_deviation_and_their_correlation():
    """Over a long episode: deviation 2 m/s, correlation 1/e after 10 s, none between the axes."""
    world = replace(BASE.world, steps=200_000, speed_x_max=50.0, speed_y_max=50.0)
    config = replace(BASE, world=world, wind=WindConfig(gusts=2.0))
    x, y = wind_series(config, 1, 2).T
    assert x.std() == pytest.approx(2.0, rel=0.03)
    assert np.corrcoef(x[:-10], x[10:])[0, 1] == pytest.approx(np.exp(-1.0), abs=0.02)
    assert abs(np.corrcoef(x, y)[0, 1]) < 0.03


def test_the_wind_follows_from_the_seeds():
    """Another episode has other gusts, and episodes' directions are all around; the same episode has the same wind."""
    config = replace(BASE, wind=WindConfig(speed=3.0, gusts=1.0))
    first, again, other = (wind_series(config, 1, episode) for episode in (2, 2, 3))
    np.testing.assert_array_equal(first, again)
    assert (first != other).all()
    steady = replace(BASE, wind=WindConfig(speed=3.0))
    blown = np.array([wind_series(steady, 1, episode)[0] for episode in range(40)])
    np.testing.assert_allclose(np.hypot(*blown.T), 3.0)
    assert len({(x > 0.0, y > 0.0) for x, y in blown.tolist()}) == 4
    assert len(wind_series(BASE, 1, 2)) == 0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda: replace(BASE, wind=WindConfig(speed=11.0)), "top speed"),
        (lambda: WindConfig(speed=-1.0), "speed"),
        (lambda: ZoneConfig((BOX[:2],)), "corners"),
        (lambda: ZoneConfig((((0.0, 0.0), (1.0, 1.0), (1.0, 0.0), (0.0, 1.0)),)), "crosses itself"),
        (lambda: ZoneConfig((((0.0, 0.0), (9.0, 0.0), (4.0, 0.0), (4.0, 4.0)),)), "crosses itself"),
        (lambda: ZoneConfig((((0.0, 0.0), (float("nan"), 0.0), (4.0, 4.0)),)), "corners"),
        (lambda: ZoneConfig((BOX,) * 20, 13), "at most 32"),
        (lambda: replace(BASE, zones=ZoneConfig(random=13)), "cover"),
        (lambda: replace(BASE, zones=ZoneConfig((((0.0, 0.0), (400.0, 0.0), (400.0, 300.0), (0.0, 300.0)),))), "cover"),
    ],
)
def test_what_no_farm_can_have_is_refused(change, message):
    """Before any memory is taken."""
    with pytest.raises(ConfigError, match=message):
        change()


WALL = ((13.0, -1.0), (13.4, -1.0), (13.4, 69.0), (13.0, 69.0))
WALLED = FarmConfig(
    world=WorldConfig(
        communication_uavs=1,
        monitoring_uavs=1,
        collection_uavs=1,
        field_x=60.0,
        field_y=80.0,
        plots_x=3,
        plots_y=4,
        sensors=12,
        sensor_spacing=0.0,
    ),
    observation=ObservationConfig(zones=True, mirrored=False),
    zones=ZoneConfig((WALL,)),
)


@pytest.mark.parametrize("y", [5.0, 15.0, 25.0, 45.0, 75.0])
def test_beside_a_wall_through_their_cells_monitors_are_led_round_it(y):
    """The middle of the UAV's cell lies beyond the wall, so that its own point says nothing of its way."""
    layout, place = make_layout(WALLED, 0), np.array([(50.0, 50.0), (12.0, y), (50.0, 20.0)])
    batch = FarmBatch(WALLED, 1)
    with placed(layout, place):
        batch.reset(0, 0, 0)
        reference = ReferenceFarm(WALLED, layout, 0)
    np.testing.assert_allclose(batch.observation[0], reference.observation, atol=1e-6)


def test_a_monitor_that_follows_its_route_flies_round_a_zone():
    """From south of the box to the plot north of it: no move is refused, and the UAV gets there."""
    names = farm_environment(ZONED).tensor_names["monitoring"].observation
    first = names.index("route_move_-1_-1")
    batch = FarmBatch(ZONED, 1)
    with placed(make_layout(ZONED, 0), np.array([(300.0, 300.0), (115.0, 85.0), (200.0, 20.0)])):
        batch.reset(0, 0, 0)
    lattice, seen = lattice_of(ZONED.world), []
    for _ in range(400):
        row = batch.team.split_observations(batch.observation[0])[1][0]
        move = int(row[first : first + 9].argmax())
        place = (2.0 * batch.position[0, 1] / (400.0, 400.0) - 1.0).astype(np.float32)
        command = lattice.velocity(place, np.array([move // 3 - 1, move % 3 - 1], np.float32))
        batch.step(np.array([[0.0, 0.0, *command, 0.0, 0.0]], np.float32))
        assert batch.parts[0, 1, BOUNDARY] == 0.0
        seen.append(batch.position[0, 1].copy())
    around = np.array(seen)
    assert (around[:, 1] > 140.0).any()
    assert ((around[:, 1] < 100.0) & (np.abs(around[:, 0] - 120.0) < 20.0)).any()


def test_ways_over_more_points_than_can_be_searched_are_refused():
    """One sentence says that steps are too short; without zones there is nothing to search."""
    world = replace(BASE.world, speed_x_max=0.5, speed_y_max=0.5)
    slow = replace(ZONED, world=world)
    with pytest.raises(ConfigError, match="at most 262144 lattice points"):
        FarmBatch(slow, 1)
    FarmBatch(replace(slow, zones=ZoneConfig()), 1)
