"""UAVs that fail: the configuration, the draws, and cases worked out by hand."""

from dataclasses import replace

import numpy as np
import pytest

from eia_sec.common.config import FailureConfig, FarmConfig, ObservationConfig, RelayConfig, RunConfig, WorldConfig
from eia_sec.common.config.files import from_toml, to_toml, with_setting
from eia_sec.common.errors import ConfigError
from eia_sec.common.farm import METRIC_NAMES, farm_environment, farm_team
from eia_sec.common.farm_observation import observation_names
from eia_sec.rollout.sim.batch import FarmBatch
from eia_sec.rollout.sim.conditions.failures import NEVER, failure_steps
from eia_sec.rollout.sim.core.relays import NO_LINK
from eia_sec.rollout.sim.layout import make_layout
from eia_sec.rollout.sim.reference.farm import ReferenceFarm
from eia_sec.rollout.sim.sweep_routes import all_routes
from tests.rollout.sim.properties.test_properties_added import ALL, ground, placed_batch, views

SMALL = FarmConfig(
    world=WorldConfig(communication_uavs=1, monitoring_uavs=2, collection_uavs=1),
    observation=ObservationConfig(mirrored=False, **ALL),
)
"""The farm of `ground` and `placed_batch`."""


def losing(config: FarmConfig, at: str) -> FarmConfig:
    return replace(config, failures=FailureConfig(at=at))


def hover(batch: FarmBatch, steps: int = 1) -> None:
    for _ in range(steps):
        batch.step(np.zeros((1, batch.team.environment_action_size), np.float32))


@pytest.mark.parametrize(
    ("at", "complaint"),
    [
        ("monitoring 2", "must be like"),
        ("camera 0 at 3", "must be like"),
        ("monitoring 2 at 120; communication 0 at 3", "must be like"),
        ("monitoring 4 at 120", "numbered 0 to 3"),
        ("collection 0 at 0", "numbered 1 to 500"),
        ("collection 0 at 501", "numbered 1 to 500"),
    ],
)
def test_failures_that_cannot_be_are_refused(at, complaint):
    """One sentence says what is wrong."""
    with pytest.raises(ConfigError, match=complaint):
        FarmConfig(failures=FailureConfig(at=at))


def test_a_negative_rate_is_refused():
    """So are NaN and infinity."""
    for rate in (-1.0, float("nan"), float("inf")):
        with pytest.raises(ConfigError, match="per_hour"):
            FailureConfig(per_hour=rate)


def test_failures_in_a_file_and_on_a_command_line():
    """The text comes back as it was, and spaces do not matter."""
    config = with_setting(RunConfig(), 'farm.failures.at="monitoring 2 at 120,  communication 0 at 300"')
    assert config.farm.failures.given() == ((1, 2, 120), (0, 0, 300))
    assert from_toml(to_toml(config), RunConfig()) == config
    assert with_setting(RunConfig(), "farm.failures.per_hour=2").farm.failures.some
    assert not RunConfig().farm.failures.some


def test_the_rate_is_that_of_the_draws():
    """At 3.6 an hour a UAV survives 500 steps of 1 s with a chance of exp(-0.5); the earlier of both counts."""
    config = FarmConfig(failures=FailureConfig(per_hour=3.6, at="monitoring 0 at 1"))
    steps = np.stack([failure_steps(config, 7, episode) for episode in range(500)])
    assert (steps[:, 4] == 1).all()
    random = np.delete(steps, 4, axis=1)
    assert random.min() >= 1
    assert (random > 500).mean() == pytest.approx(np.exp(-0.5), abs=0.02)
    assert (random > 100).mean() == pytest.approx(np.exp(-0.1), abs=0.02)
    np.testing.assert_array_equal(steps[3], failure_steps(config, 7, 3))
    sooner = failure_steps(replace(config, failures=FailureConfig(per_hour=36.0)), 7, 3)
    assert (sooner[1:4] <= random[3, 1:4]).all()
    assert (failure_steps(FarmConfig(), 7, 3) == NEVER).all()


def test_a_uav_is_gone_from_its_step_on():
    """It flies two steps, is gone in the third, and a reset brings it back."""
    batch = FarmBatch(losing(FarmConfig(), "monitoring 2 at 3"), 1)
    for _ in range(2):
        batch.reset(0, 1, 1)
        hover(batch, 2)
        assert not batch.gone.any()
        assert batch.reward[0, 6] != 0.0
        hover(batch)
        assert np.flatnonzero(batch.gone[0]).tolist() == [6]
        assert batch.reward[0, 6] == batch.energy[0, 6] == 0.0
        assert batch.assignment[0, 2] == -1
        assert batch.summary(0).metrics["failed"] == 1.0


def test_only_farms_with_failures_have_the_metric_and_the_observation():
    """Without failures, the names of metrics and observations are as ever."""
    plain, switched = farm_environment(SMALL), farm_environment(losing(SMALL, "monitoring 1 at 1"))
    assert plain.metric_names == METRIC_NAMES
    assert switched.metric_names == (*METRIC_NAMES, "failed")
    for group in plain.team.groups:
        name = group.name
        more = [n for n in switched.tensor_names[name].observation if n not in plain.tensor_names[name].observation]
        assert more == ["alive"]
        assert "alive" in observation_names(losing(SMALL, "monitoring 1 at 1"), name)


def test_a_plot_falls_to_the_next_monitor():
    """The nearer of two monitors would take the image; it fails at once, so the other one does."""
    age, level = ground()
    level[10, 10] = 3.0
    places = np.array([[0.0, 0.0], [205.0, 205.0], [214.0, 214.0], [0.0, 0.0]])
    both, one = (
        placed_batch(SMALL, places, (age, level)),
        placed_batch(losing(SMALL, "monitoring 1 at 1"), places, (age, level)),
    )
    hover(both)
    hover(one)
    np.testing.assert_array_equal(both.utility[0, 1:3], (0.0, 3.0))
    np.testing.assert_array_equal(one.utility[0, 1:3], (3.0, 0.0))


def test_others_do_not_see_it():
    """No peer, no nearest UAV, no risk, half of the type; itself it sees zeros."""
    config = losing(SMALL, "monitoring 1 at 2")
    batch = placed_batch(config, np.array([[0.0, 0.0], [205.0, 205.0], [215.0, 205.0], [0.0, 0.0]]), ground())
    hover(batch)
    before = {name: values.copy() for name, values in views(config, batch, 1).items()}
    hover(batch)
    after = views(config, batch, 1)
    assert (before["peer_0_present"][0], before["alive"][0]) == (1.0, 1.0)
    assert (after["peer_0_present"][0], after["alive"][0]) == (0.0, 0.5)
    assert before["risk_any_move_1_0"][0] > 0.0 == after["risk_any_move_1_0"][0]
    assert tuple(after[f"nearest_uav_{end}"][0] for end in ("dx", "dy", "distance")) == (0.0, 0.0, 1.0)
    assert not any(values[1] for values in after.values())


def test_the_relays_that_are_left_serve_all():
    """Four relays serve two UAVs each. When three are gone, the last one serves all eight, beyond its capacity."""
    config = replace(FarmConfig(), relay=RelayConfig(capacity=2))
    batch = FarmBatch(losing(config, "communication 0 at 2, communication 1 at 3, communication 3 at 4"), 1)
    batch.reset(0, 5, 5)
    for most, alive in ((2, [0, 1, 2, 3]), (3, [1, 2, 3]), (4, [2, 3]), (8, [2])):
        hover(batch)
        assert np.bincount(batch.assignment[0]).max() == most
        assert set(batch.assignment[0].tolist()) == set(alive)
    np.testing.assert_array_equal(batch.service[0, [0, 1, 3]], 0.0)


def test_d_c_of_the_only_relay_that_is_left():
    """It serves one UAV 30 m away and 40 m on, at heights 2 m apart, and is its own centroid of relays."""
    world = WorldConfig(communication_uavs=2, monitoring_uavs=1, collection_uavs=1)
    config = losing(replace(SMALL, world=world), "communication 1 at 1, collection 0 at 1")
    places = np.array([[100.0, 100.0], [300.0, 300.0], [130.0, 140.0], [390.0, 390.0]])
    batch = placed_batch(config, places, ground())
    hover(batch)
    assert batch.service[0, 0] == pytest.approx((0.5 + 0.2) * np.sqrt(30.0**2 + 40.0**2 + 2.0**2))
    assert batch.service[0, 1] == 0.0


@pytest.mark.parametrize("require_link", [False, True])
def test_without_any_relay(require_link):
    """Nobody is served. Images count as printed, because rewards ask for no relay, unless the farm requires a link."""
    age, level = ground()
    level[10, 10] = 3.0
    config = replace(SMALL, relay=RelayConfig(require_link=require_link))
    places = np.array([[205.0, 205.0], [210.0, 210.0], [300.0, 300.0], [0.0, 0.0]])
    batch = placed_batch(losing(config, "communication 0 at 1"), places, (age, level))
    hover(batch)
    assert (batch.assignment == -1).all()
    assert (batch.link_quality == NO_LINK).all()
    assert batch.utility[0, 1] == (0.0 if require_link else 3.0)


def test_a_farm_without_uavs_goes_on():
    """Counters rise to their caps, nobody earns, and the episode ends at its usual step."""
    names = [f"{kind} {rank} at 1" for kind in ("communication", "monitoring", "collection") for rank in range(4)]
    config = losing(RunConfig().farm, ", ".join(names))
    batch = FarmBatch(config, 1)
    batch.reset(0, 0, 0)
    hover(batch, config.world.steps)
    assert batch.truncated.all()
    assert (batch.aoi == config.world.aoi_max).all()
    assert (batch.vdf == config.world.vdf_max).all()
    assert batch.summary(0).reward == (0.0,) * farm_team(config).agents


def test_the_field_is_divided_anew_among_the_monitors_that_are_left():
    """After the step in which one is lost, the routes of the others cover all plots, as the reference says."""
    config = FarmConfig(failures=FailureConfig(at="monitoring 1 at 5, monitoring 3 at 9"))
    config = replace(config, observation=replace(config.observation, route=True))
    batch, farm = FarmBatch(config, 1), ReferenceFarm(config, make_layout(config, 3), 4)
    batch.reset(0, 3, 4)
    routes, random = all_routes(config), np.random.default_rng(0)
    assert len(routes) == 1 + 2 + 3 + 4
    for step in range(1, 16):
        action = random.uniform(-1.0, 1.0, 24).astype(np.float32)
        batch.step(action[None])
        farm.step(action, batch.assignment[0])
        np.testing.assert_allclose(batch.observation[0], farm.observation, rtol=0.0, atol=5e-6)
        left = ~batch.gone[0, 4:8]
        assert left.sum() == (4 if step < 5 else 3 if step < 9 else 2)
        if step in (5, 9):
            continue  # it is lost in this step
        sweep = batch._state.sweep[0][left]
        assert np.array_equal(sweep, farm.sweep[left])
        plots = np.concatenate([routes[route].mean(axis=0) for route in sweep[:, 0]]) // 20.0
        assert len({*map(tuple, plots)}) == 400


def test_without_losses_there_is_one_division():
    """Farms whose UAVs stay need no other routes."""
    assert len(all_routes(FarmConfig())) == 4


def test_teams_of_random_sizes():
    """Each UAV is missing from step 1 on with the given probability, but one of each type is always there."""
    world = WorldConfig(communication_uavs=3, monitoring_uavs=8, collection_uavs=1)
    config = FarmConfig(world=world, failures=FailureConfig(missing=0.5))
    drawn = np.stack([failure_steps(config, 7, episode) for episode in range(400)])
    assert set(np.unique(drawn)) == {1, NEVER}
    left = [(kind == NEVER).sum(axis=1) for kind in np.split(drawn, [3, 11], axis=1)]
    assert [int(count.min()) for count in left] == [1, 1, 1]
    assert [int(count.max()) for count in left] == [3, 8, 1]
    assert left[1].mean() == pytest.approx(4.0, abs=0.3)
    alone = FarmConfig(world=world, failures=FailureConfig(missing=1.0))
    assert (failure_steps(alone, 7, 0) == NEVER).sum() == 3


def test_who_is_missing_is_gone_from_the_first_step_and_changes_no_observation():
    """Nobody observes how many are left, so a policy sees what it would see in a small team."""
    config = replace(SMALL, failures=FailureConfig(missing=1.0))
    assert farm_team(config) == farm_team(SMALL)
    batch = FarmBatch(config, 1)
    batch.reset(0, 3, 5)
    hover(batch)
    assert batch.gone[0].sum() == 1
    assert (batch.observation[0][np.isnan(batch.observation[0])].size, batch.assignment[0].min()) == (0, -1)
    with pytest.raises(ConfigError, match="missing"):
        FailureConfig(missing=1.5)
