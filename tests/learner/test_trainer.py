"""The trainer: counters, pace, imitation, learning, and going on from a saved state."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
import torch

from eia_sec.common.actors import TeamActors, imitate
from eia_sec.common.config import EiaSecConfig, ReplayConfig
from eia_sec.common.config.presets import preset
from eia_sec.common.errors import CheckpointError, SchemaError
from eia_sec.common.imitation import ImitationEvent
from eia_sec.common.team import GroupSpec, TeamSpec
from eia_sec.common.transitions import TRANSITION, TRUNCATED, Chunk, EpisodeSummary, Rows
from eia_sec.learner.checkpoint import files
from eia_sec.learner.off_policy.trainer import OffPolicyTrainer

TEAM = TeamSpec((GroupSpec("a", 2, 3, 1), GroupSpec("b", 3, 2, 2)))
CONFIG = replace(
    preset("eia-sec"),
    seed=11,
    algorithm=EiaSecConfig(hidden=12, batch=16, reward_scale=1.0),
    replay=ReplayConfig(capacity=512, warmup_steps=40, updates_per_step=0.5, slack_steps=30),
)


def chunk(steps, seed=0, episodes=0, reward=None):
    """Return one segment of `steps` steps of noise; `reward` maps observations and actions to rewards."""
    draw = np.random.default_rng(seed)
    observation = draw.uniform(-1, 1, (steps + 1, TEAM.observation_size)).astype(np.float32)
    action = draw.uniform(-1, 1, (steps + 1, TEAM.action_size)).astype(np.float32)
    paid = (
        draw.normal(size=(steps + 1, TEAM.agents)).astype(np.float32) if reward is None else reward(observation, action)
    )
    flag = np.full(steps + 1, TRANSITION, np.uint8)
    flag[-2] |= TRUNCATED
    flag[-1] = 0
    done = tuple(EpisodeSummary(n, n, steps, tuple(range(TEAM.agents)), {"energy_j": 2.5}) for n in range(episodes))
    return Chunk(Rows(observation, action, paid, flag), done)


def event(number, rate=0.25, elites=(1, 2)):
    scores = tuple((0.0,) * group.count for group in TEAM.groups)
    return ImitationEvent(number, 0, 0, rate, elites, scores)


def assert_bit_equal(one, other):
    ours, theirs = one.state(), other.state()
    assert ours[1] == theirs[1]
    assert ours[0].keys() == theirs[0].keys()
    for name, tensor in ours[0].items():
        assert torch.equal(tensor, theirs[0][name]), name


def test_updates_follow_from_the_counters():
    """Updates due are updates_per_step times the steps beyond the warm-up, rounded down, less those done."""
    trainer = OffPolicyTrainer(CONFIG, TEAM)
    assert trainer.updates_due() == 0
    trainer.absorb(chunk(40, episodes=1))
    assert (trainer.environment_steps, trainer.episodes, trainer.updates_due()) == (40, 1, 0)
    trainer.absorb(chunk(15, 1, episodes=2))
    assert (trainer.environment_steps, trainer.episodes, trainer.updates_due()) == (55, 3, 7)
    trainer.train(5)
    assert (trainer.updates, trainer.updates_due()) == (5, 2)
    assert [episode.farm for episode in trainer.recent] == [0, 0, 1]


def test_no_update_is_due_before_a_batch_is_there():
    """Without a warm-up, the first updates wait until replay holds as many steps as a batch."""
    config = replace(CONFIG, replay=replace(CONFIG.replay, warmup_steps=0))
    trainer = OffPolicyTrainer(config, TEAM)
    trainer.absorb(chunk(15))
    assert trainer.updates_due() == 0
    trainer.absorb(chunk(1, 1))
    assert trainer.updates_due() == 8


def test_production_leads_beyond_the_slack():
    """Producers wait once more than slack_steps environment steps are not yet learnt from."""
    trainer = OffPolicyTrainer(CONFIG, TEAM)
    trainer.absorb(chunk(70))
    assert not trainer.leads()
    trainer.absorb(chunk(2, 1))
    assert trainer.leads()
    trainer.train(1)
    assert not trainer.leads()
    idle = OffPolicyTrainer(replace(CONFIG, replay=replace(CONFIG.replay, updates_per_step=0.0)), TEAM)
    idle.absorb(chunk(400))
    assert not idle.leads()
    assert idle.updates_due() == 0


def test_versions_count_up():
    """Each publication has the next number."""
    trainer = OffPolicyTrainer(CONFIG, TEAM)
    assert [trainer.next_version() for _ in range(3)] == [1, 2, 3]
    assert trainer.version == 3


def test_published_actors_are_a_copy():
    """Actors handed out do not change when training goes on, and training does change the trainer's."""
    trainer = OffPolicyTrainer(CONFIG, TEAM)
    trainer.absorb(chunk(200))
    actors = trainer.actors()
    before = actors.digest()
    assert before == TeamActors.initial(TEAM, 12, 11).digest()
    trainer.train(3)
    assert actors.digest() == before
    assert trainer.actors().digest() != before


def test_imitation_is_the_workers_own_blend_and_happens_once():
    """The learner's actors end bit-equal to the workers' after an event, which a repetition does not apply again."""
    trainer = OffPolicyTrainer(CONFIG, TEAM)
    trainer.absorb(chunk(200))
    trainer.train(5)
    worker = trainer.actors()
    assert trainer.imitate(event(1))
    for flat, elite in zip(worker.flat, (1, 2), strict=True):
        imitate(flat, elite, 0.25)
    assert trainer.actors().digest() == worker.digest()
    assert not trainer.imitate(event(1))
    assert trainer.actors().digest() == worker.digest()
    assert trainer.events == 1
    assert trainer.imitate(event(2, 0.125))
    assert trainer.actors().digest() != worker.digest()


def test_imitation_leaves_the_optimiser_alone():
    """An event changes actors, and neither their moments nor any critic."""
    trainer = OffPolicyTrainer(CONFIG, TEAM)
    trainer.absorb(chunk(200))
    trainer.train(5)
    before = {name: tensor.clone() for name, tensor in trainer.state()[0].items()}
    trainer.imitate(event(1))
    changed = {name for name, tensor in trainer.state()[0].items() if not torch.equal(tensor, before[name])}
    assert changed == {"engine.actors.parameters"}


@pytest.mark.parametrize("wrong", [event(2), event(0), event(1, 1.5), event(1, elites=(2, 0)), event(1, elites=(0,))])
def test_events_that_cannot_be_are_refused(wrong):
    """A gap in the numbers, a rate above 1, or an elite that is not in the type raises SchemaError."""
    trainer = OffPolicyTrainer(CONFIG, TEAM)
    before = trainer.actors().digest()
    with pytest.raises(SchemaError):
        trainer.imitate(wrong)
    assert (trainer.events, trainer.actors().digest()) == (0, before)


def test_same_seed_same_run():
    """Two trainers fed the same chunks are bit-equal in all they hold; another seed gives another run."""
    trainers = [OffPolicyTrainer(replace(CONFIG, seed=seed), TEAM) for seed in (1, 1, 2)]
    for number in range(3):
        for trainer in trainers:
            trainer.absorb(chunk(60, number, episodes=1), trainer.next_version())
            trainer.train(max(0, trainer.updates_due()))
    assert_bit_equal(trainers[0], trainers[1])
    assert trainers[0].actors().digest() != trainers[2].actors().digest()


@pytest.mark.parametrize("cut", [1, 2, 4])
def test_a_restored_trainer_goes_on_bit_equal(tmp_path, cut):
    """Saved, loaded from disk and continued, a run ends at exactly the state of the run that was not interrupted."""
    config = replace(CONFIG, algorithm=replace(CONFIG.algorithm, ensemble_copy_rate=0.01))
    whole, resumed = OffPolicyTrainer(config, TEAM), OffPolicyTrainer(config, TEAM)

    def play(trainer, first, last):
        for number in range(first, last):
            trainer.absorb(chunk(150, number, episodes=1), trainer.next_version())
            trainer.train(trainer.updates_due())
            trainer.imitate(event(number + 1))

    play(whole, 0, cut)
    files.save(tmp_path, *whole.state(), keep=1)
    play(whole, cut, 6)
    found = files.load_latest(tmp_path)
    resumed.restore(found.tensors, found.manifest)
    assert resumed.updates < whole.updates
    play(resumed, cut, 6)
    assert_bit_equal(whole, resumed)
    assert whole.statistics() == resumed.statistics()


@pytest.mark.parametrize(
    ("name", "way"),
    [
        ("diagnostics.q_mean", "wrong"),
        *itertools.product(
            ["engine.actors.parameters", "engine.critics.exp_avg_sq", "replay.reward", "updates", "random", "recent"],
            ["missing", "wrong"],
        ),
    ],
)
def test_a_state_that_does_not_fit_changes_nothing(name, way):
    """A state that lacks something, or holds something of another kind, is refused before anything is taken from it."""
    source, target = OffPolicyTrainer(CONFIG, TEAM), OffPolicyTrainer(replace(CONFIG, seed=12), TEAM)
    source.absorb(chunk(100, episodes=1))
    source.train(2)
    tensors, plain = source.state()
    tensors = dict(tensors)
    where = tensors if name in tensors else plain
    if way == "missing":
        del where[name]
    elif name in tensors:
        tensors[name] = torch.full_like(tensors[name], float("nan")) if "engine" in name else torch.zeros(7)
    else:
        plain[name] = {"updates": -1, "random": {"key": [1]}, "recent": [{"farm": 1}]}[name]
    before = target.actors().digest()
    with pytest.raises(CheckpointError):
        target.restore(tensors, plain)
    assert target.actors().digest() == before
    assert (target.updates, target.replay.rows, target.environment_steps) == (0, 0, 0)


def test_learns_to_match_a_given_action():
    """With reward -(a - f(o))^2 and no future, actors come close to f within a few hundred updates."""

    def wanted(observation):
        return np.concatenate(
            [0.5 * np.tanh(observation[:, [0, 3]])] + [0.6 * observation[:, 6 + 2 * i : 8 + 2 * i] for i in range(3)],
            axis=1,
        )

    def reward(observation, action):
        square = (action - wanted(observation)) ** 2
        parts = np.split(square, [1, 2, 4, 6], axis=1)
        return -np.stack([part.sum(axis=1) for part in parts], axis=1).astype(np.float32)

    algorithm = EiaSecConfig(hidden=32, batch=64, reward_scale=1.0, discount=0.0, actor_rate=2e-3, critic_rate=3e-3)
    settings = ReplayConfig(capacity=4096, warmup_steps=0, updates_per_step=1.0)
    trainer = OffPolicyTrainer(replace(preset("eia-sec"), seed=3, algorithm=algorithm, replay=settings), TEAM)
    trainer.absorb(chunk(3000, reward=reward))
    test = chunk(500, 99).rows.observation

    def miss():
        return float(np.square(trainer.actors().act(test) - wanted(test)).mean())

    before = miss()
    trainer.train(800)
    assert before > 0.08
    assert miss() < 0.01


def test_rows_of_old_versions_are_not_drawn():
    """With a limit of two versions rows stay drawable until a third newer one is published, and are then counted."""
    trainer = OffPolicyTrainer(replace(CONFIG, replay=replace(CONFIG.replay, max_age_versions=2)), TEAM)
    for number in range(4):
        trainer.absorb(chunk(20, number), trainer.version)
        trainer.next_version()
    assert trainer.version == 4
    assert (trainer.replay.transitions, trainer.statistics()["replay_dropped"]) == (40, 40)
    trainer.train(20)
    assert trainer.statistics()["sample_age_most_versions"] <= 2


def test_statistics_hold_losses_and_age():
    """Statistics hold a finite figure of each kind for each type, the fill of replay and the age of the samples."""
    trainer = OffPolicyTrainer(CONFIG, TEAM)
    trainer.absorb(chunk(255), trainer.next_version())
    for _ in range(4):
        trainer.next_version()
    trainer.train(20)
    diagnostics = trainer.statistics()
    assert diagnostics["sample_age_versions"] == 4
    assert diagnostics["replay_occupancy"] == 0.5
    assert diagnostics["critic_loss/a"] > 0.1
    assert diagnostics["critic_loss/b"] > 0.1
    assert all(np.isfinite(value) for value in diagnostics.values())
