"""Learning on policy on a GPU: the same as on a processor to rounding, and resumed bit for bit."""

import numpy as np
import pytest
import torch

from eia_sec.common.config import RunConfig
from eia_sec.common.config.files import with_values
from eia_sec.deploy.local.in_process import train_in_process
from eia_sec.learner.on_policy.trainer import OnPolicyTrainer
from tests.learner.on_policy.recurrent_runs import remembered_chunk, with_memory
from tests.learner.on_policy.small_runs import ENDS, TEAM, chunk, configured, moved
from tests.learner.on_policy.test_recurrent_updates import CASES as WITH_MEMORY
from tests.learner.on_policy.test_resume import CONFIG, STEPS, play
from tests.learner.on_policy.test_updates import CASES
from tests.learner.test_trainer import assert_bit_equal

pytestmark = pytest.mark.skipif(not torch.cuda.is_available(), reason="there is no CUDA device")
ON_GPU = {"learner.device": "cuda"}


def assert_same_learning(config, flown):
    """Hold what a GPU learns in two iterations against what a processor does."""
    host, device = OnPolicyTrainer(config, TEAM), OnPolicyTrainer(with_values(config, ON_GPU), TEAM)
    before = host.state()[0]
    for number in range(2):
        behaviour = moved(host.actors(), 0.1, np.random.default_rng(number))
        for trainer in (host, device):
            trainer.absorb(flown(behaviour, number))
            trainer.train(trainer.updates_due())
            assert trainer.iterations == number + 1
    assert all(tensor.is_cuda for _, tensor in device._updates.network_tensors())
    captured = device._updates._captured
    assert len(captured) >= 1 if config.on_policy.memory == "none" else captured is None
    wanted, found = host.state()[0], device.state()[0]
    assert wanted.keys() == found.keys()
    for name, tensor in wanted.items():
        torch.testing.assert_close(found[name], tensor, atol=2e-5, rtol=1e-4, msg=lambda text, n=name: f"{n}: {text}")
    assert any(float((wanted[name] - before[name]).abs().max()) > 1e-3 for name in before if "actors" in name)
    assert device.statistics() == pytest.approx(host.statistics(), rel=1e-3, abs=1e-4)


@pytest.mark.parametrize("case", CASES)
def test_a_gpu_learns_what_a_processor_learns(case):
    """Networks, Adam's moments and diagnostics are equal to rounding after two iterations."""
    name, options = CASES[case]
    assert_same_learning(configured(name, **options), lambda actors, seed: chunk(actors, seed, ENDS, episodes=2))


@pytest.mark.parametrize("case", WITH_MEMORY)
def test_networks_with_memory_learn_the_same(case):
    """The same holds for networks that go through sequences."""
    name, options = WITH_MEMORY[case]
    assert_same_learning(with_memory(name, **options), lambda actors, seed: remembered_chunk(actors, seed, episodes=2))


@pytest.mark.parametrize("cut", range(len(STEPS) + 1))
def test_a_run_on_a_gpu_continues_bit_equal(cut):
    """A run that is cut anywhere ends as one that is not, and may go on where it was cut on a processor."""
    config = with_values(CONFIG, ON_GPU)
    uncut, before, after = (OnPolicyTrainer(config, TEAM) for _ in range(3))
    play(uncut, STEPS)
    play(before, STEPS[:cut])
    after.restore(*before.state())
    assert_bit_equal(after, before)
    play(after, STEPS[cut:], cut)
    assert_bit_equal(after, uncut)
    moved_here = OnPolicyTrainer(CONFIG, TEAM)
    moved_here.restore(*before.state())
    assert_bit_equal(moved_here, before)


def test_a_farm_is_learned_on_a_gpu():
    """The preset instant's products of bfloat16 on the GPU learn as quickly as those of a processor."""
    rewards: list[float] = []

    def watch(trainer, flown):
        rewards.extend(float(np.mean(episode.reward)) for episode in flown.episodes)

    train_in_process(with_values(RunConfig(), {**ON_GPU, "episodes": 320}), watch)
    assert np.mean(rewards[-32:]) > 1100.0
