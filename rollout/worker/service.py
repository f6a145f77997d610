"""The worker process: farms in the middle, parameters coming in, chunks going out, evaluations on request."""

import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from common.actors import TeamActors
from common.config.files import from_toml
from common.config.run import RunConfig
from common.errors import ProtocolError, UsageError
from common.history import History, Start
from common.policy_store import PolicyStore
from common.process import Presence, StopSignal, connect, denial, fetch_configuration, incarnation, log
from common.protocol import keys
from common.protocol.messages import (
    ConfigurationMessage,
    EvaluationOrder,
    EvaluationResult,
    ImitationMessage,
    ParametersMessage,
    ProgressMessage,
)
from common.transport.bus import Bus, Incoming
from common.transport.endpoint import Endpoint
from rollout.worker.collector import Collector, run_noise_free_episodes
from rollout.worker.sender import ANSWER_SECONDS, LOCKSTEP_ANSWER_SECONDS, Sender
from rollout.worker.view_service import ViewService

REPORT_SECONDS = 1.0
DRAIN_SECONDS = 5.0
IDLE_SECONDS = 0.002
UNTAKEN = 20
"""Chunks in a row that nobody took before the worker asks itself whether it is denied."""
DENIED_SECONDS = 10.0
"""Pause before it says so again."""


@dataclass(frozen=True)
class WorkerOptions:
    """How to start one worker.

    Attributes:
        run: the run's name.
        name: the worker's name, unique in the run.
        endpoint: where the learner or a router listens.
        patience: seconds to wait for somebody to listen there.
        env: the one environment besides the farm that this worker may load, or None. A configuration comes over the
            network, and loading an environment runs its code.
        history: where the worker's own account of its chunks goes, see `common.history`, or None.
    """

    run: str
    name: str
    endpoint: Endpoint
    patience: float = 60.0
    env: str | None = None
    history: Path | None = None


@dataclass
class _Clock:
    simulating: float = 0.0
    waiting: float = 0.0
    too_old: float = 0.0
    evaluations: int = 0
    reported: float = field(default_factory=time.monotonic)


class Worker:
    """One worker's loop; all its methods run in the main thread."""

    def __init__(
        self, options: WorkerOptions, config: RunConfig, told: ConfigurationMessage, control: Bus, bulk: Bus
    ) -> None:
        self._options, self._config, self._lockstep, self._toml = options, config, told.lockstep, told.toml
        self._control = control
        start = incarnation()
        self._collector = Collector(config, options.name, 0 if told.lockstep else start)
        team = self._collector.team
        if team.to_dict() != told.team:
            raise UsageError(f"the learner of run {options.run} is for another team than {config.env.name} has here.")
        self._store = PolicyStore(team)
        patience = LOCKSTEP_ANSWER_SECONDS if told.lockstep else ANSWER_SECONDS
        self._history = History(options.history)
        self._history.add(Start("rollout", options.name, start))
        spool = config.rollout.spool_chunks
        self._sender = Sender(bulk, options.run, options.name, start, team, spool, patience, self._history)
        self._parameters = control.subscribe_state(keys.PARAMETERS.key(options.run))
        self._events = control.subscribe_state(keys.IMITATION_EVENT.key(options.run))
        self._progress = control.subscribe_state(keys.PROGRESS.key(options.run))
        self._orders = control.serve(keys.EVALUATION.key(options.run, worker=options.name), 16)
        self._view_service = ViewService(control, options.run, options.name, start, self._collector, told.toml)
        self._presence = Presence(control, options.run, "rollout", options.name, start)
        self._postponed: list[Incoming] = []
        self._state, self._stop = "starting", StopSignal()
        self._epoch = self._newest = self._malformed = 0
        self._heard = time.monotonic()
        self._paused = ""
        self._denied = 0.0
        self._clock = _Clock()

    def run(self, stop: StopSignal) -> None:
        """Collect and deliver until told to stop or the run is finished."""
        self._stop = stop
        while not stop and self._state != "finished":
            self._listen()
            self._evaluate()
            self._view_service.poll(self._store.version, *self._exploration())
            actors = self._store.actors
            if actors is not None and self._state in ("starting", "training") and self._may_fly():
                self._fly(actors)
            else:
                self._idle()
            if time.monotonic() - self._clock.reported >= REPORT_SECONDS:
                self._report()
        if not self._sender.wait_empty(DRAIN_SECONDS):
            log(f"worker {self._options.name}: {self._sender.in_flight} steps were not delivered.")
        self._report()
        try:
            self._sender.close()
        finally:
            self._history.close()

    def _may_fly(self) -> bool:
        if not self._lockstep:
            self._paused = self._too_old()
            return not self._paused and not self._sender.full
        return self._sender.spooled == 0 and self._store.version >= max(1, self._sender.required_version)

    def _too_old(self) -> str:
        """Return why the worker's actors are too old to fly with, or nothing."""
        config, lag = self._config.rollout, self._newest - self._store.version
        if 0 < config.max_lag_versions < lag and self._store.epoch == self._epoch:
            return f"its actors are {lag} versions old, more than {config.max_lag_versions}"
        silence = time.monotonic() - self._heard
        if 0 < config.max_silence_seconds < silence:
            return f"nothing was heard of the learner for {silence:.0f} s"
        return ""

    def _fly(self, actors: TeamActors) -> None:
        started = time.monotonic()
        chunk = self._collector.collect(actors, *self._exploration())
        self._sender.flown = self._collector.environment_steps
        self._sender.offer(chunk, self._store.version)
        self._clock.simulating += time.monotonic() - started

    def _exploration(self) -> tuple[float, bool]:
        """Return the noise's standard deviation, and whether actions are drawn uniformly instead (warm-up)."""
        store, config = self._store, self._config
        return config.exploration.deviation(store.progress), store.environment_steps < config.replay.warmup_steps

    def _idle(self) -> None:
        time.sleep(IDLE_SECONDS)
        self._clock.waiting += IDLE_SECONDS
        if self._paused:
            self._clock.too_old += IDLE_SECONDS

    def _listen(self) -> None:
        try:
            if (sample := self._progress.poll()) is not None:
                self._follow(ProgressMessage.decode(sample.payload))
            if (sample := self._parameters.poll()) is not None:
                self._store.offer_parameters(ParametersMessage.decode(sample.payload))
            if (sample := self._events.poll()) is not None:
                announced = ImitationMessage.decode(sample.payload)
                self._store.offer_imitation(announced.to_event(), announced.epoch)
        except ProtocolError as error:
            self._malformed += 1
            log(f"worker {self._options.name}: dropped a message: {error}")

    def _follow(self, message: ProgressMessage) -> None:
        if message.epoch < self._epoch:
            return
        if 0 < self._epoch < message.epoch:
            answer = fetch_configuration(
                self._control, self._options.run, self._options.name, lambda: not self._stop, 5.0
            )
            if answer is not None and answer.toml != self._toml:
                raise UsageError(f"run {self._options.run} has a new learner with another configuration.")
        self._epoch, self._state = message.epoch, message.state
        self._sender.hurry(self._state == "draining")
        self._newest, self._heard = message.version, time.monotonic()

    def _evaluate(self) -> None:
        for incoming in self._orders.waiting():
            self._postponed.append(incoming)
        # The coordinator asks one worker for one thing at a time: before a newer order it has given up the older ones.
        waiting, self._postponed = self._postponed, []
        for incoming in waiting[:-1]:
            incoming.refuse("a newer order has come.")
        if waiting:
            self._answer(waiting[-1])

    def _answer(self, incoming: Incoming) -> None:
        try:
            order = EvaluationOrder.decode(incoming.payload)
            if not 0 < len(order.farms) == len(order.episodes) <= 256:
                raise ProtocolError("an evaluation needs one episode seed for each of 1 to 256 farms.")
        except ProtocolError as error:
            incoming.refuse(str(error))
            return
        actors = self._store.actors
        if actors is not None and order.epoch < self._store.epoch:
            incoming.refuse("the order is of a learner that has been replaced.")
            return
        if actors is None or (self._store.epoch, self._store.version) < (order.epoch, order.version):
            self._postponed.append(incoming)
            return
        reward, steps = run_noise_free_episodes(self._config, actors, order.farms, order.episodes)
        self._clock.evaluations += len(order.farms)
        incoming.reply(EvaluationResult(order.event, self._store.version, reward, steps).encode())

    def _report(self) -> None:
        clock, sender = self._clock, self._sender
        values: dict[str, Any] = {
            "state": self._state,
            "environment_steps": self._collector.environment_steps,
            "produced": self._collector.environment_steps,
            "accepted": sender.accepted,
            "rejected": sender.rejected,
            "in_flight": sender.in_flight,
            "retries": sender.retries,
            "spooled": sender.spooled,
            "simulating_seconds": clock.simulating,
            "waiting_seconds": clock.waiting,
            "evaluations": clock.evaluations,
            "epoch": self._store.epoch,
            "version": self._store.version,
            "event": self._store.event,
            "stale": self._store.stale,
            "missed": self._parameters.missed,
            "malformed": self._malformed,
            "watchers": self._view_service.watchers,
            "shown": self._view_service.shown,
            "skipped": self._view_service.skipped,
            "paused": self._paused,
            "paused_seconds": clock.too_old,
            "alarms": [text for text in (self._history.failure, self._paused) if text],
        }
        if sender.untaken >= UNTAKEN and clock.reported >= self._denied + DENIED_SECONDS:
            self._denied = clock.reported
            if (sentence := denial(self._control, self._options.run, sender.key)) is not None:
                log(f"worker {self._options.name}: {sentence}")
        self._presence.report(values, self._store.version)
        clock.reported = time.monotonic()


def serve(options: WorkerOptions) -> None:
    """Run one worker until the run is finished or a signal comes.

    Raises:
        EndpointError: when nobody listens at the endpoint in time.
        UsageError: when the learner's configuration cannot be read, is another one after the learner was replaced, or
            names an environment that this worker may not load or that has another team here.
    """
    stop = StopSignal()
    stop.install()
    with connect(options.endpoint, "control", stop, options.patience) as control:
        answer = fetch_configuration(control, options.run, options.name, lambda: not stop, 5.0)
        if answer is None:
            return
        try:
            config = from_toml(answer.toml, RunConfig())
        except UsageError as error:
            raise UsageError(f"the learner of run {options.run} speaks of another configuration: {error}") from error
        if not config.env.is_farm and config.env.name != options.env:
            raise UsageError(
                f"run {options.run} is about {config.env.name}; a worker loads it when started with "
                f"--env {config.env.name}."
            )
        with connect(options.endpoint, "bulk", stop, options.patience) as bulk:
            Worker(options, config, answer, control, bulk).run(stop)
