"""Heuristics when UAVs fail: the others divide the field anew, and nobody reckons with a UAV that is gone."""

from dataclasses import replace

import numpy as np
import pytest

from eia_sec.common.config import FailureConfig, FarmConfig, WorldConfig
from eia_sec.rollout.heuristics.composite import left_over
from eia_sec.rollout.heuristics.registry import TASKS
from eia_sec.rollout.policies import policy_of
from eia_sec.rollout.sim.batch import FarmBatch

SHORT = FarmConfig(world=WorldConfig(steps=70, start_levels="random"))


def flown(name: str, config: FarmConfig, steps: int) -> tuple[FarmBatch, np.ndarray]:
    """Fly a heuristic; return the batch and the actions [T, A]."""
    batch, policy, actions = FarmBatch(config, 1), policy_of(name, config), []
    batch.reset(0, 1, 2)
    policy.reset(batch, 0)
    for _ in range(steps):
        actions.append(policy.act(batch)[0])
        batch.step(actions[-1][None])
    return batch, np.stack(actions)


@pytest.mark.parametrize("name", [*TASKS, "lawnmower+centroid"])
def test_every_heuristic_flies_on(name):
    """Some UAVs of each type fail, then all relays, then all monitors; the collectors that are left still earn."""
    gone = ", ".join(
        ["monitoring 1 at 10", "collection 3 at 10", "collection 0 at 20", "communication 2 at 20"]
        + [f"communication {rank} at 40" for rank in (0, 1, 3)]
        + [f"monitoring {rank} at 50" for rank in (0, 2, 3)]
    )
    batch, actions = flown(name, replace(SHORT, failures=FailureConfig(at=gone)), 70)
    assert np.isfinite(actions).all()
    assert batch.utility[0, 9:11].sum() >= 0.0
    assert np.flatnonzero(~batch.gone[0]).tolist() == [9, 10]


def test_relays_without_anybody_to_serve():
    """All monitors and collectors fail; the relays fly on until the last step."""
    gone = ", ".join(f"{kind} {rank} at 5" for kind in ("monitoring", "collection") for rank in range(4))
    _, actions = flown("lawnmower+search", replace(SHORT, failures=FailureConfig(at=gone)), 70)
    assert np.isfinite(actions).all()


def test_nothing_changes_before_the_first_failure():
    """The flight until then is that of the farm without failures, bit by bit."""
    plain = flown("lawnmower", SHORT, 30)[1]
    np.testing.assert_array_equal(
        flown("lawnmower", replace(SHORT, failures=FailureConfig(per_hour=1e-9)), 30)[1], plain
    )
    late = flown("lawnmower", replace(SHORT, failures=FailureConfig(at="monitoring 0 at 21")), 30)[1]
    np.testing.assert_array_equal(late[:21], plain[:21])
    assert (late[21:, 10:16] != plain[21:, 10:16]).any()


def test_the_living_sweep_the_whole_field():
    """One monitor of four fails early. The other three divide the field anew and serve every plot."""
    config = replace(FarmConfig(), failures=FailureConfig(at="monitoring 0 at 2"))
    batch, policy = FarmBatch(config, 1), policy_of("lawnmower", config)
    batch.reset(0, 1, 2)
    policy.reset(batch, 0)
    served = np.zeros(batch.vdf[0].shape, bool)
    for _ in range(300):
        before = batch.vdf[0].copy()
        batch.step(policy.act(batch))
        served |= batch.vdf[0] < before
    assert served.all()


def test_the_farm_that_is_left():
    """Its numbers are those of the living, its relays serve all, and nobody fails in it."""
    config = replace(FarmConfig(), failures=FailureConfig(per_hour=1.0))
    assert left_over(config, config.world.counts) is config
    left = left_over(config, (1, 3, 4))
    assert left.world.counts == (1, 3, 4)
    assert left.relay.capacity_for(left.world) == 7
    assert not left.failures.some
