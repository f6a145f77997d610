import dataclasses
import json

import numpy as np
import pytest

from eia_sec.common.actors import TeamActors
from eia_sec.common.config import FarmConfig, WorldConfig
from eia_sec.common.errors import ConfigError, PolicyError
from eia_sec.common.farm import farm_team
from eia_sec.rollout.evaluation import episode_seed, evaluate, record
from eia_sec.rollout.policies import ActorPolicy, policy_of
from eia_sec.rollout.sim.batch import FarmBatch

SMALL = FarmConfig(
    world=WorldConfig(communication_uavs=1, monitoring_uavs=2, collection_uavs=3, sensors=60, steps=50, field_x=200.0)
)


def policy(name):
    if name == "actors":
        return ActorPolicy(TeamActors.initial(farm_team(SMALL), 32, 5, per_type=False))
    return policy_of(name, SMALL)


@pytest.mark.parametrize("name", ["actors", "random", "lawnmower", "greedy"])
def test_results_do_not_depend_on_batch_or_order(name):
    """Each farm's result is bit-equal whatever is flown beside it, before it or after it."""
    farms = (1003, 1000, 1001, 1002, 1007)
    whole = evaluate(SMALL, policy(name), farms, 2, name=name, batch=32)
    single = evaluate(SMALL, policy(name), farms, 2, name=name, batch=1)
    waves = evaluate(SMALL, policy(name), farms, 2, name=name, batch=3)
    turned = evaluate(SMALL, policy(name), farms[::-1], 2, name=name, batch=4)
    assert whole == single == waves
    assert whole.per_farm == turned.per_farm[::-1]


def test_json_has_exactly_the_promised_keys():
    """The dictionary has the documented keys at every level and survives JSON."""
    result = evaluate(SMALL, policy("random"), range(1000, 1002), 2, name="random").to_dict()
    rest = {"steps", "aoi", "vdf", "collisions", "boundary", "energy_j"}
    assert set(result) == {"policy", "farms", "episodes", "reward", "per_farm"} | rest
    assert set(result["reward"]) == {"mean", "c", "m", "d"}
    assert [set(farm) for farm in result["per_farm"]] == [{"farm", "reward", "c", "m", "d"} | rest] * 2
    assert (result["policy"], result["farms"], result["episodes"]) == ("random", [1000, 1001], 2)
    assert json.loads(json.dumps(result)) == result


def test_means_are_those_of_the_episodes():
    """Rewards, levels, counts and energy are the plain means of what the farms themselves sum up."""
    flown = FarmBatch(SMALL, 1)
    fly = policy("lawnmower")
    summaries = []
    for episode in range(2):
        flown.reset(0, 1000, episode_seed(1000, episode))
        fly.reset(flown, 0)
        for _ in range(SMALL.world.steps):
            flown.step(fly.act(flown))
        summaries.append(flown.summary(0))
    result = evaluate(SMALL, policy("lawnmower"), [1000], 2, name="lawnmower").to_dict()
    reward = np.mean([summary.reward for summary in summaries], axis=0)
    assert result["reward"]["mean"] == pytest.approx(reward.mean())
    assert result["reward"]["c"] == pytest.approx(reward[:1].mean())
    assert result["reward"]["m"] == pytest.approx(reward[1:3].mean())
    assert result["reward"]["d"] == pytest.approx(reward[3:].mean())
    for key in ("aoi", "vdf", "collisions", "boundary", "energy_j"):
        assert result[key] == pytest.approx(np.mean([summary.metrics[key] for summary in summaries]))
        assert result["per_farm"][0][key] == pytest.approx(result[key])


def test_a_recorded_episode_is_the_evaluated_one():
    """Recording flies the same episode, keeps T + 1 places and the state at the end."""
    trajectory = record(SMALL, policy("greedy"), 1001, 1)
    evaluation = evaluate(SMALL, policy("greedy"), [1001], 2, name="greedy")
    first = evaluate(SMALL, policy("greedy"), [1001], 1, name="greedy")
    assert 2 * evaluation.total.reward - first.total.reward == pytest.approx(np.mean(trajectory.summary.reward))
    assert trajectory.position.shape == (51, 6, 2)
    assert trajectory.sensor_xy.shape == (60, 2)
    assert trajectory.assignment.shape == (5,)
    assert trajectory.aoi[-1] == pytest.approx(trajectory.final_aoi.mean())
    assert trajectory.vdf[-1] == pytest.approx(trajectory.final_vdf.mean())
    step = np.abs(np.diff(trajectory.position, axis=0))
    assert 0.0 < step.max() <= 10.0 + 1e-4


def test_episodes_of_a_farm_differ():
    """Two episodes of one farm start at different places, two farms have different sensors."""
    one, other, elsewhere = (record(SMALL, policy("static"), *job) for job in ((5, 0), (5, 1), (6, 0)))
    assert not np.array_equal(one.position[0], other.position[0])
    np.testing.assert_array_equal(one.sensor_xy, other.sensor_xy)
    assert not np.array_equal(one.sensor_xy, elsewhere.sensor_xy)


@pytest.mark.parametrize(("farms", "episodes", "batch"), [((), 1, 1), ((1,), 0, 1), ((1,), 1, 0)])
def test_nothing_to_fly_is_refused(farms, episodes, batch):
    """Evaluations without farm, episode or environment are an error, not an empty mean."""
    with pytest.raises(ConfigError, match="at least one"):
        evaluate(SMALL, policy("static"), farms, episodes, name="static", batch=batch)


def test_actors_of_another_team_are_refused():
    """Actors that do not fit the farm are refused before the first step."""
    other = dataclasses.replace(SMALL, world=dataclasses.replace(SMALL.world, monitoring_uavs=3))
    with pytest.raises(
        PolicyError, match=r"this environment has 1 communication agents with \d+ inputs.*, 3 monitoring"
    ):
        evaluate(other, policy("actors"), [1], 1, name="actors")
