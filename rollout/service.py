"""The worker process: farms in the middle, parameters coming in, chunks going out, evaluations on request."""

import time
from dataclasses import dataclass, field
from typing import Any

from common import keys
from common.actors import ActorBank
from common.bus import Bus, Incoming
from common.config.files import from_toml
from common.config.run import RunConfig
from common.endpoint import Endpoint
from common.errors import ProtocolError, UsageError
from common.messages import (
    ConfigurationMessage,
    EvaluationOrder,
    EvaluationResult,
    ImitationMessage,
    ParametersMessage,
    ProgressMessage,
)
from common.policy_store import PolicyStore
from common.process import Presence, StopSignal, connect, fetch_configuration, incarnation, log
from common.team import farm_team
from common.transitions import Chunk
from rollout.collector import Collector, fly_noise_free
from rollout.sender import ANSWER_SECONDS, LOCKSTEP_ANSWER_SECONDS, Sender

REPORT_SECONDS = 1.0
DRAIN_SECONDS = 5.0
IDLE_SECONDS = 0.002


@dataclass(frozen=True)
class WorkerOptions:
    """How to start one worker.

    Attributes:
        run: the run's name.
        name: the worker's name, unique in the run.
        endpoint: where the learner or a router listens.
        patience: seconds to wait for somebody to listen there.
    """

    run: str
    name: str
    endpoint: Endpoint
    patience: float = 60.0


@dataclass
class _Clock:
    simulating: float = 0.0
    waiting: float = 0.0
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
        team = farm_team(config.farm)
        self._store = PolicyStore(team)
        self._collector = Collector(config, options.name, 0 if told.lockstep else start)
        patience = LOCKSTEP_ANSWER_SECONDS if told.lockstep else ANSWER_SECONDS
        self._sender = Sender(bulk, options.run, options.name, start, team, config.rollout.spool_chunks, patience)
        self._parameters = control.subscribe_state(keys.PARAMETERS.key(options.run))
        self._events = control.subscribe_state(keys.IMITATION_EVENT.key(options.run))
        self._progress = control.subscribe_state(keys.PROGRESS.key(options.run))
        self._orders = control.serve(keys.EVALUATION.key(options.run, worker=options.name), 16)
        self._presence = Presence(control, options.run, "rollout", options.name, start)
        self._postponed: list[Incoming] = []
        self._pending: tuple[Chunk, int] | None = None
        self._state = "starting"
        self._epoch = 0
        self._malformed = 0
        self._clock = _Clock()

    def run(self, stop: StopSignal) -> None:
        """Collect and deliver until told to stop or the run is finished."""
        while not stop and self._state != "finished":
            self._listen()
            self._evaluate()
            bank = self._store.bank
            if self._pending is not None:
                if self._sender.offer(*self._pending):
                    self._pending = None
                else:
                    self._idle()
            elif bank is not None and self._state in ("starting", "training") and self._may_fly():
                self._fly(bank)
            else:
                self._idle()
            if time.monotonic() - self._clock.reported >= REPORT_SECONDS:
                self._report()
        if not self._sender.wait_empty(DRAIN_SECONDS):
            log(f"worker {self._options.name}: {self._sender.in_flight} steps were not delivered.")
        self._report()
        self._sender.close()

    def _may_fly(self) -> bool:
        if not self._lockstep:
            return True
        return self._sender.spooled == 0 and self._store.version >= max(1, self._sender.required_version)

    def _fly(self, bank: ActorBank) -> None:
        started = time.monotonic()
        store, config = self._store, self._config
        uniform = store.environment_steps < config.replay.warmup_steps
        chunk = self._collector.collect(bank, config.exploration.deviation(store.progress), uniform)
        self._pending = (chunk, store.version)
        self._sender.flown = self._collector.environment_steps
        self._clock.simulating += time.monotonic() - started

    def _idle(self) -> None:
        time.sleep(IDLE_SECONDS)
        self._clock.waiting += IDLE_SECONDS

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
            answer = fetch_configuration(self._control, self._options.run, self._options.name, lambda: True, 5.0)
            if answer is not None and answer.toml != self._toml:
                raise UsageError(f"run {self._options.run} has a new learner with another configuration.")
        self._epoch, self._state = message.epoch, message.state

    def _evaluate(self) -> None:
        while (incoming := self._orders.poll()) is not None:
            self._postponed.append(incoming)
        waiting, self._postponed = self._postponed, []
        for incoming in waiting:
            self._answer(incoming)

    def _answer(self, incoming: Incoming) -> None:
        try:
            order = EvaluationOrder.decode(incoming.payload)
            if not 0 < len(order.farms) == len(order.episodes) <= 256:
                raise ProtocolError("an evaluation needs one episode seed for each of 1 to 256 farms.")
        except ProtocolError as error:
            incoming.refuse(str(error))
            return
        bank = self._store.bank
        if bank is not None and order.epoch < self._store.epoch:
            incoming.refuse("the order is of a learner that has been replaced.")
            return
        if bank is None or (self._store.epoch, self._store.version) < (order.epoch, order.version):
            self._postponed.append(incoming)
            return
        reward = fly_noise_free(self._config, bank, order.farms, order.episodes)
        self._clock.evaluations += len(order.farms)
        incoming.reply(EvaluationResult(order.event, self._store.version, reward).encode())

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
            "version": self._store.version,
            "event": self._store.event,
            "stale": self._store.stale,
            "missed": self._parameters.missed,
            "malformed": self._malformed,
        }
        self._presence.report(values, self._store.version)
        clock.reported = time.monotonic()


def serve(options: WorkerOptions) -> None:
    """Run one worker until the run is finished or a signal comes.

    Raises:
        EndpointError: when nobody listens at the endpoint in time.
        UsageError: when the learner's configuration cannot be read, or is another one after the learner was replaced.
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
        with connect(options.endpoint, "bulk", stop, options.patience) as bulk:
            Worker(options, config, answer, control, bulk).run(stop)
