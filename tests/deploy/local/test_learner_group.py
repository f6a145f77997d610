"""Which cause a leader names when its group has broken."""

import signal

import pytest
import torch

from eia_sec.common.errors import GroupError
from eia_sec.deploy.local import learner_group
from eia_sec.deploy.local.learner_group import leading
from eia_sec.deploy.local.learners import INTERFACE, Place
from eia_sec.learner.group.process_group import Order
from eia_sec.learner.on_policy.trainer import OnPolicyTrainer
from tests.learner.group.test_members import CONFIG, TEAM, absorb, order_often


@pytest.fixture
def processes(monkeypatch):
    """The followers that are started."""
    found, start = [], learner_group._follower
    monkeypatch.setenv(INTERFACE, "lo")

    def follower(*arguments):
        found.append(start(*arguments))
        return found[-1]

    monkeypatch.setattr(learner_group, "_follower", follower)
    return found


def test_one_learner_makes_no_group():
    """It computes alone, as ever."""
    with leading(Place(0, 1), CONFIG, TEAM) as group:
        assert group is None


def test_the_killed_one_is_named(processes):
    """Others that end because of it are not, though they have lower numbers."""

    def kill(group):
        group.order(Order.NOTHING)
        processes[2].send_signal(signal.SIGKILL)
        processes[2].wait()
        order_often(group)

    assert ends(4, kill) == "learner 3 of 4 ended with signal 9, and the group with it."


def test_different_parameters_are_the_cause(processes):
    """Followers end with the code of a broken group as well, which is no cause."""

    def differ(group):
        trainer = OnPolicyTrainer(CONFIG, TEAM, group)
        absorb(trainer)
        trainer.train(trainer.updates_due() - 1)
        with torch.no_grad():
            trainer._updates.policies.stacks[0].flat[0, 0] += 1e-6
        trainer.train(1)

    assert "hold different parameters" in ends(2, differ)
    assert [process.returncode for process in processes] == [3]


def ends(size, doing):
    """Lead a group that breaks; return the cause that is named."""

    def lead():
        with leading(Place(0, size), CONFIG, TEAM) as group:
            doing(group)

    with pytest.raises(GroupError) as caught:
        lead()
    return str(caught.value)
