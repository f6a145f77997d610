"""Wind and no-fly zones on any farm, and everything at once: against the reference, and what flight never does."""

import math
from dataclasses import replace

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from eia_sec.common.config import BatteryConfig, FarmConfig, StressConfig, WindConfig, WorldConfig, ZoneConfig
from eia_sec.common.config.farm.polygons import inside_any
from eia_sec.common.farm import farm_environment
from eia_sec.rollout.sim.batch import REWARD_PARTS, FarmBatch
from eia_sec.rollout.sim.layout import Layout
from eia_sec.rollout.sim.reference.power import flight_power, other_power
from eia_sec.rollout.sim.start import start_positions
from tests.rollout.sim.properties.strategies import Flight, dose, farm_configs, flights, instant_farms, placed, worlds
from tests.rollout.sim.properties.test_properties_added import moves, with_plans_that_fit, with_seen
from tests.rollout.sim.properties.test_properties_battery import batteries
from tests.rollout.sim.properties.test_properties_reference import flown_beside, reference_of
from tests.rollout.sim.properties.test_properties_stress import stresses

BOUNDARY = REWARD_PARTS.index("boundary")
SMALL = worlds(st.one_of(st.integers(1, 3), st.integers(1, 8)), 80)
LARGEST_DRAWN = 80.0**2
MOST_CELLS = 20
"""Most lattice points along an axis."""


@st.composite
def polygons(draw: st.DrawFn, world: WorldConfig) -> tuple[tuple[float, float], ...]:
    """Draw a rectangle along the axes, or a polygon around a place, with notches where a radius is short."""
    size = min(world.field_x, world.field_y)
    x, y = (draw(st.integers(0, 8)) / 8.0 * side for side in (world.field_x, world.field_y))
    if draw(st.booleans()):
        w, h = (draw(st.sampled_from([0.01, 0.1, 0.3])) * size for _ in range(2))
        return (x - w / 2, y - h / 2), (x + w / 2, y - h / 2), (x + w / 2, y + h / 2), (x - w / 2, y + h / 2)
    radii = draw(st.lists(st.floats(0.02, 0.18), min_size=3, max_size=8))
    turns = 2.0 * math.pi * np.arange(len(radii)) / len(radii)
    return tuple((x + size * r * math.cos(t), y + size * r * math.sin(t)) for r, t in zip(radii, turns, strict=True))


def with_coarse_lattice(config: FarmConfig) -> FarmConfig:
    """Return the farm with steps of a twentieth of the field at least; the reference tries each step for each zone."""
    world = config.world
    x, y = (side / (MOST_CELLS * world.step_seconds) for side in (world.field_x, world.field_y))
    return replace(
        config, world=replace(world, speed_x_max=max(x, world.speed_x_max), speed_y_max=max(y, world.speed_y_max))
    )


@st.composite
def airspaces(draw: st.DrawFn, configs: st.SearchStrategy[FarmConfig]) -> FarmConfig:
    """Draw a farm with wind, zones or both, and all that UAVs can see of them."""
    config = with_coarse_lattice(draw(configs))
    world, slowest = config.world, min(config.world.speed_x_max, config.world.speed_y_max)
    wind = WindConfig(
        speed=slowest * draw(st.sampled_from([0.0, 0.3, 1.0])),
        gusts=slowest * draw(st.sampled_from([0.0, 0.2, 3.0])),
    )
    given_zones = tuple(draw(st.lists(polygons(world), max_size=3)))
    room = int(0.1 * world.field_x * world.field_y / LARGEST_DRAWN)
    zones = ZoneConfig(given_zones, draw(st.integers(0, room)))
    seen = replace(config.observation, wind=draw(st.booleans()), zones=draw(st.booleans()))
    return replace(config, wind=wind, zones=zones, observation=seen)


FLIGHTS = flights(airspaces(farm_configs(SMALL)))


def started(flight: Flight, before: int = 0) -> tuple[FarmBatch, Layout, np.ndarray]:
    """Return a batch at the start of a flight, its layout and where its UAVs start: never in a zone.

    Args:
        flight: the flight.
        before: episodes on other farms that the batch begins earlier.
    """
    layout, positions = flight.layout(), flight.positions()
    random = np.random.default_rng((flight.episode, 4))
    while (within := inside_any(positions, layout.zones)).any():
        positions[within] = random.uniform(0.0, flight.size, (int(within.sum()), 2))
    batch = FarmBatch(flight.config, 1)
    for earlier in range(before):
        batch.reset(0, flight.farm + 1 + earlier, flight.episode)
    with placed(layout, positions):
        batch.reset(0, flight.farm, flight.episode)
    return batch, layout, positions


@dose(20)
@given(FLIGHTS)
def test_any_flight_in_wind_and_around_zones_equals_the_reference(flight: Flight):
    """Every quantity after every step, within the bounds of the observation."""
    batch, _, positions = started(flight)
    reference = reference_of(flight, batch, positions)
    assert sum(1 for _ in flown_beside(flight, batch, reference)) == min(20, flight.config.world.steps)


def angles(points: np.ndarray, zone: np.ndarray) -> np.ndarray:
    """Return how often a zone winds around points [K, 2], and 0 for those within a micrometre of its border."""
    ends = zone, np.roll(zone, -1, axis=0)
    first, second = (corner - points[:, None] for corner in ends)
    cross = first[..., 0] * second[..., 1] - first[..., 1] * second[..., 0]
    turn = np.arctan2(cross, (first * second).sum(axis=2)).sum(axis=1)
    way = ends[1] - ends[0]
    along = np.clip((-first * way).sum(axis=2) / (way**2).sum(axis=1), 0.0, 1.0)
    gap = np.hypot(*np.moveaxis(first + along[..., None] * way, 2, 0)).min(axis=1)
    return np.where(gap > 1e-6, np.abs(turn) / (2.0 * math.pi), 0.0)


@dose(20)
@given(FLIGHTS)
def test_no_uav_is_ever_inside_a_zone_nor_crosses_one(flight: Flight):
    """Along every way flown, no zone winds around any point; what is stopped stays and counts as a violation."""
    batch, layout, _ = started(flight)
    shares = np.linspace(0.0, 1.0, 41)[:, None, None]
    for action in flight.actions():
        before = batch.position[0].copy()
        batch.step(action[None])
        way = (before + shares * (batch.position[0] - before)).reshape(-1, 2)
        for zone in layout.zones:
            assert (angles(way, zone) < 0.5).all()


@dose(20)
@given(flights(airspaces(instant_farms(farm_configs(SMALL)))))
def test_ground_is_air_and_wind_and_the_power_is_that_of_the_airspeed(flight: Flight):
    """Where nothing stops a UAV: no airspeed exceeds the top speed, and what is possible of the command is flown."""
    batch, world, energy = started(flight)[0], flight.config.world, flight.config.energy
    top = np.array([world.speed_x_max, world.speed_y_max])
    kinds = np.repeat((0, 1, 2), world.counts)
    weight = flight.config.reward.boundary
    for action in flight.actions():
        before = batch.position[0].copy()
        batch.step(action[None])
        wind = batch.wind[0]
        assert (np.abs(wind) <= top).all()
        ground = (batch.position[0] - before) / world.step_seconds
        commanded = np.clip(action.reshape(-1, 2).astype(np.float64), -1.0, 1.0) * top
        air = np.clip(commanded - wind, -top, top)
        possible = np.clip(commanded, wind - top, wind + top)
        inside = np.clip(before + possible * world.step_seconds, 0.0, flight.size)
        edge = (np.minimum(inside, flight.size - inside) < 1e-9).any(axis=1)
        stayed = (batch.position[0] == before).all(axis=1)
        np.testing.assert_allclose(
            ground[~stayed], ((inside - before) / world.step_seconds)[~stayed], rtol=1e-9, atol=1e-6
        )
        power = [
            flight_power(energy, float(np.hypot(*v))) + other_power(energy, k) for v, k in zip(air, kinds, strict=True)
        ]
        np.testing.assert_allclose(batch.energy[0], np.array(power) * world.step_seconds, rtol=1e-6)
        if weight:
            violated = batch.parts[0, :, BOUNDARY] != 0.0
            assert not (violated & ~edge & ~stayed).any()
            moved = np.abs(inside - before).max(axis=1) > 1e-9
            assert violated[stayed & moved].all()


@dose(15)
@given(FLIGHTS)
def test_every_uav_sees_the_wind_along_its_own_axes(flight: Flight):
    """Turned back by the signs of a UAV's axes, what it sees is the wind."""
    seen = replace(flight.config.observation, wind=True)
    batch = started(replace(flight, config=replace(flight.config, observation=seen)))[0]
    spec, world = farm_environment(batch.config), flight.config.world
    top = np.array([world.speed_x_max, world.speed_y_max])
    for action in flight.actions()[:6]:
        batch.step(action[None])
        for group, rows in zip(spec.team.groups, batch.team.split_observations(batch.observation[0]), strict=True):
            named = dict(zip(spec.tensor_names[group.name].observation, rows.T, strict=True))
            for k, axis in enumerate("xy"):
                wind = named[f"wind_{axis}"] * named.get(f"sign_{axis}", 1.0) * top[k]
                np.testing.assert_allclose(wind, batch.wind[0, k], rtol=1e-6, atol=1e-6)


@dose(10)
@given(flights(farm_configs(SMALL)))
def test_seeing_wind_and_zones_that_there_are_not_changes_nothing_else(flight: Flight):
    """Both observations are 0, and everything else is bit for bit that of a farm without them."""
    config = flight.config
    more = replace(config, observation=replace(config.observation, wind=True, zones=True))
    pair = [started(replace(flight, config=each))[0] for each in (config, more)]
    spec = farm_environment(more)
    names = [name for g in spec.team.groups for _ in range(g.count) for name in spec.tensor_names[g.name].observation]
    added = np.array([name.startswith(("wind_", "refused_")) for name in names])
    for action in flight.actions()[:8]:
        for batch in pair:
            batch.step(action[None])
        np.testing.assert_array_equal(pair[1].observation[0][~added], pair[0].observation[0])
        assert not pair[1].observation[0][added].any()
        np.testing.assert_array_equal(pair[1].parts, pair[0].parts)
        np.testing.assert_array_equal(pair[1].energy, pair[0].energy)


@dose(15)
@given(airspaces(farm_configs(worlds(st.integers(1, 2), 30))), st.integers(0, 99), st.integers(0, 99))
def test_uavs_start_outside_zones(config: FarmConfig, farm: int, episode: int):
    """Wherever the zones are, and drawn ones lie in the field."""
    batch = FarmBatch(config, 1)
    batch.reset(0, farm, episode)
    zones, size = batch.layout(0).zones, (config.world.field_x, config.world.field_y)
    assert not inside_any(batch.position[0], zones).any()
    assert len(zones) == len(config.zones.corners)
    for zone in zones[len(config.zones.polygons) :]:
        assert (zone >= -1e-9).all()
        assert (zone <= np.array(size) + 1e-9).all()
    free = start_positions(config.world, farm, episode)
    planes = [free[own] for own in batch.team.agent_slices()]
    crowded = any(len(own) == 2 and np.hypot(*(own[0] - own[1])) < config.world.safety_distance for own in planes)
    # In a crowded plane the distance shrinks with the places that were tried, and those in zones do not count.
    if not crowded and not inside_any(free, zones).any():
        np.testing.assert_array_equal(batch.position[0], free)


@dose(15)
@given(flights(airspaces(farm_configs(SMALL))), stresses(), batteries())
def test_any_flight_with_everything_equals_the_reference(flight: Flight, stress: StressConfig, battery: BatteryConfig):
    """Every quantity after every step, within the bounds of the observation."""
    config = flight.config
    config = replace(
        config,
        stress=stress,
        battery=battery,
        relay=replace(config.relay, require_link=True),
        reward=replace(config.reward, relayed=0.5),
    )
    seen = {"stress": True, "charge": True, "wind": True, "zones": True, "plan": 2}
    config = with_seen(config, seen)
    flight = replace(flight, config=with_plans_that_fit(config))
    batch, _, positions = started(flight)
    reference = reference_of(flight, batch, positions)
    for _ in flown_beside(flight, batch, reference):
        np.testing.assert_array_equal(batch.gone[0], reference.gone)
        np.testing.assert_array_equal(batch.patch_known[0], reference.known)
        np.testing.assert_allclose(batch.charge[0], reference.charge, rtol=1e-9, atol=1e-6)


@st.composite
def led(draw: st.DrawFn, configs: st.SearchStrategy[FarmConfig]) -> FarmConfig:
    """Draw a farm with zones, and with sweep routes, plans or both."""
    config = with_coarse_lattice(draw(configs))
    given_zones = tuple(draw(st.lists(polygons(config.world), min_size=1, max_size=4)))
    room = int(0.1 * config.world.field_x * config.world.field_y / LARGEST_DRAWN)
    route = draw(st.booleans())
    seen = replace(
        config.observation,
        zones=True,
        route=route,
        plan=draw(st.integers(0 if route else 1, 3)),
    )
    control = replace(config.control, monitoring_inset=draw(st.sampled_from([0.5, 0.36, 0.1])))
    zones = ZoneConfig(given_zones, draw(st.integers(0, room)))
    return with_plans_that_fit(replace(config, zones=zones, control=control, observation=seen))


AMONG_ZONES = flights(led(instant_farms(farm_configs(SMALL))))


@dose(20)
@given(AMONG_ZONES)
def test_routes_and_plans_among_zones_equal_the_reference(flight: Flight):
    """Every quantity after every step, within the bounds of the observation, also in the second episode of a batch."""
    batch, _, positions = started(flight, before=1)
    reference = reference_of(flight, batch, positions)
    assert sum(1 for _ in flown_beside(flight, batch, reference)) == min(20, flight.config.world.steps)


@dose(20)
@given(AMONG_ZONES)
def test_no_move_that_a_zone_refuses_is_marked(flight: Flight):
    """Neither along the route, unless all are refused, nor as the first one of a plan, wherever UAVs stand."""
    batch, spec = started(flight)[0], farm_environment(flight.config)
    random = np.random.default_rng(flight.episode)
    for _ in range(8):
        for group, rows in zip(spec.team.groups, batch.team.split_observations(batch.observation[0]), strict=True):
            names = spec.tensor_names[group.name].observation
            parts = {
                word: rows[:, [k for k, name in enumerate(names) if name.startswith(f"{word}_")][:9]]
                for word in ("refused", "route_move", "plan")
            }
            refused = parts["refused"] > 0.0
            assert not parts["plan"].size or not parts["plan"][refused].any()
            if parts["route_move"].size:
                assert not (refused & (parts["route_move"] > 0.0))[~refused.all(axis=1)].any()
        if batch.ended[0]:
            break
        batch.step(moves(flight.config, batch, random)[None])
