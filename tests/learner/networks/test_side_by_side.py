"""Networks that are updated side by side get the weights that they get one after another."""

import threading
import time
from dataclasses import replace

import numpy as np
import pytest
import torch

from eia_sec.common.config import LearnerConfig, RunConfig
from eia_sec.learner.networks.side_by_side import SideBySide
from eia_sec.learner.on_policy.trainer import OnPolicyTrainer
from tests.learner.on_policy.recurrent_runs import remembered_chunk, with_memory
from tests.learner.on_policy.small_runs import ENDS, TEAM, chunk, configured, moved

CASES: dict[str, RunConfig] = {
    "ippo": configured("ippo", target_kl=0.0),
    "bfloat16": configured("ippo", target_kl=0.0, precision="bfloat16", hidden=64),
    "separate bfloat16": configured("ippo", shared_until=0.0, precision="bfloat16", hidden=64),
    "decoupled": configured("ippo", objective="decoupled", max_lag_versions=1),
    "a type stops": configured("ippo", actor_rate=0.02, target_kl=0.02, epochs=4),
    "mappo": configured("mappo"),
    "eia-ppo": configured("eia-ppo", ensemble_members=3),
    "memory": with_memory("eia-ppo"),
}


def learned(config, threads):
    """Return a trainer after three iterations with so many threads."""
    trainer = OnPolicyTrainer(replace(config, learner=LearnerConfig(update_threads=threads)), TEAM)
    for number in range(3):
        behaviour = moved(trainer.actors(), 0.1, np.random.default_rng(number))
        remembers = config.on_policy.memory != "none"
        trainer.absorb(remembered_chunk(behaviour, number) if remembers else chunk(behaviour, number, ENDS))
        trainer.train(trainer.updates_due())
    assert trainer.iterations == 3
    return trainer


@pytest.mark.parametrize("case", CASES)
def test_weights_do_not_depend_on_the_number_of_threads(case):
    """Bit by bit, Adam's moments and what the updates measured included."""
    (tensors, state), *others = [learned(CASES[case], threads).state() for threads in (1, 2, 6)]
    for other, values in others:
        assert values == state
        assert other.keys() == tensors.keys()
        assert all(torch.equal(tensors[name], other[name]) for name in tensors)


def test_tasks_compute_at_once_and_flush_small_numbers():
    """Two tasks that wait for each other both end; results keep their order, and each thread flushes denormals."""
    both = threading.Barrier(2)

    def small():
        both.wait(20.0)
        return threading.get_ident(), float(torch.tensor(1e-30) * torch.tensor(1e-10))

    pool = SideBySide(2)
    (first, number), (second, other) = pool.run([small, small])
    assert first != second
    assert number == other == 0.0
    assert pool.run([lambda k=k: k for k in range(9)]) == list(range(9))


def test_an_error_of_a_task_reaches_the_caller():
    """A task that fails is not lost in its thread, and nothing computes any more when the caller hears of it."""
    ended = []

    def fails():
        raise ValueError("no")

    def goes_on():
        time.sleep(0.2)
        ended.append(True)

    for threads, others in ((1, 0), (2, 1)):
        with pytest.raises(ValueError, match="no"):
            SideBySide(threads).run([fails, goes_on])
        assert len(ended) == others
