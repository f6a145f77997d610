"""A group ends when a member is gone or differs; what it has learned goes on with any number of learners."""

import signal
import time

import numpy as np
import pytest
import torch

from eia_sec.common.errors import GroupError
from eia_sec.learner.group.following import _most_rows, introduce
from eia_sec.learner.group.process_group import Order
from eia_sec.learner.group.updates import FollowingUpdates
from eia_sec.learner.on_policy.trainer import OnPolicyTrainer
from tests.learner.group.members import end, group_of
from tests.learner.on_policy.small_runs import ENDS, TEAM, chunk, configured, moved

CONFIG = configured("eia-ppo", objective="decoupled", target_kl=0.0)


def absorb(*trainers, number=0):
    """Give trainers the same iteration."""
    behaviour = moved(OnPolicyTrainer(CONFIG, TEAM).actors(), 0.1, np.random.default_rng(number))
    for trainer in trainers:
        trainer.absorb(chunk(behaviour, number, ENDS, episodes=2))


def order_often(group):
    """Give many orders, as a leader does."""
    for _ in range(1000):
        group.order(Order.NOTHING)


def test_a_killed_member_ends_the_group(tmp_path):
    """The leader's next orders fail in one sentence once a follower was killed; none of them hangs."""
    with group_of(2, tmp_path) as (group, (follower,)):
        introduce(group, CONFIG, TEAM)
        for _ in range(3):
            group.order(Order.NOTHING)
        follower.send_signal(signal.SIGKILL)
        follower.wait()
        with pytest.raises(GroupError, match=r"^learner 0 of 2 could not .*: another one is gone or silent\.$"):
            order_often(group)


def test_the_others_end_with_the_leader(tmp_path):
    """A follower ends by itself when the leader has gone."""
    with group_of(2, tmp_path) as (group, (follower,)):
        introduce(group, CONFIG, TEAM)
        group.close()
        assert follower.wait(60.0) == 0


def test_who_does_not_know_the_store_is_no_member(tmp_path):
    """Whoever connects to a member's port takes part only if it can read the group's store."""
    said = "what connected as learner 1 of 2 is not of this group"
    with pytest.raises(GroupError, match=said), group_of(2, tmp_path, "impostor"):
        pass


@pytest.mark.slow
def test_a_follower_bears_a_silent_leader(tmp_path):
    """A leader that loads or saves for longer than it waits itself finds its followers in their places."""
    with group_of(2, tmp_path, "impatient") as (group, (follower,)):
        introduce(group, CONFIG, TEAM)
        time.sleep(2.5)
        for _ in range(3):
            group.order(Order.NOTHING)
        end(group)
        assert follower.poll() is None


@pytest.mark.parametrize("number", [float("inf"), float("nan"), 99.0])
def test_an_impossible_order_ends_a_follower_as_a_broken_group(tmp_path, number):
    """Numbers that no order has are a GroupError, by which members of these tests end with 0."""
    with group_of(2, tmp_path) as (group, (follower,)):
        introduce(group, CONFIG, TEAM)
        group.broadcast([torch.full((5,), number, dtype=torch.float64)])
        assert follower.wait(60.0) == 0


@pytest.mark.parametrize("count", [-1, 10**8])
def test_rows_are_counted_before_memory_is_taken(count):
    """A follower takes no more rows than an iteration of its run can have."""

    class Sender:
        rank, size = 1, 2

        def broadcast(self, tensors):
            """Leave them as they are."""

        def receive(self, tensors):
            """Send a count."""
            tensors[0].fill_(count)

    updates = FollowingUpdates(CONFIG.on_policy, TEAM, 0, CONFIG.learner, Sender())
    updates.most_rows = _most_rows(CONFIG)
    with pytest.raises(GroupError, match=f"impossible count, {count}"):
        updates.take_rows()


def test_different_parameters_end_the_group(tmp_path):
    """A difference of one parameter is noticed at the end of the iteration."""
    with group_of(2, tmp_path) as (group, _):
        trainer = OnPolicyTrainer(CONFIG, TEAM, group)
        introduce(group, CONFIG, TEAM)
        absorb(trainer)
        trainer.train(trainer.updates_due() - 1)
        with torch.no_grad():
            trainer._updates.policies.stacks[0].flat[0, 0] += 1e-6
        with pytest.raises(GroupError, match="hold different parameters"):
            trainer.train(1)


@pytest.mark.parametrize("updates", [1, 5, 9])
def test_a_checkpoint_does_not_depend_on_the_number_of_learners(tmp_path, updates):
    """One learner goes on with a group's checkpoint as the group does, and a group with one learner's."""
    with group_of(2, tmp_path) as (group, _):
        introduce(group, CONFIG, TEAM)
        led, one = OnPolicyTrainer(CONFIG, TEAM, group), OnPolicyTrainer(CONFIG, TEAM)
        absorb(led)
        led.train(updates)
        one.restore(*led.state())
        per_epoch = 4
        led.train(per_epoch - updates % per_epoch)  # in later epochs the samples' order differs
        one.train(per_epoch - updates % per_epoch)
        assert one.updates == led.updates
        close(one, led)
        again = OnPolicyTrainer(CONFIG, TEAM, group)
        again.restore(*one.state())
        close(again, one)
        again.train(again.updates_due())
        assert (again.iterations, again.updates) == (1, 12)
        absorb(again, number=1)
        again.train(again.updates_due())
        assert (again.iterations, again.updates) == (2, 24)
        end(group)


def close(one, other):
    """Hold two trainers' networks against each other."""
    for (name, found), (_, wanted) in zip(
        one._updates.network_tensors(), other._updates.network_tensors(), strict=True
    ):
        torch.testing.assert_close(found, wanted, atol=2e-5, rtol=0.0, msg=lambda text, n=name: f"{n}: {text}")
