"""The elite coordinator: when an event is due, it has workers evaluate the actors and announces the elites."""

import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from eia_sec.common.config.files import read_saved
from eia_sec.common.config.run import RunConfig
from eia_sec.common.errors import BusClosedError, BusError, CancelledError, ProtocolError
from eia_sec.common.imitation import LEASE_SECONDS, ImitationEvent, ImitationSchedule
from eia_sec.common.incarnation import new_incarnation
from eia_sec.common.log import log
from eia_sec.common.process import Presence, StopSignal, connect, denial, fetch_configuration
from eia_sec.common.protocol import keys
from eia_sec.common.protocol.epoch_fence import EpochFence
from eia_sec.common.protocol.messages import (
    CommandMessage,
    Envelope,
    EvaluationOrder,
    EvaluationResult,
    ImitationMessage,
    ProgressMessage,
    ReceiptMessage,
)
from eia_sec.common.team import Float32, TeamSpec
from eia_sec.common.transport.bus import Bus
from eia_sec.common.transport.endpoint import Endpoint
from eia_sec.elite.evaluation_plan import evaluation_plan
from eia_sec.elite.scoring import decide

ANSWER_SECONDS = 30.0
"""Initial time limit for a worker's evaluation; after it, the worker's farms go to other workers."""
LONGEST_SECONDS = 3600.0
"""Largest time limit; each attempt that nobody answers doubles the limit."""
DELIVER_SECONDS = 120.0
"""Time that the learner has to apply an event; on policy it first ends the updates of its iteration."""
RETRY_SECONDS = 0.5
"""Pause after an attempt that reached no worker; the workers may have just died."""
CLAIM_SECONDS = 1.0
"""Time between two claims to the lead."""
REPORT_SECONDS = 1.0
IDLE_SECONDS = 0.02


@dataclass(frozen=True)
class CoordinatorOptions:
    """How to start the coordinator.

    Attributes:
        run: the run's name.
        name: the coordinator's name.
        endpoint: where the learner or a router listens.
        patience: seconds to wait for a listener there.
    """

    run: str
    endpoint: Endpoint
    name: str = "coordinator"
    patience: float = 60.0


class Coordinator:
    """The coordinator's loop.

    It keeps no state of its own: the learner's count of applied events says which event is next, so a restarted
    coordinator continues where the last one stopped. If there are several, the one that holds the learner's lease
    leads, and the others stand by.
    """

    def __init__(self, options: CoordinatorOptions, config: RunConfig, team: TeamSpec, control: Bus) -> None:
        self._options, self._config, self._team, self._bus = options, config, team, control
        self._schedule = ImitationSchedule.of(config)
        self._progress = control.subscribe_state(keys.PROGRESS.key(options.run))
        self._tokens = control.watch(keys.LIVE.pattern(options.run, role="rollout"), 1024)
        self._announcer = control.publish_state(keys.IMITATION_EVENT.key(options.run))
        start = new_incarnation()
        self._presence = Presence(control, options.run, "elite", options.name, start)
        self._envelope = Envelope("elite", options.name, start, 1).encode()
        self._leads, self._claimed, self._granted = False, 0.0, -LEASE_SECONDS
        self._workers: set[str] = set()
        self._now: ProgressMessage | None = None
        self._fence = EpochFence()
        self._last: ImitationEvent | None = None
        self._failures = self._malformed = 0
        self._patience = ANSWER_SECONDS
        self._reported = 0.0

    def run(self, stop: StopSignal) -> None:
        """Coordinate until a stop signal comes or the run is finished."""
        while not stop:
            self._listen()
            now = self._now
            if now is not None and now.state == "finished":
                break
            self._claim()
            if (
                self._leads
                and now is not None
                and now.state == "training"
                and self._schedule.is_due(now.events, now.episodes)
            ):
                self._hold_event(now, stop)
            time.sleep(IDLE_SECONDS)
            if time.monotonic() - self._reported >= REPORT_SECONDS:
                self._report()
        log(f"coordinator {self._options.name} ends.")
        self._report()

    def _claim(self) -> None:
        """Claim the lead from the learner, or renew the claim, every CLAIM_SECONDS."""
        if time.monotonic() - self._claimed < CLAIM_SECONDS:
            return
        key, payload = keys.COMMAND.key(self._options.run, verb="lead"), CommandMessage(self._options.name).encode()
        self._claimed = time.monotonic()
        try:
            answer = self._bus.ask(key, payload, LEASE_SECONDS, self._envelope)
            # A busy learner answers late, and a claim that it has granted holds meanwhile.
            leads = self._holds_lease() if answer is None else ReceiptMessage.decode(answer).done
            if answer is not None:
                self._granted = self._claimed if leads else -LEASE_SECONDS
        except BusClosedError:
            raise
        except (BusError, ProtocolError) as error:
            log(f"coordinator: the learner does not grant the lead: {error}")
            leads = False
        if leads != self._leads:
            log(f"coordinator {self._options.name} {'leads' if leads else 'stands by'}.")
        self._leads = leads

    def _holds_lease(self) -> bool:
        return time.monotonic() - self._granted < LEASE_SECONDS

    def _listen(self) -> None:
        for sample in self._tokens.drain():
            try:
                name = keys.parse(sample.key).variables["name"]
            except ProtocolError:
                self._malformed += 1
                continue
            (self._workers.add if sample.present else self._workers.discard)(name)
        if (sample_now := self._progress.poll()) is not None:
            try:
                message = ProgressMessage.decode(sample_now.payload)
            except ProtocolError as error:
                self._malformed += 1
                log(f"coordinator: dropped a message: {error}")
                return
            if self._fence.admits(message.epoch, 0 if self._now is None else self._now.epoch):
                self._now = message

    def _hold_event(self, now: ProgressMessage, stop: StopSignal) -> None:
        number = now.events + 1
        due = self._schedule.due_episode(number)
        found = self._evaluate(number, now, stop)
        if found is None or due is None:
            return
        rewards, version = found
        event = decide(self._team, self._config.elite, number, version, due, rewards)
        message = ImitationMessage.of(event, now.epoch)
        if self._deliver(message, stop):
            self._announcer.put(message.encode())
            self._last = event
            elites = ", ".join(f"{g.name} {e}" for g, e in zip(self._team.groups, event.elites, strict=True))
            log(f"coordinator: event {number} is applied with rate {event.rate:.3g}; elites: {elites}.")
        self._await_applied(number, stop)

    def _deliver(self, message: ImitationMessage, stop: StopSignal) -> bool:
        """Ask the learner to apply the event; return whether it applied exactly this one.

        Only then may the event be announced. An event of this number that the learner had already applied may be a
        different one: if its answer to an earlier delivery was lost, a new evaluation may have chosen other elites.
        A learner on policy answers between two iterations, and the lead must not be lost meanwhile.

        Raises:
            CancelledError: a stop signal came.
        """

        def again(waited: float) -> bool:
            if stop:
                raise CancelledError(f"event {message.event} was given up, because this process ends.")
            self._claim()
            return False

        try:
            key = keys.IMITATION.key(self._options.run)
            answer = self._bus.ask(key, message.encode(), DELIVER_SECONDS, self._envelope, again)
            receipt = None if answer is None else ReceiptMessage.decode(answer)
            if answer is None:
                log(denial(self._bus, self._options.run, key) or f"coordinator: event {message.event} got no answer.")
        except (BusError, ProtocolError) as error:
            log(f"coordinator: event {message.event}: {error}")
            return False
        if receipt is not None and not receipt.done:
            log(f"coordinator: the learner refused event {message.event}: {receipt.reason}")
        return receipt is not None and receipt.done and not receipt.reason

    def _await_applied(self, number: int, stop: StopSignal) -> None:
        deadline = time.monotonic() + (5.0 if self._leads else 0.0)
        while not stop and time.monotonic() < deadline:
            self._listen()
            self._claim()
            if self._now is not None and self._now.events >= number:
                return
            time.sleep(IDLE_SECONDS)

    def _evaluate(self, event: int, now: ProgressMessage, stop: StopSignal) -> tuple[list[Float32], int] | None:
        """Return each episode's step rewards in plan order and the oldest version evaluated, or None if abandoned."""
        farms, episodes = evaluation_plan(self._config, event)
        found: dict[int, Float32] = {}
        versions: list[int] = []
        silent: set[str] = set()
        while len(found) < len(farms):
            self._listen()
            if stop or not self._workers or (self._now is not None and self._now.epoch != now.epoch):
                return None
            workers = sorted(self._workers - silent) or sorted(self._workers)
            missing = [index for index in range(len(farms)) if index not in found]
            shares = [missing[k :: len(workers)] for k in range(len(workers))]
            orders = [
                (
                    worker,
                    share,
                    EvaluationOrder(now.epoch, event, now.version, _pick(farms, share), _pick(episodes, share)),
                )
                for worker, share in zip(workers, shares, strict=True)
                if share
            ]
            started = time.monotonic()
            answers = self._ask_all(orders, versions, stop)
            found.update(answers)
            late = [worker for worker, share, _ in orders if share[0] not in answers]
            waited = time.monotonic() - started
            if late and not stop:
                self._note_late(event, late, silent, len(orders), waited)
            elif not late:
                self._patience = min(self._patience, max(ANSWER_SECONDS, 2.0 * waited))
        return [found[index] for index in range(len(farms))], min(versions)

    def _note_late(self, event: int, late: Sequence[str], silent: set[str], asked: int, waited: float) -> None:
        """Exclude workers that did not answer from the next attempts; if nobody answered, lengthen the time limit."""
        self._failures += len(late)
        log(f"coordinator: event {event}: no evaluation after {waited:.1f} s from {', '.join(late)}; trying again.")
        silent.update(late)
        if len(late) == asked:
            silent.clear()
            if waited >= self._patience:
                self._patience = min(2.0 * self._patience, LONGEST_SECONDS)
            else:
                time.sleep(RETRY_SECONDS)
        self._report()

    def _ask_all(
        self, orders: Sequence[tuple[str, list[int], EvaluationOrder]], versions: list[int], stop: StopSignal
    ) -> dict[int, Float32]:
        answers: dict[int, Float32] = {}
        # No daemon threads: after a stop they run until the bus closes, and the process must not end before them.
        threads = [
            threading.Thread(target=self._ask_one, args=(worker, share, order, answers, versions))
            for worker, share, order in orders
        ]
        for thread in threads:
            thread.start()
        while not stop and any(thread.is_alive() for thread in threads):
            self._claim()
            time.sleep(IDLE_SECONDS)
        return dict(answers) if not stop else {}

    def _ask_one(
        self, worker: str, share: list[int], order: EvaluationOrder, answers: dict[int, Float32], versions: list[int]
    ) -> None:
        key = keys.EVALUATION.key(self._options.run, worker=worker)
        try:
            answer = self._bus.ask(key, order.encode(), self._patience)
            if answer is None:
                return
            result = EvaluationResult.decode(answer)
        except BusClosedError:
            return
        except (BusError, ProtocolError) as error:
            log(f"coordinator: worker {worker} did not evaluate: {error}")
            return
        if result.event != order.event or not _fits(result, len(share), self._team):
            log(f"coordinator: worker {worker} answered with an evaluation that does not fit.")
            return
        versions.append(result.version)
        lengths = zip(result.reward, result.steps.tolist(), strict=True)
        answers.update(dict(zip(share, (reward[:steps] for reward, steps in lengths), strict=True)))

    def _report(self) -> None:
        self._reported = time.monotonic()
        last = self._last
        values = {
            "workers": sorted(self._workers),
            "events": 0 if self._now is None else self._now.events,
            "next_episode": self._schedule.due_episode((0 if self._now is None else self._now.events) + 1) or 0,
            "failures": self._failures,
            "malformed": self._malformed,
            "leads": self._leads,
            "rate": last.rate if last else 0.0,
            "elites": dict(zip([g.name for g in self._team.groups], last.elites, strict=True)) if last else {},
            "scores": [list(s) for s in last.scores] if last else [],
            "alarms": [self._fence.alarm] if self._fence.alarm else [],
        }
        self._presence.report(values, 0 if self._now is None else self._now.version)


def _fits(result: EvaluationResult, episodes: int, team: TeamSpec) -> bool:
    """Return whether an evaluation holds this many whole episodes of finite rewards."""
    reward, steps = result.reward, result.steps
    if reward.ndim != 3 or reward.shape[::2] != (episodes, team.agents) or steps.shape != (episodes,):
        return False
    return bool((steps >= 1).all() and (steps <= reward.shape[1]).all() and np.isfinite(reward).all())


def _pick(values: Sequence[int], indices: Sequence[int]) -> tuple[int, ...]:
    return tuple(values[index] for index in indices)


def serve(options: CoordinatorOptions) -> None:
    """Run the coordinator until the run is finished or a signal comes.

    Raises:
        EndpointError: when nobody listens at the endpoint in time.
        UsageError: when the learner's configuration cannot be read.
        ProtocolError: when its answer is malformed.
    """
    stop = StopSignal()
    stop.install()
    with connect(options.endpoint, "control", stop, options.patience) as control:
        answer = fetch_configuration(control, options.run, options.name, lambda: not stop, 5.0)
        if answer is not None:
            config, team = read_saved(answer.toml), TeamSpec.from_dict(answer.team)
            Coordinator(options, config, team, control).run(stop)
