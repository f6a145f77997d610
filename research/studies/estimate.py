"""How long jobs will take, reported before any of them begins.

A kind of run of which a record is there takes as long again for each episode. Of any other a first piece is done here:
two chunks are flown, some updates trained (on policy: an iteration flown and trained) and an evaluation begun; the rest
is arithmetic.
"""

import math
import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, Final

from eia_sec.common.actors import TeamActors
from eia_sec.common.config import RunConfig
from eia_sec.common.config.algorithms import OnPolicyConfig
from eia_sec.deploy.local.in_process import train_in_process
from eia_sec.learner.off_policy.trainer import OffPolicyTrainer
from eia_sec.rollout.evaluation import evaluate
from eia_sec.rollout.policies import ActorPolicy, Policy, policy_of
from eia_sec.rollout.worker.collector import Collector
from research.studies.jobs import Job, Records
from research.studies.perform import farms_of

STARTUP_SECONDS: Final = 6.0
"""What a process needs before its work begins."""
PIECE_STEPS: Final = 60
"""Steps of the episodes of a first piece."""
PIECE_UPDATES: Final = 12
REPEATS: Final = 5
"""Times that a piece is done; the median counts, since other work on the machine disturbs some of them."""
DECISION_MILLISECONDS: Final = 1.0
"""Allowed for each time step of a timing job and for each dozen UAVs."""


class Estimator:
    """Estimates jobs; every kind of job is measured once.

    Args:
        records: what has been done, of which the times are known.
    """

    def __init__(self, records: Records) -> None:
        self._records = records
        self._known: dict[tuple[Any, ...], float] = {}

    def learn(self, jobs: Sequence[Job]) -> None:
        """Take the times of jobs that have a record; of several alike the least, as other work only adds to it."""
        for job in jobs:
            record = self._records.get(job)
            if record is not None and record.get("seconds"):
                likeness, each = _likeness(job), max(0.0, float(record["seconds"])) / _amount(job)
                self._known[likeness] = min(each, self._known.get(likeness, each))

    def seconds(self, job: Job) -> float:
        """Return how long a job will take in a process of its own, s."""
        likeness = _likeness(job)
        if likeness not in self._known:
            self._known[likeness] = _MEASURES[job.kind](job) / _amount(job)
        return STARTUP_SECONDS + self._known[likeness] * _amount(job)


def _likeness(job: Job) -> tuple[Any, ...]:
    """Return what two jobs share whose times grow with their amounts alone."""
    config = job.config
    world, algorithm = config.farm.world, config.algorithm
    what = job.options.get("policy") or replace(algorithm, actor_rate=1.0, critic_rate=1.0, reward_scale=1.0)
    sizes = (world.communication_uavs, world.monitoring_uavs, world.collection_uavs, world.sensors, world.steps)
    return (job.kind, what, *sizes, config.replay.updates_per_step, config.rollout.environments)


def _amount(job: Job) -> float:
    """Return how much of a job there is: episodes, farms or steps."""
    if job.kind == "train":
        return float(job.config.episodes)
    return float(job.options["steps"] if job.kind == "time" else len(farms_of(job.options["farms"])))


def _measure_training(job: Job) -> float:
    config, steps = job.config, job.config.episodes * job.config.farm.world.steps
    on_policy = isinstance(config.algorithm, OnPolicyConfig)
    learning, actors = _learning_on_policy(config, steps) if on_policy else _learning_off_policy(config, steps)
    evaluating = _flown(config, ActorPolicy(actors.noise_free()))
    checks = int(job.options["evaluations"]) * len(farms_of(job.options["choice_farms"]))
    flown = checks + len(farms_of(job.options["farms"]))
    return learning + flown * config.farm.world.steps * evaluating


def _learning_on_policy(config: RunConfig, steps: int) -> tuple[float, TeamActors]:
    """Return the seconds of so many steps of training, from those of two iterations, and the actors."""
    piece = math.ceil(2 * config.on_policy.iteration_steps / config.farm.world.steps)
    begun: list[float] = []
    trainer = train_in_process(replace(config, episodes=piece), lambda *_: begun.append(time.perf_counter()))
    # The first chunk waits for the compiler.
    share = (len(begun) - 1) / len(begun) if len(begun) > 1 else 1.0
    return (time.perf_counter() - begun[0]) / share * steps / trainer.environment_steps, trainer.actors()


def _learning_off_policy(config: RunConfig, steps: int) -> tuple[float, TeamActors]:
    """Return the seconds of so many steps of training, from those of single updates, and the actors."""
    rows = config.rollout.chunk_rows(config.rollout.chunk_steps)
    room = min(config.replay.capacity, max(4096, 2 * config.algorithm.batch, rows))
    short = replace(config, replay=replace(config.replay, warmup_steps=0, capacity=room))
    collector = Collector(short, "0", 0)
    trainer = OffPolicyTrainer(short, collector.team)
    actors = trainer.actors()
    trainer.absorb(collector.collect(actors, 0.1, False))
    while trainer.replay.transitions < config.algorithm.batch:
        trainer.absorb(collector.collect(actors, 0.1, False))
    trainer.train(2)
    flying = _seconds(lambda: trainer.absorb(collector.collect(actors, 0.1, False)))
    flying /= short.rollout.environments * short.rollout.chunk_steps
    training = _seconds(lambda: trainer.train(PIECE_UPDATES)) / PIECE_UPDATES
    updates = config.replay.updates_per_step * max(0, steps - config.replay.warmup_steps)
    return steps * flying + updates * training, actors


def _measure_flight(job: Job) -> float:
    farm, farms = job.config.farm, len(farms_of(job.options["farms"]))
    return farms * farm.world.steps * _flown(job.config, policy_of(str(job.options["policy"]), farm))


def _measure_timing(job: Job) -> float:
    return 1e-3 * DECISION_MILLISECONDS * float(job.options["steps"]) * job.config.farm.world.uavs / 12


def _flown(config: RunConfig, policy: Policy) -> float:
    """Return the seconds of one step of one farm under a policy, from the start of an episode."""
    world = config.farm.world
    short = replace(config.farm, world=replace(world, steps=min(PIECE_STEPS, world.steps)))
    evaluate(short, policy, [0], 1, name="")
    return _seconds(lambda: evaluate(short, policy, [1], 1, name="")) / short.world.steps


def _seconds(work: Callable[[], object]) -> float:
    """Return the median of the seconds that some work takes, which is done several times."""
    took = []
    for _ in range(REPEATS):
        start = time.perf_counter()
        work()
        took.append(time.perf_counter() - start)
    return statistics.median(took)


_MEASURES: Final[dict[str, Callable[[Job], float]]] = {
    "train": _measure_training,
    "fly": _measure_flight,
    "time": _measure_timing,
}
