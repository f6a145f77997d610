"""The elite coordinator: when an event is due, it has workers evaluate the actors and announces the elites."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from eia_sec.common.clock import monotonic
from eia_sec.common.config.files import read_saved
from eia_sec.common.config.run import RunConfig
from eia_sec.common.errors import BusClosedError, BusError, ProtocolError
from eia_sec.common.imitation import LEASE_SECONDS, ImitationEvent, ImitationSchedule
from eia_sec.common.incarnation import new_incarnation
from eia_sec.common.log import log
from eia_sec.common.loops import Loop, Running, run
from eia_sec.common.process import Presence, StopSignal, connect, denial, fetch_configuration
from eia_sec.common.protocol import keys
from eia_sec.common.protocol.epoch_fence import EpochFence
from eia_sec.common.protocol.keys import KeyFamily
from eia_sec.common.protocol.messages import (
    CommandMessage,
    Envelope,
    EvaluationOrder,
    ImitationMessage,
    ParametersMessage,
    ProgressMessage,
    ReceiptMessage,
)
from eia_sec.common.reward_sums import RewardSums
from eia_sec.common.team import Float32, TeamSpec
from eia_sec.common.transport.bus import Bus
from eia_sec.common.transport.endpoint import Endpoint
from eia_sec.elite.evaluation_plan import Plan, evaluation_plan
from eia_sec.elite.evaluations import Order, flown
from eia_sec.elite.noise_free import NoiseFreeReward
from eia_sec.elite.scoring import decide, scores

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
APPLIED_SECONDS = 5.0
"""Time for which the learner's progress may not yet show an event that it was asked to apply."""
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
        self._parts = config.imitates and config.learns_on_policy and config.on_policy.shared_until < 1.0
        self._progress = control.subscribe_state(keys.PROGRESS.key(options.run))
        self._tokens = control.watch(keys.LIVE.pattern(options.run, role="rollout"), 1024)
        self._announcer = control.publish_state(keys.IMITATION_EVENT.key(options.run), keys.IMITATION_EVENT.encoding)
        start = new_incarnation()
        self._presence = Presence(control, options.run, "elite", options.name, start)
        self._envelope = Envelope("elite", options.name, start, 1).encode()
        self._leads, self._claimed, self._granted = False, -CLAIM_SECONDS, -LEASE_SECONDS
        self._claiming: Running[bytes | None] | None = None
        self._workers: set[str] = set()
        self._now: ProgressMessage | None = None
        self._rewards = RewardSums.none(team.agents)
        self._fence = EpochFence()
        self._last: ImitationEvent | None = None
        self._failures = self._malformed = self._rounds_missed = 0
        self._missed = ""
        self._patience = ANSWER_SECONDS
        self._reported = 0.0
        self._noise_free = NoiseFreeReward(config, team, control, options.run)

    @property
    def now(self) -> ProgressMessage | None:
        """The learner's newest progress; None before the first."""
        return self._now

    @property
    def can_evaluate(self) -> bool:
        """Whether it leads a learner that trains, and knows workers that can evaluate its actors."""
        return self._leads and bool(self._workers) and self._now is not None and self._now.state == "training"

    def note_missed(self, reason: str) -> None:
        """Count a round of its population that was held without the learner, and raise an alarm.

        Args:
            reason: a sentence without its end.
        """
        self._rounds_missed, self._missed = self._rounds_missed + 1, reason

    def run(self, stop: StopSignal) -> Loop[None]:
        """Return the loop that coordinates until a stop signal comes or the run is finished."""
        while not stop:
            yield from self._pause()
            now = self._now
            if now is not None and now.state == "finished":
                break
            if now is None or now.state != "training" or not self._leads:
                continue
            if self._schedule.after(now.separate_since).is_due(now.events, now.episodes):
                yield from self._hold_event(now, stop)
            elif self._workers:
                self._noise_free.begin(min(self._workers), now)
        log(f"coordinator {self._options.name} ends.")
        self._report()

    def _pause(self, seconds: float = IDLE_SECONDS) -> Loop[None]:
        """Wait; meanwhile listen, renew the claim to the lead, and report."""
        end = monotonic() + seconds
        while True:
            yield IDLE_SECONDS
            self._listen()
            self._claim()
            self._noise_free.step()
            if monotonic() - self._reported >= REPORT_SECONDS:
                self._report()
            if monotonic() >= end:
                return

    def _claim(self) -> None:
        """Claim the lead from the learner, or renew the claim, every CLAIM_SECONDS; a busy learner answers late."""
        if self._claiming is None and monotonic() - self._claimed >= CLAIM_SECONDS:
            key, payload = keys.COMMAND.key(self._options.run, verb="lead"), CommandMessage(self._options.name).encode()
            self._claimed = monotonic()
            self._claiming = Running(self._bus.asking(key, payload, LEASE_SECONDS, self._envelope))
        try:
            if self._claiming is not None and self._claiming.step():
                answer, self._claiming = self._claiming.result, None
                if answer is not None:
                    self._granted = self._claimed if ReceiptMessage.decode(answer).done else -LEASE_SECONDS
        except BusClosedError:
            raise
        except (BusError, ProtocolError) as error:
            log(f"coordinator: the learner does not grant the lead: {error}")
            self._claiming, self._granted = None, -LEASE_SECONDS
        leads = monotonic() - self._granted < LEASE_SECONDS
        if leads != self._leads:
            log(f"coordinator {self._options.name} {'leads' if leads else 'stands by'}.")
        self._leads = leads

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
                rewards = RewardSums.checked(message.reward_steps, message.reward_sums, self._team.agents)
            except ProtocolError as error:
                self._malformed += 1
                log(f"coordinator: dropped a message: {error}")
                return
            if self._fence.admits(message.epoch, 0 if self._now is None else self._now.epoch):
                self._now, self._rewards = message, rewards

    def _hold_event(self, now: ProgressMessage, stop: StopSignal) -> Loop[None]:
        number = now.events + 1
        due = self._schedule.after(now.separate_since).due_episode(number)
        rewards, version, evaluation_steps = self._rewards, now.version, 0
        if self._config.elite.farms:
            found = yield from self.evaluate(number, evaluation_plan(self._config, number), now, stop)
            if found is None:
                return
            rewards, version, evaluation_steps = found
        if due is None or not rewards.steps:
            return
        event = decide(self._team, self._config.elite, number, version, due, rewards, evaluation_steps)
        message = ImitationMessage.of(event, now.epoch)
        if (yield from self.deliver(keys.IMITATION, message.encode(), f"event {number}", stop)):
            self._announcer.put(message.encode())
            self._last = event
            elites = ", ".join(f"{g.name} {e}" for g, e in zip(self._team.groups, event.elites, strict=True))
            log(f"coordinator: event {number} is applied with rate {event.rate:.3g}; elites: {elites}.")
        deadline = monotonic() + APPLIED_SECONDS
        while not stop and self._leads and monotonic() < deadline and self._now is not None:
            if self._now.events >= number:
                return
            yield from self._pause()

    def deliver(self, family: KeyFamily, payload: bytes, what: str, stop: StopSignal) -> Loop[bool]:
        """Ask the learner to apply an event or a round; return whether it applied exactly this one.

        Only then may an event be announced. An event of this number that the learner had already applied may be a
        different one: if its answer to an earlier delivery was lost, a new evaluation may have chosen other elites.
        A learner on policy answers between two iterations, and the lead must not be lost meanwhile.

        Args:
            family: the keys on which the learner takes it.
            payload: the message's frame.
            what: what it is, for the log.
            stop: ends the wait.
        """
        key = family.key(self._options.run)
        asked = Running(self._bus.asking(key, payload, DELIVER_SECONDS, self._envelope))
        try:
            while not asked.step():
                if stop:
                    log(f"{what} was given up, because this process ends.")
                    return False
                yield from self._pause()
            answer = asked.result
            receipt = None if answer is None else ReceiptMessage.decode(answer)
            if answer is None:
                log(denial(self._bus, self._options.run, key) or f"coordinator: {what} got no answer.")
        except BusClosedError:
            raise
        except (BusError, ProtocolError) as error:
            log(f"coordinator: {what}: {error}")
            return False
        if receipt is not None and not receipt.done:
            log(f"coordinator: the learner refused {what}: {receipt.reason}")
        return receipt is not None and receipt.done and not receipt.reason

    def evaluate(
        self,
        event: int,
        plan: Plan,
        now: ProgressMessage,
        stop: StopSignal,
        actors: ParametersMessage | None = None,
    ) -> Loop[tuple[RewardSums, int, int] | None]:
        """Return the rewards of noise-free episodes, the oldest version evaluated and the steps; None if abandoned.

        Args:
            event: number of what needs them.
            plan: the episodes.
            now: the learner's progress; once its epoch is another one, the evaluation is abandoned.
            stop: ends the wait.
            actors: those that all workers evaluate; None for the newest that each of them has.
        """
        version, flat = (now.version, None) if actors is None else (actors.version, actors.flat)
        farms, _ = plan
        found: dict[int, Float32] = {}
        versions: list[int] = []
        silent: set[str] = set()
        while len(found) < len(farms):
            if stop or not self._workers or (self._now is not None and self._now.epoch != now.epoch):
                return None
            workers = sorted(self._workers - silent) or sorted(self._workers)
            missing = [index for index in range(len(farms)) if index not in found]
            shares = [missing[k :: len(workers)] for k in range(len(workers))]
            orders = [
                Order(worker, share, EvaluationOrder(now.epoch, event, version, *_picked(share, *plan), flat=flat))
                for worker, share in zip(workers, shares, strict=True)
                if share
            ]
            started = monotonic()
            answers = yield from self._ask_all(orders, versions, stop)
            found.update(answers)
            late = [order.worker for order in orders if order.share[0] not in answers]
            waited = monotonic() - started
            if late and not stop:
                yield from self._note_late(event, late, silent, len(orders), waited)
            elif not late:
                self._patience = min(self._patience, max(ANSWER_SECONDS, 2.0 * waited))
        steps = np.concatenate([found[index] for index in range(len(farms))])
        return RewardSums.of(steps, len(steps)), min(versions), len(steps)

    def _note_late(self, event: int, late: Sequence[str], silent: set[str], asked: int, waited: float) -> Loop[None]:
        """Exclude workers that did not answer from the next attempts; if nobody answered, lengthen the time limit."""
        self._failures += len(late)
        log(f"coordinator: event {event}: no evaluation after {waited:.1f} s from {', '.join(late)}; trying again.")
        silent.update(late)
        if len(late) == asked:
            silent.clear()
            if waited >= self._patience:
                self._patience = min(2.0 * self._patience, LONGEST_SECONDS)
            else:
                yield from self._pause(RETRY_SECONDS)

    def _ask_all(self, orders: Sequence[Order], versions: list[int], stop: StopSignal) -> Loop[dict[int, Float32]]:
        """Send the orders, and return the rewards of those that were answered in time, by the episode's index."""
        answers: dict[int, Float32] = {}
        bus, run, team = self._bus, self._options.run, self._team
        asked = [(order, Running(flown(bus, run, team, order, self._patience))) for order in orders]
        while asked and not stop:
            yield from self._pause()
            for order, running in list(asked):
                if running.step():
                    asked.remove((order, running))
                    if (result := running.result) is not None:
                        versions.append(result.version)
                        lengths = zip(order.share, result.reward, result.steps.tolist(), strict=True)
                        answers.update({index: reward[:steps] for index, reward, steps in lengths})
        return {} if stop else answers

    def _report(self) -> None:
        self._reported = monotonic()
        names = self._team.types
        found = scores(self._team, self._rewards, self._config.elite) if self._rewards.steps else []
        values = {
            "workers": sorted(self._workers),
            "events": 0 if self._now is None else self._now.events,
            "next_episode": self._next_episode(),
            "failures": self._failures,
            "malformed": self._malformed,
            "leads": self._leads,
            "shared": self._parts and self._now is not None and self._now.separate_since is None,
            "rate": self._last.rate if self._last else 0.0,
            "elites": {name: int(np.argmax(omega)) for name, omega in zip(names, found, strict=False)},
            "scores": {name: omega.tolist() for name, omega in zip(names, found, strict=False)},
            **self._noise_free.report(),
            "rounds_missed": self._rounds_missed,
            "alarms": self._alarms(),
        }
        self._presence.report(values, 0 if self._now is None else self._now.version)

    def _alarms(self) -> list[str]:
        missed = f"rounds of its population that it missed: {self._rounds_missed}; the last one: {self._missed}."
        return [*([self._fence.alarm] if self._fence.alarm else []), *([missed] if self._rounds_missed else [])]

    def _next_episode(self) -> int:
        """Return the episode at which the next event falls due; 0 where none does, or while agents share actors."""
        now = self._now
        return 0 if now is None else self._schedule.after(now.separate_since).due_episode(now.events + 1) or 0


def _picked(indices: Sequence[int], farms: Sequence[int], episodes: Sequence[int]) -> Plan:
    return tuple(farms[index] for index in indices), tuple(episodes[index] for index in indices)


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
        answer = run(fetch_configuration(control, options.run, options.name, lambda: not stop, 5.0))
        if answer is not None:
            config, team = read_saved(answer.toml), TeamSpec.from_dict(answer.team)
            run(Coordinator(options, config, team, control).run(stop))
