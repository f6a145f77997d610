"""The added observations against the reference, with all of them on, and what they mean in cases worked out by hand."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from eia_sec.common.config import FarmConfig, ObservationConfig, RelayConfig, RunConfig, WorldConfig
from eia_sec.common.config.presets import preset
from eia_sec.common.errors import ConfigError
from eia_sec.common.farm import farm_environment, farm_team, inset_of, lattice_of
from eia_sec.common.team import Float32
from eia_sec.rollout.envs.spaces import row_box
from eia_sec.rollout.sim.batch import FarmBatch
from eia_sec.rollout.sim.core.constants import constants
from eia_sec.rollout.sim.layout import make_layout
from eia_sec.rollout.sim.observation.constants import image_bounds
from eia_sec.rollout.sim.sweep_routes import assigned_routes, sweep_routes
from tests.rollout.sim.course import begin
from tests.rollout.sim.properties.strategies import Flight, dose, farm_configs, flights, placed, worlds
from tests.rollout.sim.properties.test_properties_reference import (
    assert_equal,
    reference_of,
)

ALL = {
    "peers": 3,
    "last_move": True,
    "closing": True,
    "units": 2,
    "plan": 3,
    "fields": True,
    "coarse": True,
    "phases": True,
    "route": True,
    "service": True,
    "link": True,
    "stress": True,
    "charge": True,
}
"""Every switch, on."""
MARKS = ("plan", "route")
SMALL = worlds(st.one_of(st.integers(1, 4), st.integers(1, 10)), 90)


def with_plans_that_fit(config: FarmConfig) -> FarmConfig:
    """Return the farm, without plans where so short steps have too many places for them; with zones, without routes.

    UAVs with inertia have neither.
    """
    if config.dynamics.inertial:
        return config
    try:
        constants(config)
    except ConfigError:
        route = config.observation.route and not config.zones.some
        return replace(config, observation=replace(config.observation, plan=0, route=route))
    return config


def everything(config: FarmConfig) -> FarmConfig:
    """Return the farm with every switch on."""
    return with_plans_that_fit(with_seen(config, ALL))


def with_seen(config: FarmConfig, switches: dict[str, Any]) -> FarmConfig:
    """Return the farm with switches of observations set, but for plans and routes of UAVs with inertia."""
    off = {"plan": 0, "route": False} if config.dynamics.inertial else {}
    return replace(config, observation=replace(config.observation, **(switches | off)))


def moves(config: FarmConfig, batch: FarmBatch, random: np.random.Generator) -> Float32:
    """Return actions [2 n] that lead to random neighbouring cells, so that UAVs come to stand where moves end."""
    world = config.world
    place = (2.0 * batch.position[0] / (world.field_x, world.field_y) - 1.0).astype(np.float32)
    step = random.integers(-1, 2, place.shape).astype(np.float32)
    rows = zip(batch.team.groups, batch.team.agent_slices(), strict=True)
    lattices = [(lattice_of(world, inset_of(config, group.name)), agents) for group, agents in rows]
    return np.concatenate([lattice.velocity(place[own], step[own]) for lattice, own in lattices]).reshape(-1)


@dose(15)
@given(flights(farm_configs(SMALL).map(everything)), st.booleans())
def test_all_added_observations_equal_the_reference(flight: Flight, on_lattice: bool):
    """Every number after every step, for flights between lattice points and anywhere."""
    batch, random = begin(flight), np.random.default_rng(flight.episode)
    box, reference = row_box(flight.config), reference_of(flight, batch)
    for action in flight.actions()[:12]:
        chosen = moves(flight.config, batch, random) if on_lattice else action
        batch.step(chosen[None])
        reference.step(chosen, batch.assignment[0])
        assert_equal(batch, reference)
        assert box.contains(batch.observation[0])


@dose(7)
@given(flights(farm_configs(SMALL)), st.sets(st.sampled_from(sorted(ALL))))
def test_added_observations_change_nothing_else(flight: Flight, names: set[str]):
    """Without its added numbers a row is bit for bit that of a farm that has them off, and so is the rest."""
    off = preset("eia-sec").farm.observation
    plain = with_seen(flight.config, {name: getattr(off, name) for name in ALL})
    more = with_seen(plain, {name: ALL[name] for name in names})
    farms = [with_plans_that_fit(farm) for farm in (plain, more)]
    pair = [begin(replace(flight, config=farm)) for farm in farms]
    kept = []
    for batch in pair:
        spec = farm_environment(batch.config)
        kept.append([spec.tensor_names[g.name].observation for g in spec.team.groups for _ in range(g.count)])
    keep = np.concatenate([np.isin(mine, usual) for usual, mine in zip(*kept, strict=True)])
    for action in flight.actions()[:8]:
        for batch in pair:
            batch.step(action[None])
        np.testing.assert_array_equal(pair[1].observation[0][keep], pair[0].observation[0])
        np.testing.assert_array_equal(pair[1].parts, pair[0].parts)


def views(config: FarmConfig, batch: FarmBatch, group: int) -> dict[str, np.ndarray]:
    """Return what the agents of a type see, [n_v] by name."""
    spec = farm_environment(config)
    rows = farm_team(config).split_observations(batch.observation[0])[group]
    return dict(zip(spec.tensor_names[spec.team.groups[group].name].observation, rows.T, strict=True))


def placed_batch(config: FarmConfig, position: np.ndarray, levels: tuple[np.ndarray, np.ndarray]) -> FarmBatch:
    batch = FarmBatch(config, 1)
    with placed(make_layout(config, 0), position, levels):
        batch.reset(0, 0, 0)
    return batch


ONE = FarmConfig(
    world=WorldConfig(communication_uavs=1, monitoring_uavs=2, collection_uavs=1),
    observation=ObservationConfig(mirrored=False, **ALL),
)


def ground() -> tuple[np.ndarray, np.ndarray]:
    return np.zeros(ONE.world.sensors), np.zeros((ONE.world.plots_x, ONE.world.plots_y))


def test_a_monitor_sees_the_plots_that_its_moves_bring():
    """One stale plot lies two moves on along x and another one move back: one each, and both in two moves never."""
    age, level = ground()
    level[11, 10], level[9, 10] = 5.0, 3.0
    # On the lattice point beside the border of plot 10: the middles of the plots 9 and 11 are not on the lattice.
    batch = placed_batch(ONE, np.array([[0.0, 0.0], [205.0, 205.0], [0.0, 0.0], [0.0, 0.0]]), (age, level))
    seen = views(ONE, batch, 1)
    assert seen["units_1_move_-1_0"][0] == pytest.approx(3.0 / 5.0)
    assert seen["units_1_move_1_0"][0] == 0.0
    assert seen["units_2_move_1_0"][0] == pytest.approx(1.0)
    assert seen["units_2_move_-1_0"][0] == pytest.approx(3.0 / 5.0)


def test_a_plot_closer_to_a_peer_brings_nothing():
    """A peer over the plot would take its image."""
    age, level = ground()
    level[9, 10] = 3.0
    batch = placed_batch(ONE, np.array([[0.0, 0.0], [205.0, 205.0], [190.0, 210.0], [0.0, 0.0]]), (age, level))
    assert views(ONE, batch, 1)["units_1_move_-1_0"][0] == 0.0


def test_the_risk_of_two_monitors_face_to_face():
    """20 m apart, the move towards a peer that stands still costs its 10 m; the other way it costs nothing."""
    batch = placed_batch(ONE, np.array([[0.0, 0.0], [205.0, 205.0], [225.0, 205.0], [0.0, 0.0]]), ground())
    seen = views(ONE, batch, 1)
    assert seen["risk_same_move_1_0"][0] == pytest.approx(10.0 / ONE.world.safety_distance)
    assert seen["risk_same_move_-1_0"][0] == 0.0
    assert seen["risk_any_move_1_0"][0] > seen["risk_any_move_0_0"][0] > 0.0


def test_a_field_grows_towards_what_is_stale():
    """The one stale plot lies far off along x: one move there is the field's largest possible growth along an axis."""
    age, level = ground()
    level[19, 10] = 5.0
    batch = placed_batch(ONE, np.array([[0.0, 0.0], [205.0, 205.0], [0.0, 0.0], [0.0, 0.0]]), (age, level))
    seen = views(ONE, batch, 1)
    assert seen["far_move_1_0"][0] > 0.0 > seen["far_move_-1_0"][0]
    assert seen["near_move_1_0"][0] > 0.0
    assert seen["far_here"][0] > seen["near_here"][0] > 0.0


def test_a_route_leads_to_the_next_stale_plot_of_the_own_part():
    """The UAV is over the first plot of its route; the second plot is fresh, so the third one comes next."""
    route = assigned_routes(sweep_routes(ONE), np.array([[5.0, 5.0], [395.0, 395.0]]), ONE.world)[0]
    boxes = sweep_routes(ONE)[route[0]]
    age, level = ground()
    level[:] = 1.0
    middle = boxes.mean(axis=0)
    fresh = (middle[(route[1] + 1) % len(middle)] // 20.0).astype(int)
    level[tuple(fresh)] = 0.0
    batch = placed_batch(ONE, np.array([[0.0, 0.0], [5.0, 5.0], [395.0, 395.0], [0.0, 0.0]]), (age, level))
    seen = views(ONE, batch, 1)
    step = middle[(route[1] + 2) % len(middle)] - (5.0, 5.0)
    assert (seen["route_1_dx"][0], seen["route_1_dy"][0]) == pytest.approx(np.clip(step / 20.0, -2.0, 2.0))
    suggested = [name for name in seen if name.startswith("route_move") and seen[name][0] == 1.0]
    assert suggested == [f"route_move_{int(np.sign(step[0]))}_{int(np.sign(step[1]))}"]


def test_a_uav_on_its_route_waits_while_all_plots_are_fresh():
    """There is nothing to image before the first rise of VDF."""
    batch = placed_batch(ONE, np.array([[0.0, 0.0], [5.0, 5.0], [395.0, 395.0], [0.0, 0.0]]), ground())
    first = views(ONE, batch, 1)
    assert first["route_move_0_0"][0] == 0.0  # The first box is reached, and the second one is next.
    batch.step(np.zeros((1, 2 * ONE.world.uavs), np.float32))
    assert views(ONE, batch, 1)["route_1_dx"][0] == first["route_1_dx"][0]


def test_flying_the_suggested_moves_sweeps_the_field():
    """Without any learning, monitors earn more than those of `greedy` (2586 on a hundred farms)."""
    batch = FarmBatch(RunConfig().farm, 2)
    for index in range(2):
        batch.reset(index, 1000 + index, 7)
    group, rows = batch.team.groups[1], batch.team.agent_slices()[1]
    reward = np.zeros(batch.reward.shape)
    for _ in range(batch.config.world.steps):
        view = batch.team.split_observations(batch.observation)[1]
        first = group.adapters[0].suggestion
        moves = view[..., first : first + 9].argmax(axis=-1)[..., None].astype(np.float32)
        for adapter in group.adapters:
            moves = adapter.adapt(view, moves)
        action = np.zeros((2, batch.team.agents, 2), np.float32)
        action[:, rows] = moves
        batch.step(action.reshape(2, -1))
        reward += batch.reward
    assert reward[:, rows].mean() > 2600.0


def two_full_sensors(config: FarmConfig) -> tuple[np.ndarray, np.ndarray, tuple[np.ndarray, np.ndarray]]:
    """Return a sensor to the left and one to the right of the middle, and levels in which these two are full."""
    sensor = make_layout(config, 0).sensor_xy
    left, right = (sensor[np.abs(sensor - (x, 200.0)).sum(axis=1).argmin()] for x in (140.0, 260.0))
    age = np.zeros(config.world.sensors)
    age[(sensor == right).all(axis=1) | (sensor == left).all(axis=1)] = 5.0
    return left, right, (age, ground()[1])


def test_a_collector_plans_for_its_own_sensors_alone():
    """Of two full sensors to the left and to the right, one is nearer to a peer. The plan leads to the other."""
    world = WorldConfig(communication_uavs=1, monitoring_uavs=1, collection_uavs=2)
    config = FarmConfig(world=world, observation=ObservationConfig(mirrored=False, plan=8))
    left, right, levels = two_full_sensors(config)
    for peer, way in ((left, 1), (right, -1)):
        batch = placed_batch(config, np.array([[0.0, 0.0], [5.0, 5.0], [205.0, 205.0], peer]), levels)
        seen = views(config, batch, 2)
        onward = [seen[f"plan_move_{x}_{y}"][0] for x in (-1, 0, 1) for y in (-1, 0, 1)]
        assert max(onward) == 1.0
        assert np.argmax(onward) // 3 - 1 == way


def test_plans_leave_out_what_no_link_carries():
    """Of two full sensors to the left and to the right, one is within a relay's reach. The plan leads there."""
    world = WorldConfig(communication_uavs=1, monitoring_uavs=1, collection_uavs=1)
    relay = RelayConfig(require_link=True, link_range=40.0)
    config = FarmConfig(world=world, relay=relay, observation=ObservationConfig(mirrored=False, plan=8))
    left, right, levels = two_full_sensors(config)
    for place, way in ((left, -1), (right, 1)):
        batch = placed_batch(config, np.array([place, [5.0, 5.0], [205.0, 205.0]]), levels)
        seen = views(config, batch, 2)
        onward = [seen[f"plan_move_{x}_{y}"][0] for x in (-1, 0, 1) for y in (-1, 0, 1)]
        assert np.argmax(onward) // 3 - 1 == way
        assert seen["plan_best"][0] > 0.0


def test_plans_reckon_with_the_rises_to_come():
    """All plots are fresh. Where plots rise within ten steps, a plan is worth more than where none does."""
    best = {}
    for cycle in (8, 490):
        seen = replace(ONE.observation, route=False, plan=10)
        world = replace(ONE.world, vdf_cycle=cycle)
        config = replace(ONE, world=world, observation=seen)
        batch = placed_batch(config, np.array([[0.0, 0.0], [205.0, 205.0], [5.0, 5.0], [0.0, 0.0]]), ground())
        best[cycle] = views(config, batch, 1)["plan_best"][0] * 10 * config.world.vdf_max
    assert best[490] < 0.0
    assert best[8] > best[490] + 0.5


def test_monitors_with_a_route_follow_plans_in_the_last_steps():
    """Before there are zeros, and the mark is the route's; then the mark is where the best plan's is."""
    config = replace(ONE, world=replace(ONE.world, steps=14))
    batch = FarmBatch(config, 1)
    batch.reset(0, 0, 0)
    for left in range(14, 0, -1):
        seen = views(config, batch, 1)
        plan, route = (
            np.array([seen[f"{name}_move_{x}_{y}"] for x in (-1, 0, 1) for y in (-1, 0, 1)]) for name in MARKS
        )
        assert (plan.max(axis=0) == (1.0 if left <= 9 else 0.0)).all()
        assert (route.sum(axis=0) == 1.0).all()
        if left <= 9:
            assert (plan.argmax(axis=0) == route.argmax(axis=0)).all()
        batch.step(np.zeros((1, 2 * config.world.uavs), np.float32))


def test_following_plans_comes_close_to_horizon():
    """Without learning; `horizon`, which knows all plans, has 1558 for a collector and 2700 for a monitor."""
    config = replace(RunConfig().farm, observation=replace(RunConfig().farm.observation, plan=12))
    batch = FarmBatch(config, 4)
    for index in range(4):
        batch.reset(index, 1000 + index, 7)
    reward, groups = np.zeros(batch.reward.shape), batch.team.groups
    for _ in range(config.world.steps):
        action = np.zeros((4, batch.team.agents, 2), np.float32)
        for kind, view in enumerate(batch.team.split_observations(batch.observation)):
            if kind:
                first = groups[kind].adapters[0].suggestion
                moves = view[..., first : first + 9].argmax(axis=-1)[..., None].astype(np.float32)
                for adapter in groups[kind].adapters:
                    moves = adapter.adapt(view, moves)
                action[:, batch.team.agent_slices()[kind]] = moves
        batch.step(action.reshape(4, -1))
        reward += batch.reward
    _, monitors, collectors = batch.team.agent_slices()
    assert reward[:, monitors].mean() > 2675.0
    assert reward[:, collectors].mean() > 1555.0


def test_plans_refuse_steps_that_are_too_short_for_the_ranges():
    """They would list millions of lattice points for each sensor."""
    world = WorldConfig(speed_x_max=0.2, speed_y_max=0.2)
    config = FarmConfig(world=world, observation=ObservationConfig(plan=8))
    with pytest.raises(ConfigError, match=r"farm\.observation\.plan is for at most"):
        constants(config)


def test_missing_peers_are_zeros():
    """The only collector sees no peer, and a monitor sees one of three."""
    batch = placed_batch(ONE, np.array([[0.0, 0.0], [205.0, 205.0], [225.0, 205.0], [0.0, 0.0]]), ground())
    assert [views(ONE, batch, 1)[f"peer_{rank}_present"][0] for rank in range(3)] == [1.0, 0.0, 0.0]
    assert not any(views(ONE, batch, 2)[f"peer_{rank}_present"][0] for rank in range(3))


def test_no_velocity_outlives_a_reset():
    """The first observation of an episode says that nobody has moved yet."""
    batch = FarmBatch(ONE, 1)
    for _ in range(2):
        batch.reset(0, 0, 0)
        assert not any(views(ONE, batch, group)["last_velocity_x"].any() for group in range(3))
        batch.step(np.ones((1, 2 * ONE.world.uavs), np.float32))
        assert all(views(ONE, batch, group)["last_velocity_x"].any() for group in range(3))


@dose(10)
@given(farm_configs(SMALL))
def test_distance_bounds_decide_images(config: FarmConfig):
    """Every image within the inner bound succeeds, and none beyond the outer one."""
    world, camera = config.world, config.camera
    size = np.array([world.field_x / world.plots_x, world.field_y / world.plots_y])
    sure, most = image_bounds(config)
    reach = 1.2 * np.hypot(*size) + max(camera.image_distance**2 - world.height_monitoring**2, 0.0) ** 0.5
    offset = np.random.default_rng(0).uniform(-reach, reach, (400, 2))
    x = ((np.arange(camera.grid_x) + 0.5) / camera.grid_x - 0.5) * size[0]
    y = ((np.arange(camera.grid_y) + 0.5) / camera.grid_y - 0.5) * size[1]
    flat = (x[:, None] - offset[:, 0, None, None]) ** 2 + (y - offset[:, 1, None, None]) ** 2
    quality = (flat + world.height_monitoring**2 < camera.image_distance**2).mean(axis=(1, 2))
    square = (offset**2).sum(axis=1)
    assert (quality[square <= sure] >= camera.plot_threshold).all()
    assert (quality[square > most] < camera.plot_threshold).all()
