import numpy as np
import pytest

from common.actors import ActorBank
from common.config import FarmConfig, WorldConfig
from common.errors import PolicyError
from common.policy_file import save_policy
from common.team import farm_team
from rollout import policies
from rollout.evaluation import evaluate
from rollout.farms import FarmBatch
from rollout.heuristics.greedy import choose_targets, plot_centres
from rollout.heuristics.lawnmower import collection_areas, monitoring_areas
from rollout.heuristics.steering import keep_apart, reach, relay_targets, towards
from rollout.policies import HEURISTICS, POLICIES, ActorPolicy, policy_of

SMALL = FarmConfig(
    world=WorldConfig(
        communication_uavs=1,
        monitoring_uavs=2,
        collection_uavs=2,
        field_x=200.0,
        field_y=200.0,
        sensors=100,
        plots_x=10,
        plots_y=10,
        steps=300,
    )
)
WORLD = SMALL.world


def begin(config, policy, environments=3):
    farms = FarmBatch(config, environments)
    for index in range(environments):
        farms.reset(index, 7 + index, index)
        policy.reset(farms, index)
    return farms


def reward(name, config=SMALL):
    return evaluate(config, policy_of(name, config), range(100, 104), 1, name=name).total


@pytest.mark.parametrize("name", HEURISTICS)
def test_heuristics_act_within_the_range(name):
    """Every heuristic gives float32 rows in [-1, 1] for every environment, step after step."""
    policy = policy_of(name, SMALL)
    farms = begin(SMALL, policy)
    for _ in range(60):
        action = policy.act(farms)
        assert action.shape == (3, farms.team.action_size)
        assert action.dtype == np.float32
        assert np.abs(action).max() <= 1.0
        farms.step(action)


@pytest.mark.parametrize(
    "world",
    [
        WorldConfig(communication_uavs=3, monitoring_uavs=1, collection_uavs=1, steps=40),
        WorldConfig(communication_uavs=1, monitoring_uavs=7, collection_uavs=3, field_x=90.0, steps=40, sensors=50),
        WorldConfig(communication_uavs=2, monitoring_uavs=9, collection_uavs=9, plots_x=2, plots_y=3, steps=40),
        WorldConfig(communication_uavs=2, monitoring_uavs=3, collection_uavs=3, plots_x=1, plots_y=1, steps=40),
    ],
)
@pytest.mark.parametrize("name", ["lawnmower", "greedy"])
def test_heuristics_fly_every_team_and_field(name, world):
    """Odd teams and fields, with more UAVs than columns or plots, are flown without leaving the field."""
    config = FarmConfig(world=world)
    result = evaluate(config, policy_of(name, config), [1], 1, name=name)
    assert np.isfinite(result.total.reward)
    assert result.total.boundary == 0.0


def test_lawnmower_and_greedy_beat_random():
    """On a small farm both heuristics earn several times what random flight earns, for both kinds of work."""
    by_name = {name: reward(name) for name in ("static", "random", "lawnmower", "greedy")}
    chance = by_name["random"]
    for name in ("lawnmower", "greedy"):
        assert by_name[name].monitoring > 3.0 * max(chance.monitoring, 100.0)
        assert by_name[name].collection > 1.5 * max(chance.collection, 100.0)
        assert by_name[name].aoi < chance.aoi
        assert by_name[name].vdf < chance.vdf


def test_static_moves_nobody():
    """The static policy leaves every UAV where it started."""
    policy = policy_of("static", SMALL)
    farms = begin(SMALL, policy)
    before = np.array(farms.position)
    for _ in range(5):
        farms.step(policy.act(farms))
    np.testing.assert_array_equal(farms.position, before)


def test_random_depends_on_the_episode_alone():
    """The same episode gets the same random actions at any place in any batch; another episode gets others."""
    alone, beside = policy_of("random", SMALL), policy_of("random", SMALL)
    one, two = FarmBatch(SMALL, 1), FarmBatch(SMALL, 2)
    one.reset(0, 5, 6)
    two.reset(1, 5, 6)
    two.reset(0, 5, 7)
    alone.reset(one, 0)
    beside.reset(two, 1)
    beside.reset(two, 0)
    for _ in range(3):
        rows = beside.act(two)
        np.testing.assert_array_equal(alone.act(one)[0], rows[1])
        assert not np.array_equal(rows[0], rows[1])


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


def test_relays_aim_at_the_centre_of_those_they_serve():
    """A relay's target is the mean place of the UAVs assigned to it."""
    config = FarmConfig(world=WorldConfig(communication_uavs=2, monitoring_uavs=2, collection_uavs=2))
    farms = begin(config, policy_of("static", config), 2)
    target = relay_targets(farms)
    for environment in range(2):
        for relay in range(2):
            served = 2 + np.flatnonzero(farms.assignment[environment] == relay)
            np.testing.assert_allclose(target[environment, relay], farms.position[environment, served].mean(axis=0))


def test_a_relay_that_serves_nobody_stays():
    """With more relays than others, a relay without work aims at its own place."""
    config = FarmConfig(world=WorldConfig(communication_uavs=4, monitoring_uavs=1, collection_uavs=1))
    farms = begin(config, policy_of("static", config), 1)
    idle = np.setdiff1d(np.arange(4), farms.assignment[0])
    assert len(idle) >= 2
    np.testing.assert_array_equal(relay_targets(farms)[0, idle], farms.position[0, idle])


@pytest.mark.parametrize("uavs", [1, 3, 4, 7, 20, 33, 64])
def test_monitoring_areas_cover_every_plot_once(uavs):
    """Lane centres of all areas together pass every plot of the field exactly once."""
    world = WorldConfig(monitoring_uavs=uavs)
    areas = monitoring_areas(world)
    assert len(areas) == uavs
    covered = np.zeros((20, 20), int)
    for area in areas:
        columns = slice(round(area.x[0] / 20), round(area.x[1] / 20))
        covered[columns, round(area.y[0] / 20) : round(area.y[1] / 20)] += 1
        assert area.lanes == columns.stop - columns.start
        np.testing.assert_allclose(area.path() % 20.0, 10.0)
    assert (covered == 1).all()


@pytest.mark.parametrize("uavs", [1, 3, 4, 7, 20, 64])
def test_collection_lanes_pass_near_every_sensor(uavs):
    """Every place of the field lies within 25 m of a lane of some area, aside or beyond its end."""
    place = np.stack(np.meshgrid(np.arange(0.0, 401.0, 5.0), np.arange(0.0, 401.0, 5.0)), axis=-1).reshape(-1, 2)
    nearest = np.full(len(place), np.inf)
    areas = collection_areas(WorldConfig(collection_uavs=uavs))
    assert len(areas) == uavs
    for area in areas:
        for start, end in area.path().reshape(-1, 2, 2):
            low, high = sorted((start[1], end[1]))
            aside = np.abs(place[:, 0] - start[0])
            beyond = np.abs(place[:, 1] - np.clip(place[:, 1], low, high))
            nearest = np.minimum(nearest, np.maximum(aside, beyond))
    assert nearest.max() <= 25.0


def test_lawnmower_images_every_plot_of_its_part():
    """On the way up and back every plot is imaged at least once after its VDF has begun to rise."""
    config = FarmConfig(world=WorldConfig(steps=500))
    policy = policy_of("lawnmower", config)
    farms = begin(config, policy, 1)
    lowest = np.full((20, 20), np.inf)
    for step in range(500):
        farms.step(policy.act(farms))
        if step > 60:
            lowest = np.minimum(lowest, farms.vdf[0])
    assert (lowest == 0).all()


def test_greedy_targets_are_not_shared():
    """Each target is apart from every other UAV's, and the first UAV gets the best one."""
    generator = np.random.default_rng(1)
    position = generator.uniform(0.0, 400.0, (6, 5, 2))
    target = np.broadcast_to(plot_centres(WorldConfig()), (6, 400, 2))
    value = generator.integers(0, 6, (6, 400)).astype(float)
    chosen = choose_targets(position, target, value, 20.0, 40.0)
    gap = np.linalg.norm(chosen[:, None] - chosen[:, :, None], axis=-1) + 1e9 * np.eye(5)
    assert gap.min() >= 40.0
    best = (value / (np.linalg.norm(target - position[:, None, 0], axis=2) + 20.0)).argmax(axis=1)
    np.testing.assert_array_equal(chosen[:, 0], target[np.arange(6), best])


def test_greedy_stays_when_nothing_is_worth_a_flight():
    """With every value at 0, and with one target for two UAVs, whoever gets none keeps its place."""
    position = np.array([[[10.0, 10.0], [20.0, 200.0]]])
    target = np.array([[[15.0, 15.0], [25.0, 15.0]]])
    np.testing.assert_array_equal(choose_targets(position, target, np.zeros((1, 2)), 20.0, 40.0), position)
    chosen = choose_targets(position, target, np.array([[1.0, 5.0]]), 20.0, 40.0)
    np.testing.assert_array_equal(chosen, [[[25.0, 15.0], [20.0, 200.0]]])


def test_actor_policy_equals_its_bank():
    """The actor policy does what the bank computes from the observation."""
    bank = ActorBank.initial(farm_team(SMALL), 16, 3, per_type=False)
    policy = ActorPolicy(bank)
    farms = begin(SMALL, policy)
    np.testing.assert_allclose(policy.act(farms), bank.act(farms.observation), atol=1e-6)


def test_actors_of_another_team_are_refused():
    """A policy for other observations or counts is a PolicyError that names both teams."""
    policy = ActorPolicy(ActorBank.initial(farm_team(FarmConfig()), 16, 3))
    farms = FarmBatch(SMALL, 1)
    farms.reset(0, 1, 1)
    with pytest.raises(PolicyError, match=r"4 monitoring UAVs .* the farm has .* 2 monitoring UAVs"):
        policy.reset(farms, 0)


def test_a_policy_file_is_a_policy(tmp_path):
    """A path in place of a name gives the file's actors."""
    bank = ActorBank.initial(farm_team(SMALL), 16, 3)
    save_policy(tmp_path / "mine.safetensors", bank, {})
    farms = begin(SMALL, ActorPolicy(bank))
    flown = policy_of(str(tmp_path / "mine.safetensors"), SMALL)
    np.testing.assert_array_equal(flown.act(farms), ActorPolicy(bank).act(farms))


def test_the_trained_policy_is_that_of_the_package(tmp_path, monkeypatch):
    """The name `trained` loads the shipped file, and says so when there is none or when the team differs."""
    monkeypatch.setattr(policies, "TRAINED", tmp_path / "default.safetensors")
    with pytest.raises(PolicyError, match="no trained policy is part of this installation"):
        policy_of("trained", SMALL)
    save_policy(policies.TRAINED, ActorBank.initial(farm_team(SMALL), 16, 3), {})
    assert isinstance(policy_of("trained", SMALL), ActorPolicy)
    with pytest.raises(PolicyError, match="the farm has"):
        policy_of("trained", FarmConfig())


def test_an_unknown_policy_is_refused_with_the_known_names():
    """A name that is neither a policy nor a file gives one sentence with every name."""
    with pytest.raises(PolicyError) as refused:
        policy_of("nobody", SMALL)
    assert all(name in str(refused.value) for name in POLICIES)
