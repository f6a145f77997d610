from dataclasses import replace

import numpy as np
import pytest

from eia_sec.common.config import FarmConfig, StressConfig, WorldConfig
from eia_sec.rollout.evaluation import evaluate
from eia_sec.rollout.heuristics.composite import COLLECTORS, MONITORS, CompositePolicy
from eia_sec.rollout.heuristics.registry import HEURISTICS, TASKS
from eia_sec.rollout.heuristics.relays import (
    CentroidRelays,
    SearchRelays,
    served_centres,
    served_heights,
    total_service,
)
from eia_sec.rollout.heuristics.static import StaticPolicy
from eia_sec.rollout.heuristics.steering import keep_apart, loiter_speed, towards
from eia_sec.rollout.heuristics.tasks import greedy, horizon, hungarian
from eia_sec.rollout.heuristics.tasks.greedy import best_targets
from eia_sec.rollout.heuristics.tasks.hungarian import HungarianGroupPolicy, chain_value
from eia_sec.rollout.heuristics.tasks.lawnmower import INSET, collection_routes
from eia_sec.rollout.heuristics.tasks.sites import steps_between
from eia_sec.rollout.heuristics.tasks.tour import grouped_tours, plot_tours, short_tour, tries
from eia_sec.rollout.policies import policy_of
from eia_sec.rollout.sim.batch import FarmBatch
from eia_sec.rollout.sim.boxes import aim, inside, reach, steps_to
from eia_sec.rollout.sim.core.constants import constants
from eia_sec.rollout.sim.sweep_routes import plot_centres, round_steps, sweep_routes
from tests.rollout.heuristics.small_farm import SMALL

WORLD = SMALL.world
ODD = [
    WorldConfig(communication_uavs=3, monitoring_uavs=1, collection_uavs=1, steps=40),
    WorldConfig(communication_uavs=1, monitoring_uavs=7, collection_uavs=3, field_x=90.0, steps=40, sensors=50),
    WorldConfig(communication_uavs=2, monitoring_uavs=9, collection_uavs=9, plots_x=2, plots_y=3, steps=40),
    WorldConfig(communication_uavs=2, monitoring_uavs=3, collection_uavs=3, plots_x=1, plots_y=1, steps=40),
    WorldConfig(monitoring_uavs=2, collection_uavs=2, sensors=12, steps=40, start_levels="random"),
]


def begin(config, policy, seeds):
    farms = FarmBatch(config, len(seeds))
    for index, (farm, episode) in enumerate(seeds):
        farms.reset(index, farm, episode)
        policy.reset(farms, index)
    return farms


def course(config, policy, farms, steps):
    actions = []
    for _ in range(steps):
        actions.append(policy.act(farms))
        farms.step(actions[-1])
    return np.stack(actions)


def state(config=SMALL, farm=7, steps=0):
    policy = StaticPolicy()
    farms = begin(config, policy, [(farm, 1)])
    for _ in range(steps):
        farms.step(policy.act(farms))
    policy = CompositePolicy(config, CentroidRelays, greedy.monitors, greedy.collectors)
    policy.reset(farms, 0)
    return policy._farm_state(farms, 0)


@pytest.mark.parametrize("name", HEURISTICS)
def test_heuristics_act_within_the_range(name):
    """Every heuristic gives float32 rows in [-1, 1] for every environment, step after step."""
    policy = policy_of(name, SMALL)
    farms = begin(SMALL, policy, [(7, 0), (8, 1), (9, 2)])
    actions = course(SMALL, policy, farms, 60)
    assert actions.shape == (60, 3, farms.team.action_size)
    assert actions.dtype == np.float32
    assert np.abs(actions).max() <= 1.0


@pytest.mark.parametrize("world", ODD)
@pytest.mark.parametrize("name", TASKS)
def test_heuristics_fly_every_team_and_field(name, world):
    """Odd teams and fields, with more UAVs than columns, plots or stops, are flown without leaving the field."""
    config = FarmConfig(world=world)
    result = evaluate(config, policy_of(name, config), [1], 1, name=name)
    assert np.isfinite(result.total.reward)
    assert result.total.metrics["boundary"] == 0.0


@pytest.mark.parametrize("name", HEURISTICS)
def test_an_episode_depends_on_its_seeds_alone(name):
    """The same seeds give the same actions at any place of any batch, and after another episode."""
    alone, beside = policy_of(name, SMALL), policy_of(name, SMALL)
    one, two = begin(SMALL, alone, [(5, 6)]), begin(SMALL, beside, [(8, 2), (5, 9)])
    course(SMALL, beside, two, 3)
    two.reset(1, 5, 6)
    beside.reset(two, 1)
    first, second = course(SMALL, alone, one, 50), course(SMALL, beside, two, 50)
    np.testing.assert_array_equal(first[:, 0], second[:, 1])


def test_task_heuristics_beat_chance():
    """On two small farms each task heuristic earns several times what random flight and hovering earn."""
    totals = {name: evaluate(SMALL, policy_of(name, SMALL), [100, 101], 1, name=name).total for name in HEURISTICS}
    chance = totals["random"]
    for name in TASKS:
        found = totals[name]
        assert found.types["monitoring"] > 3.0 * max(chance.types["monitoring"], 100.0)
        assert found.types["collection"] > 1.5 * max(chance.types["collection"], 100.0)
        assert found.metrics["aoi"] < 0.8 * chance.metrics["aoi"]
        assert found.metrics["vdf"] < 0.8 * chance.metrics["vdf"]
        assert found.reward > 300.0 + max(chance.reward, totals["static"].reward)
        assert found.metrics["collisions"] == 0.0


def test_towards_flies_straight_at_full_speed_and_stops_at_the_target():
    """Far targets are flown to with one component at its limit, near ones are hit within the step."""
    position = np.array([[0.0, 0.0], [100.0, 100.0]])
    far = towards(position, np.array([[100.0, 50.0], [100.0, 100.0]]), WORLD)
    np.testing.assert_allclose(far, [[1.0, 0.5], [0.0, 0.0]])
    near = np.array([[3.0, -4.0], [101.0, 95.0]])
    np.testing.assert_allclose(position + towards(position, near, WORLD) * reach(WORLD), near)


def test_keep_apart_stops_what_closes_in_and_nothing_else():
    """Two UAVs head-on stop closing in; those that part, slide past or are far away fly on."""
    position = np.array([[[100.0, 100.0], [120.0, 100.0], [300.0, 100.0], [300.0, 120.0]]])
    action = np.array([[[1.0, 0.5], [-1.0, 0.0], [0.0, -1.0], [0.0, 1.0]]])
    kept = keep_apart(position, action, WorldConfig())
    np.testing.assert_allclose(kept, [[[0.0, 0.5], [0.0, 0.0], [0.0, -1.0], [0.0, 1.0]]], atol=1e-12)


def test_keep_apart_never_lets_a_pair_close_in():
    """After random motions of two UAVs under d_safety the pair is never nearer than before."""
    generator = np.random.default_rng(0)
    position = generator.uniform(90.0, 110.0, (200, 2, 2))
    action = keep_apart(position, generator.uniform(-1.0, 1.0, (200, 2, 2)), WORLD)
    before = np.linalg.norm(position[:, 0] - position[:, 1], axis=1)
    after = np.linalg.norm(np.diff(position + action * reach(WORLD), axis=1)[:, 0], axis=1)
    assert np.abs(action).max() <= 1.0
    clipped = np.abs(action).max(axis=(1, 2)) == 1.0
    assert (after >= before - 1e-9)[~clipped].all()


def test_keep_apart_keeps_everybody_over_the_field():
    """A motion that would end outside the field ends just inside its edge."""
    position = np.array([[[199.0, 5.0]]])
    end = position + keep_apart(position, np.array([[[1.0, -1.0]]]), WORLD) * reach(WORLD)
    assert (end > 0.0).all()
    assert (end < 200.0).all()
    np.testing.assert_allclose(end, [[[200.0, 0.0]]], atol=0.01)


def test_aim_takes_the_fewest_steps_and_then_the_side_of_the_next_box():
    """Along each axis the place is the one nearest to the next box among those reached in the fewest steps."""
    box, onward = np.array([[20.0, 0.0], [30.0, 40.0]]), np.array([[50.0, 60.0], [60.0, 70.0]])
    place = aim(np.array([5.0, 10.0]), box, onward, WORLD)
    np.testing.assert_allclose(place, [25.0, 30.0])
    assert steps_to(np.array([5.0, 10.0]), box, WORLD) == 2
    assert steps_to(np.array([25.0, 10.0]), box, WORLD) == 1
    assert inside(place, box)
    assert not inside(place + 10.0, box)


@pytest.mark.parametrize("wind", [None, np.array([0.4, -0.25])], ids=["calm", "wind"])
def test_aim_never_costs_a_step(wind):
    """From random places the box is reached after as many steps as `steps_to` says, and no sooner."""
    generator = np.random.default_rng(3)
    for _ in range(50):
        corner = generator.uniform(0.0, 180.0, (2, 2))
        box, onward = (np.stack([low, low + 12.0]) for low in corner)
        position = generator.uniform(0.0, 200.0, 2)
        wanted = int(steps_to(position, box, WORLD, wind))
        place = aim(position, box, onward, WORLD, wind)
        for step in range(wanted):
            assert step == 0 or not inside(position, box)
            position = position + towards(position, place, WORLD, wind) * reach(WORLD)
        assert inside(position, box)


def test_who_waits_flies_at_the_cheapest_speed():
    """Flight is cheapest at 0.41 m/s; a waiting UAV flies back and forth at that speed."""
    assert loiter_speed(SMALL) == pytest.approx(0.41, abs=0.02)
    policy = policy_of("lawnmower", SMALL)
    farms = begin(SMALL, policy, [(7, 1)])
    start = farms.position[0, 0].copy()
    course(SMALL, policy, farms, 100)
    assert np.linalg.norm(farms.position[0, 0] - start) < 1.0
    assert farms.energy[0, 0] == pytest.approx(1.6 + 20.2, abs=0.05)


@pytest.mark.parametrize("uavs", [1, 3, 4, 7, 20, 33, 64])
def test_lawnmower_sweeps_every_plot_once(uavs):
    """All monitors together pass every plot once in a lap, one per step inside a lane of two."""
    config = FarmConfig(world=WorldConfig(monitoring_uavs=uavs))
    routes = sweep_routes(config)
    assert len(routes) == uavs
    visited = np.concatenate([(route.mean(axis=0) // 20.0) @ (20, 1) for route in routes])
    np.testing.assert_array_equal(np.sort(visited), np.arange(400))
    if uavs == 4:
        assert max(round_steps(route, config.world) for route in routes) <= 126


@pytest.mark.parametrize("uavs", [1, 3, 4, 7, 20, 64])
def test_collection_lanes_pass_near_every_place(uavs):
    """Every place of the field lies within INSET of a lane of some area, aside or beyond its end."""
    place = np.stack(np.meshgrid(np.arange(0.0, 401.0, 5.0), np.arange(0.0, 401.0, 5.0)), axis=-1).reshape(-1, 2)
    nearest = np.full(len(place), np.inf)
    routes = collection_routes(WorldConfig(collection_uavs=uavs))
    assert len(routes) == uavs
    for route in routes:
        for start, end in route.mean(axis=0).reshape(-1, 2, 2):
            low, high = sorted((start[1], end[1]))
            beyond = np.abs(place[:, 1] - np.clip(place[:, 1], low, high))
            nearest = np.minimum(nearest, np.maximum(np.abs(place[:, 0] - start[0]), beyond))
    assert nearest.max() <= INSET


def test_greedy_targets_are_not_shared():
    """Targets are apart, the first UAV gets the best one, and a target is kept while its value is above 0."""
    generator = np.random.default_rng(1)
    centre = plot_centres(WorldConfig())
    steps = generator.uniform(1.0, 40.0, (5, 400))
    value = generator.integers(0, 6, 400).astype(float)
    chosen = best_targets(value, steps, centre, np.full(5, -1), 1.0, 60.0)
    gap = np.linalg.norm(centre[chosen][:, None] - centre[chosen], axis=-1) + 1e9 * np.eye(5)
    assert gap.min() >= 60.0
    assert chosen[0] == (value / (steps[0] + 1.0)).argmax()
    value[chosen[2]] = 0.0
    after = best_targets(value, steps[::-1], centre, chosen, 1.0, 60.0)
    assert ((after == chosen) == (np.arange(5) != 2)).all()


def test_greedy_stays_when_nothing_is_worth_a_flight():
    """With every value at 0 no UAV has a target, and with one target for two UAVs one has none."""
    centre, steps = np.array([[15.0, 15.0], [25.0, 15.0]]), np.array([[1.0, 2.0], [9.0, 9.0]])
    nobody = np.array([-1, -1])
    assert best_targets(np.zeros(2), steps, centre, nobody, 1.0, 40.0).tolist() == [-1, -1]
    assert best_targets(np.array([1.0, 5.0]), steps, centre, nobody, 1.0, 40.0).tolist() == [1, -1]


def test_tours_visit_every_stop_once():
    """k-means groups hold every stop once; each tour is as short as the best order of a small group."""
    generator = np.random.default_rng(4)
    stops = generator.uniform(0.0, 200.0, (24, 2))
    tours = grouped_tours(stops, 4, WORLD, generator, 5)
    np.testing.assert_array_equal(np.sort(np.concatenate(tours)), np.arange(24))
    ring = np.array([(np.cos(a), np.sin(a)) for a in generator.permutation(12) * np.pi / 6]) * 80.0 + 100.0
    tour, length = short_tour(ring, WORLD)
    around = np.argsort(np.arctan2(*(ring - 100.0).T))
    steps = steps_between(ring, ring, WORLD)
    assert length <= steps[around, np.roll(around, -1)].sum() + 1e-9
    assert length == pytest.approx(steps[tour, np.roll(tour, -1)].sum())


def test_tours_of_many_stops_are_tried_less_often():
    """Up to 128 places every start is tried, beyond that fewer and fewer, and at least one."""
    assert [tries(30, places) for places in (0, 25, 128, 256, 625, 10_000)] == [30, 30, 30, 3, 1, 1]
    assert tries(5, 225) == 5


def test_plot_tours_image_every_plot():
    """The monitors' tours together hold every plot of the field once."""
    tours = plot_tours(WorldConfig())
    assert len(tours) == 4
    assert sorted(plot for tour in tours for plot in tour) == list(range(400))


def test_a_tour_visits_all_its_stops():
    """On its tour every sensor is heard at least once in 200 steps."""
    policy = policy_of("tour", SMALL)
    farms = begin(SMALL, policy, [(3, 1)])
    lowest = np.full(100, np.inf)
    for step in range(200):
        farms.step(policy.act(farms))
        if step >= 60:
            lowest = np.minimum(lowest, farms.aoi[0])
    assert (lowest == 0.0).all()


@pytest.mark.parametrize(("patches", "search"), [(0, (16, 32, 4)), (2, (24, 256, 4))])
def test_horizon_searches_harder_where_there_can_be_stress(patches, search, monkeypatch):
    """Monitors and collectors plan further and keep more paths there; elsewhere monitors sweep at first."""
    asked = []

    def best_path(grid, reward, start, levels, claimed, others, width, same):
        asked.append((len(levels), width, same))
        return np.zeros(len(levels), np.int64)

    monkeypatch.setattr(horizon, "best_path", best_path)
    config = replace(SMALL, stress=StressConfig(patches=patches))
    policy = policy_of("horizon", config)
    policy.act(begin(config, policy, [(7, 0)]))
    assert asked == [search] * (WORLD.collection_uavs + (WORLD.monitoring_uavs if patches else 0))


@pytest.mark.parametrize("kind", [MONITORS, COLLECTORS])
def test_hungarian_flies_alike_whether_ways_are_held_or_not(kind, monkeypatch):
    """Goals are the same in fields with so many targets that flight times between them are computed each time."""
    now = state(SMALL, 7, 90)
    held = HungarianGroupPolicy(now, kind)
    monkeypatch.setattr(hungarian, "MOST_KNOWN", 3)
    anew = HungarianGroupPolicy(now, kind)
    assert (held._known is None, anew._known is None) == (False, True)
    np.testing.assert_array_equal(held.goals(now), anew.goals(now))
    assert (held.chosen >= 0).all()


@pytest.mark.parametrize("kind", [MONITORS, COLLECTORS])
def test_hungarian_sends_no_two_to_one_target(kind):
    """In any state with work, every UAV has a target of its own."""
    config = FarmConfig(world=WorldConfig(monitoring_uavs=8, collection_uavs=8, steps=300))
    for farm in range(5):
        now = state(config, farm, 130)
        group = HungarianGroupPolicy(now, kind)
        group.goals(now)
        assert (group.chosen >= 0).all()
        assert len(set(group.chosen.tolist())) == 8


def test_a_chain_is_worth_its_discounted_visits():
    """Three targets in a row, one step apart: the chain from the first visits each once, none twice."""
    value = np.array([[4.0, 2.0, 1.0]])
    between = 0.5 ** np.array([[1.0, 1.0, 2.0], [1.0, 1.0, 1.0], [2.0, 1.0, 1.0]])
    worth, second = chain_value(np.array([0]), np.array([0.5]), value, between.__getitem__, 3)
    assert worth[0] == pytest.approx(0.5 * 4.0 + 0.25 * 2.0 + 0.125 * 1.0)
    assert second[0] == 1
    worth, second = chain_value(np.array([0]), np.array([0.5]), value, between.__getitem__, 5)
    assert worth[0] == pytest.approx(2.625)


def test_centroid_relays_follow_those_they_serve():
    """A relay's goal is on the way to the centre of its UAVs; one that serves nobody stays."""
    config = FarmConfig(world=WorldConfig(communication_uavs=4, monitoring_uavs=1, collection_uavs=1))
    now = state(config)
    own, served = now.position[:4], now.position[4:]
    centres = served_centres(own, served, now.assignment)
    for relay in range(4):
        mine = served[now.assignment == relay]
        np.testing.assert_allclose(centres[relay], mine.mean(axis=0) if len(mine) else own[relay])
    goals = CentroidRelays(now).goals(now)
    np.testing.assert_allclose(np.linalg.norm(goals - centres, axis=1), 0.98 * np.linalg.norm(own - centres, axis=1))


def test_total_service_is_the_simulators():
    """The relays' local search minimises the same D_c that the simulator computes, with its assignment."""
    config = FarmConfig(world=WorldConfig(communication_uavs=3, monitoring_uavs=4, collection_uavs=3))
    relay = constants(config).relay
    farms = begin(config, StaticPolicy(), [(farm, 1) for farm in range(8)])
    heights = served_heights(state(config))
    for index in range(8):
        total = total_service(config.world, relay, farms.position[index, :3], farms.position[index, 3:], heights)
        assert total == pytest.approx(farms.service[index].sum())


@pytest.mark.parametrize("relays", ["centroid", "search"])
def test_relays_bring_d_c_down(relays):
    """At the end D_c is clearly less than that of relays that stayed, and the search ends lower than it began."""
    policy = policy_of(f"lawnmower+{relays}", FarmConfig())
    farms = begin(FarmConfig(), policy, [(farm, 1) for farm in range(100, 104)])
    before = farms.service.sum(axis=1)
    course(FarmConfig(), policy, farms, 500)
    assert farms.service.sum(axis=1).mean() < before.mean() - 80.0


def test_search_relays_wait_for_the_last_steps():
    """Relays stay until the last steps; then the search finds places no worse than the centres."""
    config = FarmConfig(world=WorldConfig(steps=60))
    early, late = state(config, 3, 0), state(config, 3, 50)
    relays = SearchRelays(early)
    np.testing.assert_array_equal(relays.goals(early), early.position[:4])
    for time in range(50, 60):
        relays.goals(replace(late, time=time))
    own, served = late.position[:4], late.position[4:]
    relay = constants(config).relay
    heights, centres = served_heights(late), served_centres(own, served, late.assignment)
    found = total_service(config.world, relay, relays._places, served, heights)
    assert found < total_service(config.world, relay, centres, served, heights)
