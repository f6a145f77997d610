"""A run on policy continues from a checkpoint bit for bit, wherever it was cut; forged checkpoints are refused."""

import random
from dataclasses import replace

import numpy as np
import pytest
import torch

from eia_sec.common.errors import CheckpointError
from eia_sec.common.protocol.bfloat16 import to_bits
from eia_sec.common.transitions import TRUNCATED
from eia_sec.learner.checkpoint import files
from eia_sec.learner.on_policy.trainer import OnPolicyTrainer
from tests.learner.checkpoint.test_forged import ODD, places, put
from tests.learner.on_policy.small_runs import TEAM, chunk, configured, moved
from tests.learner.test_trainer import assert_bit_equal

CONFIG = configured("eia-ppo", epochs=3, target_kl=0.02, actor_rate=0.01, shared_until=0.2)
DECOUPLED = configured("eia-ppo", epochs=3, target_kl=0.02, actor_rate=0.01, objective="decoupled")
"""Iterations of 40 steps with 12 updates; types stop at different epochs. Agents part after the first iteration."""
STEPS: tuple[str | int, ...] = ("chunk", "chunk", 1, 1, 1, "chunk", 3, 1, 5, "chunk", 2, 2, 8, "publish", "chunk")
"""Chunks of 20 steps and updates: cuts lie before an iteration is full, inside its updates, and behind them.

The third chunk comes in the middle of the first iteration's updates.
"""


def play(trainer, steps, start=0):
    """Do some of the steps; their chunks are flown by actors near the initial ones."""
    behaviour = OnPolicyTrainer(CONFIG, TEAM).actors()
    for index, step in enumerate(steps, start):
        if step == "chunk":
            actors = moved(behaviour, 0.1, np.random.default_rng(index))
            trainer.absorb(chunk(actors, index, ((9, TRUNCATED), (11, 0)), episodes=1))
        elif step == "publish":
            trainer.next_version()
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
    """Weights, moments, rows, random state, statistics and counters are those of the run without a cut."""
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


def test_a_decoupled_iteration_continues_bit_equal():
    """The probabilities and weights from its start are in the checkpoint; the actors have changed since."""
    before, after, whole = (OnPolicyTrainer(DECOUPLED, TEAM) for _ in range(3))
    play(before, STEPS[:4])
    after.restore(*before.state())
    play(after, STEPS[4:], 4)
    play(whole, STEPS)
    assert_bit_equal(after, whole)


def in_bfloat16(steps=STEPS, convert=to_bits):
    """Return a trainer in bfloat16 that has done some steps, and gets its observations through a function."""
    config = configured(precision="bfloat16")
    trainer = OnPolicyTrainer(config, TEAM)
    take_in = trainer.take_in

    def converted(given, *rest):
        rows = replace(given.rows, observation=convert(given.rows.observation))
        take_in(replace(given, rows=rows), *rest)

    trainer.take_in = converted
    play(trainer, steps)
    return trainer


@pytest.mark.parametrize("cut", [1, 5, 9])
def test_a_run_with_rounded_rows_continues_bit_equal(tmp_path, cut):
    """A checkpoint keeps the rows' observations as bfloat16 numbers."""
    before = in_bfloat16(STEPS[:cut])
    tensors, state = before.snapshot()
    assert tensors["iteration.observation"].dtype == torch.bfloat16
    found = files.load(files.save(tmp_path, tensors, state, keep=1))
    after = in_bfloat16(())
    after.restore(*found)
    assert_bit_equal(after, before)
    play(after, STEPS[cut:], cut)
    assert_bit_equal(after, in_bfloat16())


def test_the_steps_hold_what_they_are_for(uncut):
    """Two iterations are done, a third runs, and a type stopped before its iteration's last epoch."""
    assert (uncut.iterations, uncut.updates, uncut.experience.steps) == (2, 24, 20)
    trainer = OnPolicyTrainer(CONFIG, TEAM)
    play(trainer, STEPS[:8])
    assert trainer.updates_due() == 5
    assert 1 in trainer.snapshot()[1]["stopped"]


def test_a_snapshot_is_of_its_instant():
    """Training on does not change a snapshot that is written later."""
    trainer = OnPolicyTrainer(CONFIG, TEAM)
    play(trainer, STEPS[:4])
    tensors, _ = trainer.snapshot()
    copies = {name: tensor.clone() for name, tensor in tensors.items()}
    play(trainer, STEPS[4:])
    assert all(torch.equal(tensors[name], copy) for name, copy in copies.items())


def test_forged_rounded_rows_are_refused():
    """Rows of bfloat16 numbers in a run that wants float32, and numbers that are not finite in one that wants them."""
    tensors, state = in_bfloat16(STEPS[:7]).state()
    for name in ("iteration.observation", "following.observation"):
        for forged in (
            torch.full_like(tensors[name], torch.nan),
            torch.full_like(tensors[name], 2e7),
            tensors[name][1:],
        ):
            with pytest.raises(CheckpointError, match=name.partition(".")[0]):
                in_bfloat16(()).restore({**tensors, name: forged}, state)
    plain = OnPolicyTrainer(configured(), TEAM)
    play(plain, STEPS[:7])
    tensors, state = plain.state()
    forged = tensors["iteration.observation"].to(torch.bfloat16)
    with pytest.raises(CheckpointError, match=r"observation is uint16.*not float32"):
        OnPolicyTrainer(configured(), TEAM).restore({**tensors, "iteration.observation": forged}, state)


@pytest.mark.parametrize("name", ["largest", "draining"])
def test_a_checkpoint_fits_into_its_bound(tmp_path, name):
    """`largest_checkpoint` is above the file of a full iteration, also with many chunks behind it."""
    trainer = OnPolicyTrainer(CONFIG, TEAM)
    play(trainer, ["chunk"] * (2 if name == "largest" else 60))
    trainer.train(1)
    tensors, state = trainer.snapshot()
    folder = files.save(tmp_path, tensors, state, keep=1)
    assert (folder / "tensors.safetensors").stat().st_size < trainer.largest_checkpoint()


def test_chunks_that_come_while_updates_are_due_belong_to_the_next_iteration():
    """The running iteration's updates learn from its own steps alone, and the next begins with the others."""
    plain, crowded = (OnPolicyTrainer(CONFIG, TEAM) for _ in range(2))
    for trainer in (plain, crowded):
        play(trainer, STEPS[:3])
    assert crowded.iteration == (1, 40)
    crowded.absorb(chunk(crowded.actors(), 7))
    assert crowded.iteration == (1, 20)
    for trainer in (plain, crowded):
        trainer.train(trainer.updates_due())
    assert plain.actors().digest() == crowded.actors().digest()
    assert (plain.updates, crowded.updates) == (12, 12)
    assert (plain.iteration, crowded.iteration) == ((1, 40), (1, 20))


@pytest.fixture(scope="module")
def saved():
    """The state of a trainer in the middle of an iteration's updates, with a chunk of the next."""
    trainer = OnPolicyTrainer(CONFIG, TEAM)
    play(trainer, STEPS[:7])
    return trainer.state()


def outcome(tensors, state):
    """Restore a state; return the trainer, or None if it was refused and nothing has changed."""
    trainer = OnPolicyTrainer(CONFIG, TEAM)
    play(trainer, ["chunk"])
    own, counts = trainer.state()
    own = {name: tensor.clone() for name, tensor in own.items()}
    try:
        trainer.restore(tensors, state)
    except CheckpointError:
        now, counted = trainer.state()
        assert counted == counts
        assert now.keys() == own.keys()
        assert all(torch.equal(now[name], tensor) for name, tensor in own.items())
        return None
    return trainer


def test_a_forged_tensor_is_refused(saved):
    """Tensors missing, of another shape or type, or with a number that is not finite, change nothing."""
    tensors, state = saved
    networks = sorted(name for name in tensors if name.startswith("networks."))
    rows = sorted(set(tensors) - set(networks))
    assert len(rows) == 13
    for name in [*networks[::20], *rows]:
        tensor = tensors[name]
        forgeries = [None, tensor[None].clone(), tensor.to(torch.bfloat16), tensor.double()]
        if tensor.is_floating_point():
            forgeries.append(torch.full_like(tensor, torch.nan))
        if tensor.ndim:
            forgeries += [tensor[:-1].clone(), torch.full_like(tensor, 99 if tensor.dtype == torch.uint8 else 2**40)]
        for forged in forgeries[: None if name.startswith(("iteration", "following")) else 5]:
            changed = {key: value for key, value in tensors.items() if key != name}
            result = outcome(changed | ({} if forged is None else {name: forged}), state)
            harmless = forged is not None and name.startswith("iteration_state") and forged.shape == tensor.shape
            assert result is None or (harmless and forged.dtype == tensor.dtype), (name, forged)


def test_forged_moments_are_refused(saved):
    """A count of updates that differs within a network or is impossible; squares below zero, or none with gradients."""
    tensors, state = saved
    counts = [name for name in tensors if name.endswith(".step")]
    squares = [name for name in tensors if name.endswith(".exp_avg_sq")]
    assert outcome({**tensors, **{name: torch.tensor(5.0) for name in counts}}, state) is not None
    for name in counts:
        assert outcome({**tensors, name: tensors[name] + 1.0}, state) is None
    for count in (-1.0, 2.5):
        assert outcome({**tensors, **{name: torch.tensor(count) for name in counts}}, state) is None
    for name in squares:
        assert tensors[name].any()
        assert outcome({**tensors, name: tensors[name] - 1.0}, state) is None
        assert outcome({**tensors, name: torch.zeros_like(tensors[name])}, state) is None
        mean = tensors[name.removesuffix("_sq")]
        assert outcome({**tensors, name: (mean / 8.0) ** 2}, state) is None
        assert outcome({**tensors, name: (mean / 7.27) ** 2 + 1e-30}, state) is not None


def test_a_forged_value_is_refused_or_harmless(saved):
    """Each value of the state becomes each of some odd ones; what is taken can be trained on and saved."""
    tensors, state = saved
    draw, refused, tried = random.Random(2), 0, 0
    for path in places(state):
        for value in draw.sample(ODD, 2):
            result = outcome(tensors, put(state, path, value))
            tried, refused = tried + 1, refused + (result is None)
            if result is not None:
                play(result, ["chunk", 2], 50)
                result.statistics()
                assert all(bool(torch.isfinite(t.float()).all()) for t in result.state()[0].values()), (path, value)
    assert refused > tried // 2 > 50


@pytest.mark.parametrize("name", ["following_steps", "epochs_left", "diagnostics", "stopped", "pending", "sample_age"])
def test_a_missing_value_is_refused(saved, name):
    """A state without one of its values changes nothing."""
    tensors, state = saved
    assert outcome(tensors, {key: value for key, value in state.items() if key != name}) is None
