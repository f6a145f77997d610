"""A run with memory continues from a checkpoint bit for bit; states in a checkpoint are checked."""

import numpy as np
import pytest
import torch

from eia_sec.common.errors import CheckpointError
from eia_sec.learner.checkpoint import files
from eia_sec.learner.on_policy.trainer import OnPolicyTrainer
from tests.learner.on_policy.recurrent_runs import remembered_chunk, with_memory
from tests.learner.on_policy.small_runs import TEAM, chunk, configured, moved
from tests.learner.test_trainer import assert_bit_equal

CONFIG = with_memory("eia-ppo", iteration_steps=80, minibatch_steps=20, target_kl=0.02, actor_rate=0.01)
"""Iterations of two chunks of 40 steps, with 12 updates."""
STEPS: tuple[str | int, ...] = ("chunk", "chunk", 1, 4, "chunk", 7, "chunk", 5)
"""Chunks and updates; the third chunk comes in the middle of the first iteration's updates."""


def play(trainer, steps, start=0):
    """Do some of the steps; their chunks are flown by actors near the initial ones."""
    behaviour = OnPolicyTrainer(CONFIG, TEAM).actors()
    for index, step in enumerate(steps, start):
        if step == "chunk":
            actors = moved(behaviour, 0.1, np.random.default_rng(index))
            trainer.absorb(remembered_chunk(actors, index, episodes=1))
        else:
            trainer.train(step)


@pytest.fixture(scope="module")
def uncut():
    """A trainer that has done all steps without a cut."""
    trainer = OnPolicyTrainer(CONFIG, TEAM)
    play(trainer, STEPS)
    return trainer


@pytest.mark.parametrize("cut", range(len(STEPS) + 1))
def test_a_run_continues_bit_equal(uncut, tmp_path, cut):
    """Weights, moments, rows, states, random state, statistics and counters are those of the run without a cut."""
    before = OnPolicyTrainer(CONFIG, TEAM)
    play(before, STEPS[:cut])
    tensors, state = before.snapshot()
    found = files.load(files.save(tmp_path, tensors, state, keep=1))
    after = OnPolicyTrainer(CONFIG, TEAM)
    after.restore(*found)
    assert_bit_equal(after, before)
    play(after, STEPS[cut:], cut)
    assert_bit_equal(after, uncut)
    assert after.statistics() == uncut.statistics()


def test_the_steps_hold_what_they_are_for(uncut):
    """One iteration is done and a second runs, with states of its own."""
    assert (uncut.iterations, uncut.updates, uncut.updates_due()) == (1, 17, 7)
    names = {name for name in uncut.state()[0] if name.endswith("state")}
    assert names == {"iteration.state", "iteration_state.actor_state", "iteration_state.value_state"}


def test_a_checkpoint_fits_into_its_bound(tmp_path):
    """`largest_checkpoint` is above the file of a full iteration with many chunks behind it."""
    trainer = OnPolicyTrainer(CONFIG, TEAM)
    play(trainer, ["chunk"] * 40)
    trainer.train(1)
    folder = files.save(tmp_path, *trainer.snapshot(), keep=1)
    assert (folder / "tensors.safetensors").stat().st_size < trainer.largest_checkpoint()


@pytest.mark.parametrize("name", ["iteration.state", "iteration_state.actor_state", "iteration_state.value_state"])
def test_forged_states_are_refused(name):
    """States missing, of another shape or type, or not finite, change nothing."""
    trainer = OnPolicyTrainer(CONFIG, TEAM)
    play(trainer, STEPS[:4])
    tensors, state = trainer.state()
    tensor = tensors[name]
    forgeries = [
        None,
        tensor[:-1].clone(),
        tensor[..., :-1].clone(),
        tensor.double(),
        torch.full_like(tensor, torch.nan),
    ]
    forgeries += [torch.cat([tensor] * 2), tensor.repeat_interleave(4, dim=0)]
    for forged in forgeries:
        changed = {key: value for key, value in tensors.items() if key != name}
        other = OnPolicyTrainer(CONFIG, TEAM)
        with pytest.raises(CheckpointError):
            other.restore(changed | ({} if forged is None else {name: forged}), state)
        assert_bit_equal(other, OnPolicyTrainer(CONFIG, TEAM))


def test_checkpoints_with_and_without_memory_do_not_mix():
    """A run without memory cannot continue from a checkpoint with memory, nor the other way round."""
    plain, remembering = OnPolicyTrainer(configured(), TEAM), OnPolicyTrainer(with_memory(), TEAM)
    plain.absorb(chunk(plain.actors(), 0))
    remembering.absorb(remembered_chunk(remembering.actors(), 0))
    for source, config in ((plain, with_memory()), (remembering, configured())):
        with pytest.raises(CheckpointError):
            OnPolicyTrainer(config, TEAM).restore(*source.state())
