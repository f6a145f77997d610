"""Trains a run for a program, in its own process or by others, and calls its callbacks meanwhile."""

import shlex
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack, closing
from functools import partial
from pathlib import Path
from typing import Any, Final

from eia_sec.common import plugins
from eia_sec.common.callbacks import Callback, call
from eia_sec.common.config import RunConfig
from eia_sec.common.environment import EnvironmentSpec
from eia_sec.common.errors import BusError, ConfigError, RunDirError
from eia_sec.common.policy_file import POLICY, load_policy
from eia_sec.common.process import StopSignal
from eia_sec.common.protocol.metrics import scalars
from eia_sec.common.steered_progress import SteeredProgress
from eia_sec.common.transitions import Chunk
from eia_sec.common.transport.endpoint import Endpoint, free_endpoint
from eia_sec.deploy.local.code_options import code_options
from eia_sec.deploy.local.in_process import WORKER, train_with
from eia_sec.deploy.local.run_directory import TRAIN_LOCK, RunDirectory
from eia_sec.deploy.local.training_processes import ProcessPlan, TrainingProcesses
from eia_sec.deploy.monitor.run_monitor import RunMonitor
from eia_sec.deploy.python.run import Run, without_timeout
from eia_sec.learner.checkpoint.storage import RunStorage
from eia_sec.learner.process.curves import Curves
from eia_sec.learner.process.metrics_log import MetricsLog
from eia_sec.learner.process.trainer_progress import TrainerProgress
from eia_sec.learner.trainer import Trainer
from eia_sec.rollout.envs.registry import environment_spec, patient_with
from eia_sec.rollout.start_policy import start_parameters
from eia_sec.rollout.worker.collector import Collector
from eia_sec.rollout.worker.outages import Outages

REFRESH_SECONDS: Final = 0.2
"""Time between two looks at the processes."""
CALL_SECONDS: Final = 1.0
"""Time between two calls of callbacks, where other processes train."""


class _InProcess(TrainerProgress):
    """Training in this process."""

    def __init__(self, config: RunConfig, trainer: Trainer, collector: Collector) -> None:
        super().__init__(config, trainer)
        self._collector = collector
        self._types = collector.team.types
        self.curves = Curves(collector.team)

    @property
    def metrics(self) -> Mapping[str, float]:
        return scalars({"curves": self.curves.smoothed(), "statistics": self._trainer.statistics()}, self._types)

    def _change(self, arguments: str) -> None:
        self._collector.change_arguments(arguments)


class _Elsewhere(SteeredProgress):
    """Training by other processes, as their learner's metrics tell."""

    def __init__(
        self, config: RunConfig, types: Sequence[str], monitor: RunMonitor, ask: Callable[[str], None]
    ) -> None:
        super().__init__(config)
        self._types, self.monitor, self._ask, self._wanted = types, monitor, ask, ""

    @property
    def values(self) -> Mapping[str, Any]:
        """The learner's newest metrics."""
        return self.monitor.learner_values()

    def note_end(self) -> None:
        """Take over why a callback of a plug-in, which the learner calls, has stopped the run."""
        self.monitor.update()
        if not self.stopped and (reason := self.monitor.stopped_by()):
            self.stop(reason)

    def repeat(self) -> None:
        """Set arguments again where a learner does not have them, because it was restarted."""
        if self._wanted and self.values.get("arguments", "") != self._wanted:
            self._change(self._wanted)

    @property
    def environment_steps(self) -> int:
        return int(self.values.get("environment_steps", 0))

    @property
    def episodes(self) -> int:
        return int(self.values.get("episodes", 0))

    @property
    def updates(self) -> int:
        return int(self.values.get("updates", 0))

    @property
    def progress(self) -> float:
        return float(self.values.get("progress", 0.0))

    @property
    def metrics(self) -> Mapping[str, float]:
        return scalars({name: self.values.get(name, {}) for name in ("curves", "statistics")}, self._types)

    def _change(self, arguments: str) -> None:
        try:
            self._ask(arguments)
        except BusError as error:
            raise ConfigError(f"the learner refused the environment's arguments: {error}") from error
        self._wanted = arguments  # `repeat` asks again if no answer came


def train_here(config: RunConfig, folder: Path | None, callbacks: Sequence[Callback]) -> Run:
    """Train in this process, on one core.

    Args:
        config: the run.
        folder: a new or empty run directory for configuration, metrics and policy, or None.
        callbacks: called after every chunk and its updates.

    Raises:
        UsageError: the run is impossible, a folder or a callback cannot be used.
    """
    spec = _tried(config)
    directory = None if folder is None else _directory(config, folder)
    with ExitStack() as held:
        if directory is not None:
            _hold(directory, config, spec, held)
        held.enter_context(patient_with(without_timeout(config)))
        collector = held.enter_context(closing(Collector(config, WORKER, 0)))
        log = held.enter_context(closing(MetricsLog(folder)))
        progress: _InProcess | None = None

        def watch(trainer: Trainer, chunk: Chunk) -> bool:
            nonlocal progress
            progress = progress or _InProcess(config, trainer, collector)
            counters = {"episodes": trainer.episodes, "environment_steps": trainer.environment_steps}
            if chunk.episodes:
                means = progress.curves.add(chunk.episodes)
                log.write("episodes", **counters, updates=trainer.updates, **means)
            call(callbacks, "on_progress", progress)
            return progress.stopped

        trainer = train_with(collector, config, watch)
        assert progress is not None  # a run has a chunk at least
        if failure := RunStorage(folder, config).write_policy(trainer):
            raise RunDirError(failure)
        state, reason = "draining" if progress.stopped else "finished", progress.reason
        log.write("end", state=state, episodes=trainer.episodes, digest=trainer.actors().digest())
        call(callbacks, "on_end", progress)  # last: it may raise
    return Run(config, trainer.actors(), trainer.environment_steps, trainer.episodes, reason, folder)


def train_elsewhere(
    config: RunConfig, folder: Path, callbacks: Sequence[Callback], workers: int, connect: str | None, run: str
) -> Run:
    """Train by a learner, a coordinator and workers as processes of their own; this one watches.

    Args:
        config: the run.
        folder: a new or empty run directory.
        callbacks: called once a second.
        workers: rollout workers on this machine.
        connect: a router's endpoint through which workers of other machines join, or None.
        run: the run's name.

    Raises:
        UsageError: the run is impossible, a folder or a callback cannot be used, or nothing listens at `connect`.
        EiaSecError: the learner or all workers have failed.
    """
    spec = _tried(config)
    plugins.check_callbacks(config.plugins)
    endpoint = Endpoint.parse(connect) if connect else free_endpoint()
    directory = _directory(config, folder)
    plan = ProcessPlan(config, workers, directory, endpoint, run, router=connect is not None)
    processes, stop = TrainingProcesses(plan), StopSignal()
    progress: _Elsewhere | None = None
    with ExitStack() as held:
        _hold(directory, config, spec, held)
        held.callback(stop.uninstall)
        held.callback(processes.stop)
        if threading.current_thread() is threading.main_thread():  # elsewhere Ctrl-C reaches the main thread alone
            stop.install()
        processes.start()
        bus = processes.connect(lambda: bool(stop))
        if bus is not None:
            with bus:
                types = spec.team.types
                progress = _Elsewhere(config, types, RunMonitor(bus, run), partial(processes.set_arguments, bus))
                _watch(processes, progress, callbacks, stop)
                if not processes.over and (stop or progress.stopped):
                    processes.drain(bus)
    processes.raise_failure()
    reason = "" if progress is None else progress.reason
    if progress is not None:
        call(callbacks, "on_end", progress)
    if stop:
        again = shlex.join(["eia-sec", "train", "--resume", "--run-dir", str(folder), *code_options(config)])
        raise KeyboardInterrupt(f"stopped; resume with {again}")
    return _ended(config, folder, reason)


def _watch(processes: TrainingProcesses, progress: _Elsewhere, callbacks: Sequence[Callback], stop: StopSignal) -> None:
    called = time.monotonic()
    while not (stop or progress.stopped or processes.over):
        processes.watch(training=progress.monitor.trains)
        progress.monitor.update()
        if time.monotonic() - called >= CALL_SECONDS and progress.values:
            called = time.monotonic()
            progress.repeat()
            call(callbacks, "on_progress", progress)
        stop.event.wait(REFRESH_SECONDS)
    progress.note_end()


def _tried(config: RunConfig) -> EnvironmentSpec:
    """Return the run's environment after a trial; raise where it cannot be trained or begun with."""
    if config.population.members:
        raise ConfigError("a population is trained by eia-sec train --population; leave population.members at 0.")
    spec = environment_spec(without_timeout(config), trial=True, patience=Outages(threading.Event()))
    config.algorithm.require_types(spec.team.types)
    start_parameters(config, spec.team)
    return spec


def _ended(config: RunConfig, folder: Path, reason: str) -> Run:
    """Return the run whose learner has written its policy."""
    path = folder / POLICY
    if not path.is_file():
        raise RunDirError(f"{folder} has no {POLICY}: the run ended before it could save a policy.")
    actors, metadata = load_policy(path)
    return Run(config, actors, int(metadata["environment_steps"]), int(metadata["episodes"]), reason, folder)


def _directory(config: RunConfig, folder: Path) -> RunDirectory:
    directory = RunDirectory(folder)
    directory.prepare(config, resume=False)
    return directory


def _hold(directory: RunDirectory, config: RunConfig, spec: EnvironmentSpec, held: ExitStack) -> None:
    """Lock a run directory until the stack is closed, and write down what the run is."""
    directory.lock(TRAIN_LOCK)
    held.callback(directory.unlock)
    directory.adopt(config, spec.team)
