"""Captured updates learn what updates that are not captured do; a graph is played by calls of what it captured.

`tests/learner/on_policy/test_on_a_gpu.py` holds real graphs against a processor.
"""

import numpy as np
import pytest
import torch

from eia_sec.common.config.files import with_values
from eia_sec.learner.on_policy import captured_updates
from eia_sec.learner.on_policy.captured_updates import MOST_GRAPHS, CapturedUpdates
from eia_sec.learner.on_policy.minibatch import Minibatch
from eia_sec.learner.on_policy.trainer import OnPolicyTrainer
from tests.learner.on_policy.small_runs import ENDS, TEAM, chunk, configured, moved
from tests.learner.on_policy.test_updates import CASES


class Replay:
    """Stands for a CUDA graph: it calls what was captured, with the result in the memory of the first one."""

    def __init__(self, work):
        self._work = work
        self.names, self.numbers = work()

    def replay(self):
        """Compute once more."""
        names, numbers = self._work()
        assert names == self.names
        self.numbers.copy_(numbers)


class Captures:
    """Stands for `capture`, and counts its calls."""

    def __init__(self):
        self.count = 0

    def __call__(self, work, state):
        """Return a graph and its result; the state stays as it was."""
        self.count += 1
        kept = [(tensor.detach(), tensor.detach().clone()) for tensor in state]
        graph = Replay(work)
        for tensor, before in kept:
            tensor.copy_(before)
        return graph, (graph.names, graph.numbers)


@pytest.fixture
def captures(monkeypatch):
    """Let graphs be captured without a GPU."""
    found = Captures()
    monkeypatch.setattr(captured_updates, "capture", found)
    return found


def capturing(config):
    """Return a trainer on the processor whose updates are captured."""
    trainer = OnPolicyTrainer(config, TEAM)
    updates = trainer._updates
    updates._captured = CapturedUpdates(updates._adam.tensors(), len(TEAM.groups))
    return trainer


@pytest.mark.parametrize("case", CASES)
def test_they_learn_the_same(case, captures):
    """Networks, moments and diagnostics are equal to rounding after three iterations with chunks of two lengths."""
    name, options = CASES[case]
    config = with_values(configured(name, **options), {"episodes": 20})
    plain, captured = OnPolicyTrainer(config, TEAM), capturing(config)
    for number, segments in enumerate((ENDS, (*ENDS, (9, 0)), ENDS)):
        behaviour = moved(plain.actors(), 0.1, np.random.default_rng(number))
        for trainer in (plain, captured):
            trainer.absorb(chunk(behaviour, number, segments, episodes=2))
            trainer.train(trainer.updates_due())
    wanted, found = plain.state()[0], captured.state()[0]
    for tensor_name, tensor in wanted.items():
        torch.testing.assert_close(found[tensor_name], tensor, atol=1e-5, rtol=1e-5)
    assert captured.statistics() == pytest.approx(plain.statistics(), rel=1e-4, abs=1e-5)
    assert 2 <= captures.count <= 8 < captured.updates


def test_one_graph_for_each_size_and_for_those_who_have_stopped(captures):
    """The first epoch moves all actors too far, so that the second one needs another graph, and later ones none."""
    trainer = capturing(configured(actor_rate=0.05, target_kl=1e-6, epochs=3))
    for number in range(3):
        trainer.absorb(chunk(trainer.actors(), number, ENDS))
        trainer.train(trainer.updates_due())
        assert captures.count == 2


def test_the_graph_unused_longest_goes(captures):
    """No more than MOST_GRAPHS are kept, and a capture of a forgotten one computes the same."""
    total = torch.zeros(())

    def learn(batch):
        total.add_(batch.tensors["returns"].sum() * batch.rate_share)
        return [{"value_loss": batch.own(0).sum() * batch.entropy_weight}]

    def found(size):
        rows = torch.full((size, 1), 2.0)
        batch = Minibatch(lambda kind: 3.0 * rows, {"returns": rows}, rows[:, :0], None, (False,), 0.5, 0.25)
        return float(updates.update(learn, batch)[0]["value_loss"])

    updates = CapturedUpdates([total], kinds=1)
    sizes = [*range(1, MOST_GRAPHS + 1), 1, MOST_GRAPHS + 1, 1, 2]
    assert [found(size) for size in sizes] == [3.0 * size for size in sizes]
    assert float(total) == 0.5 * sum(sizes)
    assert captures.count == MOST_GRAPHS + 2
    assert len(updates) == MOST_GRAPHS
