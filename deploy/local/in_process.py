"""Training inside one process, without Zenoh: the reference for `--lockstep`, and the quickest way to try a setting.

A collector and the trainer alternate as a worker and the learner do in lockstep, so the weights after N episodes are
bit-equal to those of a distributed lockstep run.
"""

from collections.abc import Callable
from contextlib import closing

from eia_sec.common.config import RunConfig
from eia_sec.common.config.files import with_values
from eia_sec.common.imitation import ImitationSchedule
from eia_sec.common.reward_sums import RewardSums
from eia_sec.common.transitions import Chunk
from eia_sec.elite.evaluation_plan import evaluation_plan
from eia_sec.elite.scoring import decide
from eia_sec.learner.trainer import Trainer
from eia_sec.learner.trainers import make_trainer
from eia_sec.rollout.start_policy import start_parameters
from eia_sec.rollout.worker.collector import Collector, run_noise_free_episodes

WORKER = "0"
"""Name of the worker; the first worker of `eia-sec train` has the same name."""


Watch = Callable[[Trainer, Chunk], object]
"""Called with the trainer and the chunk after each chunk's updates; True ends the run."""


def train_in_process(config: RunConfig, watch: Watch = lambda trainer, chunk: None) -> Trainer:
    """Train to the end of the run, on one core.

    Args:
        config: the run.
        watch: see `Watch`.

    Returns:
        The trainer with its final actors.
    """
    with closing(Collector(config, WORKER, 0)) as collector:
        return train_with(collector, config, watch)


def train_with(collector: Collector, config: RunConfig, watch: Watch) -> Trainer:
    """Train to the end of the run with a new collector of it; otherwise as `train_in_process`."""
    config = with_values(config, {"learner.update_threads": 1})
    trainer = make_trainer(config, collector.team)
    if start := start_parameters(config, trainer.team):
        trainer.begin_with(start)
    schedule = ImitationSchedule.of(config)
    version, published = trainer.next_version(), trainer.changes
    actors, seen_steps, progress, chunks = trainer.actors(), trainer.environment_steps, 0.0, 0
    while trainer.progress < 1.0:
        chunk = collector.collect(actors, *config.exploration_at(progress, seen_steps))
        chunks += 1
        trainer.absorb(chunk, version, WORKER, chunks)
        trainer.train(max(0, trainer.updates_due()))
        if trainer.changes != published or not trainer.publishes_at_once:
            version, published = trainer.next_version(), trainer.changes
        while (due := schedule.after(trainer.separate_since)).is_due(trainer.events, trainer.episodes):
            number, rewards, evaluation_steps = trainer.events + 1, trainer.rewards, 0
            if config.elite.farms:
                reward, steps = run_noise_free_episodes(config, trainer.actors(), *evaluation_plan(config, number))
                evaluation_steps = int(steps.sum())
                rewards = RewardSums.of(reward, evaluation_steps)
            episode = due.due_episode(number) or 0
            trainer.imitate(decide(trainer.team, config.elite, number, version, episode, rewards, evaluation_steps))
            version, published = trainer.next_version(), trainer.changes
        actors, seen_steps = trainer.actors(), trainer.environment_steps
        progress = trainer.progress
        if watch(trainer, chunk) is True:
            break
    return trainer
