"""The worker process: collects chunks with the newest actors and delivers them to the learner.

When something goes wrong:

- The spool is full, or the actors are too old: it waits (`CollectionGate`).
- Parameters come, or a new learner takes over: `LearnerLink`.
- The learner is gone: it collects until its spool is full, resends the oldest chunks until they are answered
  (`Sender`), and waits.
- The environment's simulator or robot is away: it waits until it is back (`Outages`).
- The environment does not return from a call: `Watchdog`.
- The run drains, or the worker should end: the chunk ends with the present step, and is delivered as it is.
- A newer start of the same worker delivers: it ends (`ReplacedError`).
"""

import math
import threading
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from eia_sec.common.actors import TeamActors
from eia_sec.common.clock import monotonic
from eia_sec.common.config.files import read_saved
from eia_sec.common.config.run import RunConfig
from eia_sec.common.errors import CancelledError, EiaSecError, EnvironmentFaultError, UsageError
from eia_sec.common.history.history import Drawing, End, History, Record, Start, Timeout
from eia_sec.common.incarnation import new_incarnation, seconds_ahead
from eia_sec.common.log import log
from eia_sec.common.loops import Loop, in_thread, run
from eia_sec.common.process import Presence, StopSignal, connect, denial, fetch_configuration
from eia_sec.common.protocol.chunk_rules import ChunkRules
from eia_sec.common.protocol.messages import ConfigurationMessage
from eia_sec.common.transitions import Chunk
from eia_sec.common.transport.bus import Bus
from eia_sec.common.transport.endpoint import Endpoint
from eia_sec.rollout.envs.base import Reach
from eia_sec.rollout.envs.watchdog import Watchdog, call_alarm
from eia_sec.rollout.remote.lease import COUNTS
from eia_sec.rollout.worker.collection_gate import CollectionGate
from eia_sec.rollout.worker.collector import Collector
from eia_sec.rollout.worker.evaluation_service import EvaluationService
from eia_sec.rollout.worker.learner_link import COLLECTING, LearnerLink
from eia_sec.rollout.worker.outages import Outages
from eia_sec.rollout.worker.sender import ANSWER_SECONDS, LOCKSTEP_ANSWER_SECONDS, UNDELIVERED, Sender
from eia_sec.rollout.worker.view_service import ViewService
from eia_sec.rollout.worker.warm_up import warm_up

REPORT_SECONDS = 1.0
DRAIN_SECONDS = 5.0
"""How long a worker evaluates and delivers after it has noticed that it should end."""
DELIVER_SECONDS = 2.0
"""How long it delivers at least, when an evaluation took all of that; a supervisor kills it after 8 s."""
IDLE_SECONDS = 0.002
POLL_SECONDS = 0.05
"""Time between two looks at the learner's and watchers' messages while a chunk is collected."""
UNTAKEN = 20
"""Requests in a row that nobody took before the worker checks whether it is denied."""
CLOCK_SECONDS = 5.0
"""Difference between the clocks of two starts that raises an alarm."""
DENIED_SECONDS = 10.0
"""Pause before the denial is logged again."""


class ReplacedError(UsageError):
    """A newer start of this worker has taken its place."""


@dataclass(frozen=True)
class WorkerOptions:
    """How to start one worker.

    Attributes:
        run: the run's name.
        name: the worker's name, unique in the run.
        endpoint: where the learner or a router listens.
        patience: seconds to wait for a listener there.
        env: the one environment besides the farm that this worker may load, or None. A configuration comes over the
            network, and loading an environment runs its code.
        history: file for the worker's record of its chunks, see `eia_sec.common.history.history`, or None.
    """

    run: str
    name: str
    endpoint: Endpoint
    patience: float = 60.0
    env: str | None = None
    history: Path | None = None


@dataclass
class _Times:
    collecting: float = 0.0
    waiting: float = 0.0
    paused: float = 0.0
    reported: float = field(default_factory=monotonic)
    polled: float = 0.0
    denied: float = 0.0
    ending: float = 0.0


class Worker:
    """One worker's loop; all its methods run in the main thread, but for `report` and the deliveries of `sender`.

    Args:
        options: how it was started.
        config: the run.
        answer: the learner's answer from which the configuration was read.
        control: the control lane.
        bulk: the lane for chunks.
        stop: ends the loop.
        presence: where it reports.
        collector: its environments.
        start: number of this start.
        outages: of its environments.

    Attributes:
        sender: its chunks; another thread runs `Sender.deliver`.
        history: what became of them.

    Raises:
        UsageError: the learner's team is another one than the environment has here.
    """

    def __init__(
        self,
        options: WorkerOptions,
        config: RunConfig,
        answer: ConfigurationMessage,
        control: Bus,
        bulk: Bus,
        stop: StopSignal,
        presence: Presence,
        collector: Collector,
        start: int,
        outages: Outages,
    ) -> None:
        name = options.name
        self._options, self._config, self._control, self._stop = options, config, control, stop
        self._clock_alarm, self._met = _clock_alarm(answer.newest_incarnation), answer.epoch
        self._collector, self._outages, self._presence = collector, outages, presence
        self._arguments = config.env.arguments
        self._whole = _why_whole(config, lockstep=answer.lockstep)
        team = collector.team
        if team.to_dict() != answer.team:
            raise UsageError(
                f"the learner of run {options.run} is for a different team than {config.env.name} has here."
            )
        self.history = History(options.history)
        self._timeouts = _timeouts(self.history)
        self.history.add(Start("rollout", name, start))
        patience = LOCKSTEP_ANSWER_SECONDS if answer.lockstep else ANSWER_SECONDS
        rules = ChunkRules.of(config, collector.environments.spec)
        self.sender = Sender(bulk, options.run, name, start, team, rules, patience, self.history)
        self._learner = LearnerLink(control, options.run, name, config, team)
        self._gate = CollectionGate(config.rollout, self._learner, self.sender, answer.lockstep)
        self._evaluations = EvaluationService(
            control, config, options.run, name, self._learner.store, self._late_for_evaluations
        )
        self._view_service = ViewService(
            control, options.run, name, start, collector, answer.toml, _silence(self.history.before), self.note_drawing
        )
        self._acting = (0, *self._exploration())
        self._times, self._reporting = _Times(), threading.Lock()
        log(f"worker {name} collects for run {options.run} in {config.rollout.environments} environments.")

    def run(self) -> Loop[None]:
        """Return the loop that collects until the run is finished or the stop signal comes.

        Raises:
            ReplacedError: a newer start of this worker has taken its place.
            UsageError: a new learner has another configuration.
        """
        while not self._stop and self._learner.state != "finished":
            yield from self._turn()
        left = max(DELIVER_SECONDS, self._seconds_left())
        yield from self.sender.wait_empty(left, self._serve_while_ending)
        if steps := self.sender.in_flight:
            unfinished = self.sender.left_behind
            why = f", {unfinished} of them because {self._whole}" if unfinished else ""
            log(f"worker {self._options.name}: {steps} steps {UNDELIVERED}{why}.")
        steps, state = self._collector.environment_steps, self._learner.state
        log(f"worker {self._options.name} ends after {steps} steps; the learner is {state}.")
        self._report()

    def _turn(self) -> Loop[None]:
        self._end_if_replaced()
        self._learner.poll()
        self.sender.resend_fast(self._learner.state == "draining")
        self._evaluations.poll()
        self._view_service.poll(*self._acting)
        actors = self._gate.actors()
        if actors is not None:
            self._collect(actors)
            yield 0.0
        else:
            yield from self._wait()
        self._report_if_due()

    def _serve_while_ending(self) -> None:
        """Go on with evaluations while the learner trains: one that waits for an imitation event takes no chunks."""
        if self._learner.state == "training":
            self._learner.poll()
            self._evaluations.poll()

    def _late_for_evaluations(self) -> bool:
        """Return whether a worker that ends has no time left for an evaluation."""
        return self._seconds_left() <= 0.0

    def _seconds_left(self) -> float:
        """Return how long a worker that ends goes on; without limit before it ends."""
        if not self._stop and self._learner.state != "finished":
            return math.inf
        now = monotonic()
        self._times.ending = self._times.ending or now
        return self._times.ending + DRAIN_SECONDS - now

    def _end_if_replaced(self) -> None:
        if self.sender.replaced:
            raise ReplacedError(f"worker {self._options.name} ends: a newer start of it delivers to the learner.")
        if self.history.taken_over:
            raise ReplacedError(f"worker {self._options.name} ends: another process writes {self._options.history}.")

    def _collect(self, actors: TeamActors) -> None:
        started, version = monotonic(), self._learner.store.version
        self._renew_arguments()
        self._acting = version, *self._exploration()
        try:
            chunk = self._collector.collect(actors, *self._acting[1:], goes_on=self._goes_on)
        except CancelledError as error:
            log(f"worker {self._options.name}: {error}")
        else:
            self.sender.flown = self._collector.environment_steps
            if self._is_deliverable(chunk):
                self.sender.offer(chunk, version)
            else:
                self.sender.leave_behind(chunk.rows.steps)
        self._times.collecting += monotonic() - started

    def _renew_arguments(self) -> None:
        """Hand arguments that the learner has published to the environments; they hold from the next episodes on."""
        wanted = self._learner.arguments or self._config.env.arguments
        if wanted != self._arguments:
            self._arguments = wanted
            self._collector.change_arguments(wanted)
            log(f"worker {self._options.name}: episodes begin with the arguments {wanted[:200]} from now on.")

    def _is_deliverable(self, chunk: Chunk) -> bool:
        """Return whether a chunk is whole, or may be shorter."""
        return not self._whole or chunk.rows.steps == self._collector.chunk_steps

    def _goes_on(self) -> bool:
        """Report, serve watchers, and return whether the chunk that is being collected should get another step.

        A chunk that may be shorter ends once it has the steps that the learner asks for, the learner drains, or the
        worker should end. Any other goes on until only the time is left that deliveries need.
        """
        self._report_if_due()
        due = monotonic() - self._times.polled >= POLL_SECONDS
        if due:
            self._times.polled = monotonic()
            self._view_service.poll(*self._acting)
        if self._whole:
            return self._seconds_left() > DELIVER_SECONDS
        if due:
            self._learner.poll()
        asked_for = self._collector.simulated - self._collector.environment_steps >= self._gate.asked_steps
        return not (asked_for or self._stop) and self._learner.state in COLLECTING

    def _exploration(self) -> tuple[float, bool]:
        """Return the noise's standard deviation, and whether actions are drawn uniformly instead (warm-up)."""
        return self._config.exploration_at(self._learner.store.progress, self._learner.store.environment_steps)

    def _wait(self) -> Loop[None]:
        began = monotonic()
        yield IDLE_SECONDS
        waited = monotonic() - began
        self._times.waiting += waited
        if self._gate.pause_reason:
            self._times.paused += waited

    def _report_if_due(self) -> None:
        if monotonic() - self._times.reported >= REPORT_SECONDS:
            self._report()

    def _report(self) -> None:
        self._log_denial()
        self.report()

    def report(self) -> None:
        """Publish the worker's metrics; any thread may call this."""
        with self._reporting:
            self._presence.report(self._metrics(), self._learner.store.version)
            self._times.reported = monotonic()

    def note_timeout(self) -> None:
        """Count that a call of the environment takes too long and ends this process; any thread may call this."""
        self.history.add(Timeout())
        self._timeouts += 1
        self.report()

    def note_drawing(self, drawing: bool) -> None:
        """Record that the environment begins or ceases to draw, because that may end this process without a word."""
        self.history.add(Drawing(drawing))

    def _metrics(self) -> dict[str, Any]:
        times, sender, learner = self._times, self.sender, self._learner
        return {
            "state": learner.state,
            "environment_steps": self._collector.simulated,
            "produced": self._collector.environment_steps,
            "accepted": sender.accepted,
            "rejected": sender.rejected,
            "in_flight": sender.in_flight,
            "left_behind": sender.left_behind,
            "retries": sender.retries,
            "spooled": sender.spooled,
            "simulating_seconds": times.collecting,
            "waiting_seconds": times.waiting,
            "evaluations": self._evaluations.episodes,
            "epoch": learner.store.epoch,
            "version": learner.store.version,
            "event": learner.store.event,
            "stale": learner.store.ignored,
            "missed": learner.missed,
            "malformed": learner.malformed,
            "watchers": self._view_service.watchers,
            "shown": self._view_service.shown,
            "skipped": self._view_service.skipped,
            "pictures": self._view_service.pictures,
            "no_pictures": self._view_service.silence,
            "paused": self._gate.pause_reason,
            "paused_seconds": times.paused,
            "outages": self._outages.count,
            "steps_resent": COUNTS.resent,
            "answers_refused": COUNTS.refused,
            "step_timeouts": self._timeouts,
            "alarms": self._alarms(),
        }

    def _alarms(self) -> list[str]:
        own = (
            self.history.failure,
            self._gate.pause_reason,
            # Another learner has a clock of its own.
            self._clock_alarm if self._learner.epoch in (0, self._met) else "",
            self._learner.alarm,
            self._collector.alarm,
        )
        found = (*own, self._outages.alarm, call_alarm())
        return [text for text in found if text]

    def _log_denial(self) -> None:
        """Log why nobody takes the worker's requests, when its certificate is not let in."""
        times, run = self._times, self._options.run
        if self.sender.untaken >= UNTAKEN and times.reported >= times.denied + DENIED_SECONDS:
            times.denied = times.reported
            if (sentence := denial(self._control, run, self.sender.key)) is not None:
                log(f"worker {self._options.name}: {sentence}")


def _why_whole(config: RunConfig, *, lockstep: bool) -> str:
    """Return why a run takes no chunk that ended early, or an empty text."""
    if lockstep:
        return "a lockstep run repeats whole chunks"
    return "networks with memory learn from chunks of equal length" if config.memory_size else ""


def _timeouts(history: History) -> int:
    """Return how many earlier starts were ended because of `env.step_timeout`."""
    return sum(isinstance(record, Timeout) for record in history.before)


def _silence(before: Sequence[Record]) -> str:
    """Return why no pictures are to be drawn: an earlier start drew some when it ended without a word; or nothing."""
    drawing = False
    for record in before:
        match record:
            case Drawing(begins):
                drawing = begins
            case End():
                drawing = False
            case Start() if drawing:
                break
    return "an earlier start of this worker ended without a word while it drew pictures" if drawing else ""


def _clock_alarm(newest_incarnation: int) -> str:
    ahead = seconds_ahead(newest_incarnation)
    if ahead < CLOCK_SECONDS:
        return ""
    return (
        f"the clock of this machine is {ahead:.0f} s behind that of the learner or of an earlier start of this "
        "worker; one of them is wrong"
    )


def serve(options: WorkerOptions) -> None:
    """Run one worker until the run is finished or a signal comes.

    Raises:
        EndpointError: nothing listens at the endpoint in time.
        ReplacedError: a newer start of this worker has taken its place.
        UsageError: the learner's configuration cannot be read, changed with a new learner, or names an environment that
            this worker may not load or that has another team here.
    """
    stop = StopSignal()
    stop.install()
    if options.env is None:
        warm_up()
        if stop:
            return
    with connect(options.endpoint, "control", stop, options.patience) as control:
        answer = run(fetch_configuration(control, options.run, options.name, lambda: not stop, 5.0))
        if answer is None:
            return
        try:
            config = read_saved(answer.toml)
        except UsageError as error:
            raise UsageError(f"the learner of run {options.run} sent a configuration that fails: {error}") from error
        if config.env.is_third_party and config.env.name != options.env:
            raise UsageError(
                f"run {options.run} uses {config.env.name}; a worker loads it only if started with "
                f"--env {config.env.name}."
            )
        with connect(options.endpoint, "bulk", stop, options.patience) as bulk:
            _work(options, config, answer, control, bulk, stop)


def _work(
    options: WorkerOptions,
    config: RunConfig,
    answer: ConfigurationMessage,
    control: Bus,
    bulk: Bus,
    stop: StopSignal,
) -> None:
    """Make the environments, work, and close them, and report all the while."""
    start, name = new_incarnation(answer.newest_incarnation), options.name
    before = _timeouts(History(options.history))
    presence, outages = Presence(control, options.run, "rollout", name, start), Outages(stop.event)

    reach = Reach(control, f"{options.run}/{name}")

    def report() -> None:
        alarms = [text for text in (outages.alarm, call_alarm()) if text]
        values = {"outages": outages.count, "step_timeouts": before, "alarms": alarms}
        presence.report({"state": "starting", **values})

    def timed_out() -> None:
        History(options.history).add(Timeout())

    report()
    try:
        with (
            closing(Watchdog(config.env.step_timeout, report, lambda: bool(stop), timed_out)) as watchdog,
            closing(Collector(config, name, 0 if answer.lockstep else start, outages, reach)) as collector,
        ):
            worker = Worker(options, config, answer, control, bulk, stop, presence, collector, start, outages)
            watchdog.speak, watchdog.timed_out = worker.report, worker.note_timeout
            deliveries = in_thread("sender", worker.sender.deliver(), worker.sender.offered)
            try:
                run(worker.run())
            finally:
                worker.sender.close()
                deliveries.join(5.0)
                worker.history.close()
    except EnvironmentFaultError as error:
        # No mistake of whoever started it: another start may do better.
        raise EiaSecError(str(error)) from error
