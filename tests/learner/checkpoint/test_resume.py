"""Resume: what goes on from a checkpoint equals the run that was never interrupted, bit by bit."""

import random
import threading
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from eia_sec.common.config import EiaSecConfig, EvaluationConfig, LearnerConfig, ReplayConfig
from eia_sec.common.config.presets import preset
from eia_sec.common.errors import CheckpointError, RunDirError
from eia_sec.common.imitation import ImitationEvent
from eia_sec.common.protocol.messages import Envelope
from eia_sec.common.team import GroupSpec, TeamSpec
from eia_sec.common.transitions import TERMINATED, TRANSITION, TRUNCATED, Chunk, EpisodeSummary, Rows
from eia_sec.learner.checkpoint import files
from eia_sec.learner.checkpoint.storage import CHECKPOINTS, RunStorage
from eia_sec.learner.intake.ledger import Ledger
from eia_sec.learner.off_policy.trainer import OffPolicyTrainer
from eia_sec.learner.process.phase_times import PhaseTimes
from eia_sec.learner.process.service import Learner
from eia_sec.learner.registry import OFF_POLICY
from tests.learner.off_policy.variants import variant

TEAM = TeamSpec((GroupSpec("a", 2, 3, 1), GroupSpec("b", 3, 2, 2)))
CHOOSERS = TeamSpec(
    (GroupSpec("a", 2, 3, 1, choices=(4,)), GroupSpec("b", 3, 7, 2, choices=(2, 3), masked=True)),
)
CONFIG = replace(
    preset("eia-sec"),
    seed=11,
    algorithm=EiaSecConfig(hidden=12, batch=16, ensemble_copy_rate=0.01),
    replay=ReplayConfig(capacity=1500, warmup_steps=40, updates_per_step=0.25, max_age_versions=30),
)
ENVIRONMENTS, STEPS = 4, 10
CUTS = (1, 7, 30, 44, 60)
"""Chunks before the cut: in the warm-up, soon after it, before the ring is full, just before and after it wraps."""


def recorded(count, seed=0, team=TEAM):
    """Return chunks of two workers by turns, which go on where the worker's chunk before stopped."""
    draw = np.random.default_rng(seed)
    options = [each for group in team.groups for each in group.choices * group.count]
    now = draw.uniform(-1, 1, (2, ENVIRONMENTS, team.observation_size)).astype(np.float32)
    chunks = []
    for number in range(count):
        worker = number % 2
        shape = ENVIRONMENTS, STEPS + 1
        observation = draw.uniform(-1, 1, (*shape, team.observation_size)).astype(np.float32)
        observation[:, 0], now[worker] = now[worker], observation[:, -1]
        flag = np.full(shape, TRANSITION, np.uint8)
        flag[:, -1] = 0
        ended = number % 10 >= 8
        if ended:
            flag[:, -2] |= draw.choice([TERMINATED, TRUNCATED], ENVIRONMENTS).astype(np.uint8)
            now[worker] = draw.uniform(-1, 1, now[worker].shape)
        action = draw.uniform(-1, 1, (ENVIRONMENTS * (STEPS + 1), team.action_size))
        rows = Rows(
            observation.reshape(-1, team.observation_size),
            (np.floor((action + 1.0) * 0.5 * options) if options else action).astype(np.float32),
            draw.normal(size=(ENVIRONMENTS * (STEPS + 1), team.agents)).astype(np.float32),
            flag.reshape(-1),
        )
        rewards = tuple(float(value) for value in draw.normal(size=team.agents))
        done = [EpisodeSummary(number, e, 50, rewards, {"aoi": 1.0}) for e in range(ENVIRONMENTS * ended)]
        chunks.append(Chunk(rows, tuple(done)))
    return chunks


def play(trainer, ledger, chunks, first, last):
    """Absorb chunks, do the updates that they allow, publish, and imitate after every fifth."""
    for number in range(first, last):
        sender = Envelope("rollout", f"w{number % 2}", 1, number // 2 + 1, trainer.version)
        steps = chunks[number].rows.steps
        ledger.accept(sender, steps, steps * sender.sequence, steps * sender.sequence)
        trainer.absorb(chunks[number], max(0, trainer.version - number % 3), sender.name, sender.sequence)
        trainer.train(max(0, trainer.updates_due()))
        trainer.next_version()
        if number % 5 == 4:
            scores = tuple((0.0,) * group.count for group in TEAM.groups)
            trainer.imitate(ImitationEvent(trainer.events + 1, 0, 0, 0.3, (number % 2, number % 3), scores, 7))


def assert_equal_runs(one, other):
    """Every tensor to the last bit, and every other value."""
    ours, theirs = one.state(), other.state()
    assert ours[1] == theirs[1]
    assert ours[0].keys() == theirs[0].keys()
    for name, tensor in ours[0].items():
        assert torch.equal(tensor, theirs[0][name]), name
    assert one.statistics() == other.statistics()


def check_resume(directory, cut, updates, config=CONFIG):
    """Save at the cut while training goes on, take that up in a new trainer, and compare after more updates."""
    torch.set_num_threads(1)
    more = int(updates / (config.replay.updates_per_step * ENVIRONMENTS * STEPS)) + (8 if cut == 1 else 1)
    team = TEAM if config.algorithm.continuous_actions else CHOOSERS
    chunks = recorded(cut + more, team=team)
    whole, ledger, storage = OffPolicyTrainer(config, team), Ledger(), RunStorage(directory, config)
    play(whole, ledger, chunks, 0, cut)
    kept, before = ledger.state(), whole.updates
    storage.save(whole, ledger, 12.5, 3)
    play(whole, ledger, chunks, cut, cut + more)
    storage.close()
    assert storage.alarm == ""
    resumed, again = OffPolicyTrainer(replace(config, seed=config.seed), team), Ledger()
    assert RunStorage(directory, config).restore(resumed, again) == (12.5, 3)
    assert (again.state(), resumed.updates) == (kept, before)
    play(resumed, again, chunks, cut, cut + more)
    assert whole.updates >= before + updates
    assert_equal_runs(whole, resumed)
    assert again.state() == ledger.state()


@pytest.mark.parametrize("cut", CUTS)
def test_resume_is_bit_equal(tmp_path, cut):
    """Twenty further updates from each cut point: weights, moments, replay, counters and random states are equal."""
    check_resume(tmp_path, cut, 20)


@pytest.mark.parametrize("cut", [7, 44])
@pytest.mark.parametrize("name", [name for name in OFF_POLICY if name != "eia-sec"])
def test_resume_is_bit_equal_for_every_algorithm(tmp_path, name, cut):
    """Likewise with clipped gradients."""
    algorithm = variant(CONFIG.algorithm, name, gradient_clip=0.5)
    check_resume(tmp_path, cut, 20, replace(CONFIG.with_algorithm(name), algorithm=algorithm))


@pytest.mark.nightly
@pytest.mark.parametrize("cut", CUTS)
def test_resume_is_bit_equal_for_long(tmp_path, cut):
    """Two hundred further updates from each cut point."""
    check_resume(tmp_path, cut, 200)


def test_a_checkpoint_is_of_its_instant_however_slow_the_disk(tmp_path, monkeypatch):
    """A ring that is overwritten entirely while its checkpoint is being written is not in that checkpoint."""
    pieces, gate = files._pieces, threading.Event()

    def slow(name, tensor):
        assert gate.wait(60.0)
        yield from pieces(name, tensor)

    monkeypatch.setattr(files, "_pieces", slow)
    chunks = recorded(90)
    trainer, ledger, storage = OffPolicyTrainer(CONFIG, TEAM), Ledger(), RunStorage(tmp_path, CONFIG)
    play(trainer, ledger, chunks, 0, 40)
    tensors, plain = trainer.state()
    assert storage.save(trainer, ledger, 0.0, 1)
    play(trainer, ledger, chunks, 40, 90)
    assert storage.statistics()["checkpoints"] == 0
    assert not storage.save(trainer, ledger, 0.0, 1)
    assert storage.skipped == 1
    gate.set()
    storage.close()
    found = files.load_latest(tmp_path / CHECKPOINTS)
    assert found.manifest["trainer"] == plain
    assert all(torch.equal(tensor, tensors[name]) for name, tensor in found.tensors.items())
    assert not torch.equal(trainer.replay.reward, tensors["replay.reward"])
    assert storage.statistics()["checkpoints"] == 1
    assert storage.statistics()["checkpoint_pause_ms"] > 0


def test_a_skipped_checkpoint_is_no_mark_in_the_history():
    """The records before a checkpoint that was never begun may still be needed by a resume."""
    begun, marks = iter([True, False, True]), []
    learner = object.__new__(Learner)
    learner._times, learner._reporter = PhaseTimes(), SimpleNamespace(elapsed=0.0)
    learner.trainer, learner._epoch, learner._feed = None, 1, SimpleNamespace(ledger="ledger")
    learner._commands = SimpleNamespace(arguments="")
    learner._storage = SimpleNamespace(save=lambda *_, wait: next(begun), alarm="")
    learner._compaction = SimpleNamespace(on_checkpoint=lambda ledger, failed: marks.append((ledger, failed)))
    learner._schedule = SimpleNamespace(checkpoint_timer=SimpleNamespace(restart=lambda now: None))
    for _ in range(3):
        learner._checkpoint()
    assert marks == [("ledger", False)] * 2


def test_a_number_that_is_not_finite_is_an_alarm_and_no_checkpoint(tmp_path):
    """The checkpoint before stands, the alarm says why, and goes away with the next whole one."""
    trainer, ledger, storage = OffPolicyTrainer(CONFIG, TEAM), Ledger(), RunStorage(tmp_path, CONFIG)
    play(trainer, ledger, recorded(6), 0, 6)
    storage.save(trainer, ledger, 0.0, 1, wait=True)
    good = trainer.engine.algorithm.actors.networks.flat.detach()[5].clone()
    trainer.engine.algorithm.actors.networks.flat.detach()[5] = float("nan")
    storage.save(trainer, ledger, 1.0, 1, wait=True)
    assert "engine.actors.parameters holds a number that is not finite" in storage.alarm
    assert files.load_latest(tmp_path / CHECKPOINTS).manifest["elapsed"] == 0.0
    assert [path.name for path in (tmp_path / CHECKPOINTS).iterdir()] == ["checkpoint-00000001"]
    trainer.engine.algorithm.actors.networks.flat.detach()[5] = good
    storage.save(trainer, ledger, 2.0, 1, wait=True)
    assert storage.alarm == ""
    assert files.load_latest(tmp_path / CHECKPOINTS).manifest["elapsed"] == 2.0


@pytest.mark.parametrize("step", ["_write_tensors", "_write", "_flush_folder"])
def test_a_disk_that_refuses_is_an_alarm_and_training_goes_on(tmp_path, monkeypatch, step):
    """At each step of a write an I/O error is an alarm, and the checkpoint before is the one that is found."""
    trainer, ledger, storage = OffPolicyTrainer(CONFIG, TEAM), Ledger(), RunStorage(tmp_path, CONFIG)
    chunks = recorded(12)
    play(trainer, ledger, chunks, 0, 6)
    storage.save(trainer, ledger, 0.0, 1, wait=True)

    def refuse(*arguments):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(files, step, refuse)
    storage.save(trainer, ledger, 1.0, 1, wait=True)
    assert "No space left" in storage.alarm
    play(trainer, ledger, chunks, 6, 12)
    assert trainer.updates > 0
    assert files.load_latest(tmp_path / CHECKPOINTS).manifest["elapsed"] == 0.0


def check_damage(directory, times, capfd):
    """Damage the newest of two checkpoints at random places; each time the one before is taken up, with a message."""
    draw = random.Random(times)
    trainer, ledger, storage = OffPolicyTrainer(CONFIG, TEAM), Ledger(), RunStorage(directory, CONFIG)
    chunks = recorded(3)
    for number in range(2):
        play(trainer, ledger, chunks, number, number + 1)
        storage.save(trainer, ledger, float(number), 1, wait=True)
    newest = directory / CHECKPOINTS / "checkpoint-00000002"
    aside = newest.with_name(f"damaged-{newest.name}")
    files = {path: path.read_bytes() for path in newest.iterdir()}
    fresh = OffPolicyTrainer(CONFIG, TEAM)
    for _ in range(times):
        path, whole = draw.choice(sorted(files.items()))
        place = draw.randrange(len(whole))
        flipped = whole[:place] + bytes([whole[place] ^ 1 << draw.randrange(8)]) + whole[place + 1 :]
        path.write_bytes(draw.choice([whole[:place], flipped]))
        capfd.readouterr()
        assert RunStorage(directory, CONFIG).restore(fresh, Ledger())[0] == 0.0
        assert "checkpoint-00000002 is damaged" in "".join(capfd.readouterr())
        assert not newest.exists()
        aside.rename(newest)
        path.write_bytes(whole)
    assert RunStorage(directory, CONFIG).restore(fresh, Ledger())[0] == 1.0


def test_a_damaged_checkpoint_is_noticed_and_the_one_before_used(tmp_path, capfd):
    """Fifty cuts and flips at random places."""
    check_damage(tmp_path, 50, capfd)


@pytest.mark.nightly
@pytest.mark.timeout(1800)
def test_a_damaged_checkpoint_is_noticed_a_thousand_times(tmp_path, capfd):
    """A thousand cuts and flips at random places."""
    check_damage(tmp_path, 1000, capfd)


def test_any_fault_of_a_write_is_an_alarm_and_the_next_one_is_written(tmp_path, monkeypatch):
    """An error that nobody thought of, of the device for instance, does not come up again at the next checkpoint."""
    trainer, ledger, storage = OffPolicyTrainer(CONFIG, TEAM), Ledger(), RunStorage(tmp_path, CONFIG)

    def fail(*arguments):
        raise RuntimeError("out of memory")

    with monkeypatch.context() as patched:
        patched.setattr(files, "_write_tensors", fail)
        storage.save(trainer, ledger, 0.0, 1, wait=True)
    assert "out of memory" in storage.alarm
    storage.save(trainer, ledger, 1.0, 1, wait=True)
    assert storage.alarm == ""
    assert files.load_latest(tmp_path / CHECKPOINTS).manifest["elapsed"] == 1.0


def test_a_run_goes_on_with_other_settings_of_its_process(tmp_path):
    """How many checkpoints are kept, how often, threads and the evaluation at the end may change."""
    trainer, ledger, storage = OffPolicyTrainer(CONFIG, TEAM), Ledger(), RunStorage(tmp_path, CONFIG)
    storage.save(trainer, ledger, 3.0, 1, wait=True)
    learner = LearnerConfig(threads=2, checkpoint_seconds=7.0)
    other = replace(CONFIG, learner=learner, evaluation=EvaluationConfig(farms=3))
    assert RunStorage(tmp_path, other).restore(OffPolicyTrainer(other, TEAM), Ledger()) == (3.0, 1)


def test_a_checkpoint_of_another_configuration_is_refused(tmp_path):
    """Resuming with other settings raises RunDirError."""
    trainer, ledger, storage = OffPolicyTrainer(CONFIG, TEAM), Ledger(), RunStorage(tmp_path, CONFIG)
    storage.save(trainer, ledger, 0.0, 1, wait=True)
    other = RunStorage(tmp_path, replace(CONFIG, seed=12))
    with pytest.raises(RunDirError, match="another configuration"):
        other.restore(trainer, ledger)


def test_the_environments_arguments_are_kept(tmp_path):
    """A learner that resumes has the arguments that a callback has set; what are none is refused."""
    trainer, storage = OffPolicyTrainer(CONFIG, TEAM), RunStorage(tmp_path, CONFIG)
    storage.arguments = '{"size": 9}'
    storage.save(trainer, Ledger(), 0.0, 1, wait=True)
    again = RunStorage(tmp_path, CONFIG)
    again.restore(trainer, Ledger())
    assert again.arguments == '{"size": 9}'
    storage.arguments = "[1]"
    storage.save(trainer, Ledger(), 1.0, 1, wait=True)
    with pytest.raises(CheckpointError, match="arguments are not readable"):
        again.restore(trainer, Ledger())
