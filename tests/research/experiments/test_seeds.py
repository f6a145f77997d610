"""When a run's training reward reached a goal, and relays that a heuristic flies."""

import json
from dataclasses import replace

import numpy as np
import pytest

from eia_sec.common.config.presets import preset
from eia_sec.common.errors import UsageError
from eia_sec.rollout.policies import policy_of
from eia_sec.rollout.sim.batch import FarmBatch
from research.experiments.seeds import SCRIPT, Arguments, _earlier, intervals, merged, reached, scripted_relays


def record(episodes, time, mean):
    return {"kind": "episodes", "episodes": episodes, "time": time, "reward": {"mean": mean}}


RECORDS = [{"kind": "status"}, *(record(16 * (k + 1), 2.0 * k, 100.0 * k) for k in range(8))]


def test_the_mean_of_the_newest_64_episodes_counts():
    """Rewards 0, 100, 200, ... by 16 episodes: the mean of four of them reaches 350 at the sixth."""
    assert reached(RECORDS, 150.0) == 6.0
    assert reached(RECORDS, 350.0) == 10.0


def test_a_goal_that_is_never_reached():
    """The best mean of four is 550; a single lucky record before 64 episodes does not count either."""
    assert reached(RECORDS, 551.0) is None
    assert reached([record(16, 1.0, 900.0)], 500.0) is None


def test_scripted_relays_leave_the_others_to_the_policy():
    """Relays do what the heuristic does on the same farm, and monitors and collectors what the policy does."""
    farm = preset("instant").farm
    policies = scripted_relays(policy_of("greedy", farm), farm), policy_of(SCRIPT, farm), policy_of("greedy", farm)
    batch = FarmBatch(farm, 1)
    batch.reset(0, 1000, 0)
    for policy in policies:
        policy.reset(batch, 0)
    relays = 2 * farm.world.communication_uavs
    for _ in range(3):
        mixed, scripted, own = (policy.act(batch) for policy in policies)
        np.testing.assert_array_equal(mixed[:, :relays], scripted[:, :relays])
        np.testing.assert_array_equal(mixed[:, relays:], own[:, relays:])
        assert not np.array_equal(own[:, relays:], scripted[:, relays:])
        batch.step(mixed)


def test_runs_of_several_days_are_one_result():
    """A seed that was trained again takes the earlier run's place; intervals are over all seeds."""
    first = {"commit": "a", "reward": {"mean": 2.0}, "aoi": 0.5, "vdf": 3.0}
    again = {"seed": 1, "commit": "b", "reward": {"mean": 6.0}, "aoi": 0.3, "vdf": 1.0}
    runs = merged([{"seed": 1, **first}, {"seed": 0, **first}], [again])
    assert [(run["seed"], run["commit"]) for run in runs] == [(0, "a"), (1, "b")]
    found = intervals(runs)
    assert [found[name][0] for name in ("reward", "aoi", "vdf")] == [4.0, 0.4, 2.0]
    assert found["reward"][1:] == [2.0, 6.0]


def test_runs_of_another_preset_are_not_added(tmp_path):
    """Beside each other they would count as seeds of one."""
    data = {
        "command": "eia-sec train --preset long --seed SEED",
        "first_farm": 1020,
        "farms": 80,
        "runs": [{"seed": 3}],
    }
    (tmp_path / "seeds.json").write_text(json.dumps(data))
    asked = Arguments((), "c", preset="long", add=True, write=tmp_path / "seeds.json")
    assert _earlier(asked) == [{"seed": 3}]
    with pytest.raises(UsageError, match="another preset"):
        _earlier(replace(asked, preset="instant"))
