"""The learner process: experience in, gradient updates, parameters out, and the pace between them."""

import queue
import time
from pathlib import Path

import torch

from common.config import RunConfig
from common.config.files import to_toml
from common.errors import BusError, EiaSecError, ProtocolError, UsageError
from common.history import History
from common.imitation import ImitationSchedule
from common.process import Presence, StopSignal, connect, incarnation
from common.protocol import keys
from common.protocol.messages import (
    ChunkAck,
    ConfigurationMessage,
    Envelope,
    ImitationMessage,
    ParametersMessage,
    ProgressMessage,
    ReceiptMessage,
)
from common.team import TeamSpec
from common.transitions import FARM_METRICS
from common.transport.bus import Bus
from learner.checkpoint.recovery import recover_losses
from learner.checkpoint.storage import RunStorage
from learner.command_server import CommandServer
from learner.event_deadline import EventDeadline
from learner.intake.ledger import Intake
from learner.intake.receiver import Arrival, Receiver
from learner.options import LearnerOptions
from learner.reports import Curves, Journal, diverging, imitation_record
from learner.tensorboard import TensorBoardWriter, flattened
from learner.trainer import Trainer
from learner.warm_up import warm_up

HISTORY = Path("history", "learner.jsonl")
"""The learner's own account of chunks, in the run directory."""
BURST_UPDATES = 8
"""Updates between two polls for messages."""
PROGRESS_SECONDS = 0.1
REPORT_SECONDS = 1.0
HELD_SECONDS = 0.002
"""Pause between two looks at the mail while training waits for an imitation event."""
DRAIN_SECONDS = 3.0
"""Longest time for which a learner that ends takes in what workers still hold."""
QUIET_SECONDS = 0.5
"""Time without a chunk after which it takes them to hold nothing more."""
FAREWELL_SECONDS = 0.5
"""Time for the last messages to leave before the sessions close."""


class Learner:
    """The learner's loop; all its methods run in the main thread."""

    def __init__(self, options: LearnerOptions, config: RunConfig, team: TeamSpec, control: Bus, bulk: Bus) -> None:
        self._options, self._config, self._team = options, config, team
        warm_up(config, team)
        self.trainer = Trainer(config, self._team)
        self._absorbed = Intake()
        self._storage = RunStorage(options.run_dir, config)
        elapsed, before = self._storage.restore(self.trainer, self._absorbed) if options.resume else (0.0, 0)
        self._epoch = max(incarnation(), before + 1)
        self._history = History(options.run_dir / HISTORY if options.run_dir else None)
        recover_losses(self._history, self._absorbed, self._epoch, resumed=options.resume)
        self._schedule = ImitationSchedule.of(config)
        self._deadline = EventDeadline(self._schedule)
        self._tensorboard = TensorBoardWriter(options.run_dir)
        self._journal, self._curves = Journal(options.run_dir, elapsed), Curves(self._team, self.trainer.recent)
        if options.resume:
            self._log_resumption()
        self._state = "training"
        self._waited = {"data": 0.0, "imitation": 0.0, "producers": 0.0, "training": 0.0, "checkpoint": 0.0}
        self._lag = 0.0
        self._times = dict.fromkeys(("progress", "report", "publish", "checkpoint", "held"), time.monotonic())
        self._published_updates = -1
        self._open(control, bulk)

    def _log_resumption(self) -> None:
        """Say from where the run goes on: what an earlier start told beyond that did not come to stay."""
        counters = ("episodes", "environment_steps", "updates", "events")
        self._journal.write("resume", **{name: getattr(self.trainer, name) for name in counters})
        self._tensorboard.resume(self.trainer.environment_steps)

    def _open(self, control: Bus, bulk: Bus) -> None:
        run = self._options.run
        self._parameters = control.publish_state(keys.PARAMETERS.key(run))
        self._progress = control.publish_state(keys.PROGRESS.key(run))
        self._others = control.subscribe_state(keys.PROGRESS.key(run))
        told = ConfigurationMessage(self._epoch, to_toml(self._config), self._team.to_dict(), self._options.lockstep)
        self._commands = CommandServer(control.serve(keys.COMMAND.pattern(run), 64), told)
        self._imitations = control.serve(keys.IMITATION.key(run), 4)
        self._presence = Presence(control, run, "learner", "learner", self._epoch)
        intake = Intake()
        intake.restore(self._absorbed.state())
        server = bulk.serve(keys.TRANSITION.pattern(run), 256)
        lockstep, replay = self._options.lockstep, self._config.replay
        episode_metrics = FARM_METRICS if self._config.env.is_farm else ()
        self._receiver = Receiver(server, self._team, intake, replay, lockstep, self._history, episode_metrics)

    def run(self, stop: StopSignal) -> bool:
        """Train until the run's episodes are done, a signal comes or somebody asks to drain.

        Returns:
            Whether the run is finished.
        """
        self._publish()
        turn = self._lockstep_turn if self._options.lockstep else self._turn
        while not (stop or self._commands.draining or self._finished()):
            turn(stop)
            self._do_periodic_work()
        finished = self._finished()
        self._end("finished" if finished else "draining")
        return finished

    def join(self) -> None:
        """Wait for the receiving thread; the bulk lane must be closed."""
        self._receiver.join()

    def _finished(self) -> bool:
        return self.trainer.episodes >= self._config.episodes and self.trainer.updates_due() <= 0

    def _turn(self, stop: StopSignal) -> None:
        trainer = self.trainer
        while trainer.episodes < self._config.episodes and not (trainer.leads() or self._awaits_elite()):
            try:
                self._absorb(self._receiver.arrivals.get_nowait())
            except queue.Empty:
                break
        started = time.monotonic()
        updates = min(trainer.updates_due(), BURST_UPDATES)
        if updates > 0:
            trainer.train(updates)
            self._waited["training"] += time.monotonic() - started
        elif self._awaits_elite():
            time.sleep(HELD_SECONDS)
            self._waited["imitation"] += time.monotonic() - started
        elif (arrival := self._await_arrival()) is not None:
            self._absorb(arrival)

    def _awaits_elite(self) -> bool:
        trainer, expected = self.trainer, self._options.await_elite or self._commands.lease.holder is not None
        return self._deadline.holds(trainer.events, trainer.episodes, expected=expected, now=time.monotonic())

    def _await_arrival(self) -> Arrival | None:
        """Return the next chunk, or None after a short wait, which is counted."""
        started = time.monotonic()
        arrival = self._receiver.next_arrival(0.02)
        self._waited["data"] += time.monotonic() - started
        return arrival

    def _lockstep_turn(self, stop: StopSignal) -> None:
        arrival = self._await_arrival()
        if arrival is None:
            return
        self._absorb(arrival)
        started = time.monotonic()
        self.trainer.train(max(0, self.trainer.updates_due()))
        self._waited["training"] += time.monotonic() - started
        self._publish()
        while self._schedule.is_due(self.trainer.events, self.trainer.episodes) and not (
            stop or self._commands.draining
        ):
            started = time.monotonic()
            self._do_periodic_work()
            time.sleep(HELD_SECONDS)
            self._waited["imitation"] += time.monotonic() - started
        self._receiver.required_version = self.trainer.version
        self._settle(arrival)

    def _settle(self, arrival: Arrival) -> None:
        """Give the answer that is owed for a chunk, if one is."""
        if arrival.owed is not None:
            expected = arrival.workers[arrival.sender.name].expected
            arrival.owed.answer(ChunkAck(("accepted",), ("",), expected, self.trainer.version).encode())

    def _absorb(self, arrival: Arrival) -> None:
        trainer = self.trainer
        sender = arrival.sender
        trainer.absorb(arrival.chunk, sender.version, f"{sender.name}/{sender.incarnation}", sender.sequence)
        self._absorbed.closed, self._absorbed.workers = arrival.closed, arrival.workers
        self._lag += 0.05 * (trainer.version - arrival.sender.version - self._lag)
        if arrival.chunk.episodes:
            means = self._curves.add(arrival.chunk.episodes)
            counters = {"episodes": trainer.episodes, "environment_steps": trainer.environment_steps}
            self._journal.write("episodes", **counters, updates=trainer.updates, **means)

    def _do_periodic_work(self) -> None:
        now = time.monotonic()
        if not self._receiver.alive:
            raise BusError("the receiving thread has ended; no more chunks can come in.")
        if self.trainer.leads():
            self._waited["producers"] += now - self._times["held"]
        self._times["held"] = now
        self._stop_if_replaced()
        self._commands.answer()
        self._apply_imitations()
        if not self._options.lockstep and now - self._times["publish"] >= self._config.learner.publish_seconds:
            self._publish()
        if now - self._times["progress"] >= PROGRESS_SECONDS:
            self._publish_progress()
        if now - self._times["report"] >= REPORT_SECONDS:
            self._report()
        if now - self._times["checkpoint"] >= self._config.learner.checkpoint_seconds:
            self._checkpoint()

    def _stop_if_replaced(self) -> None:
        """End when a newer start of the learner tells of its progress: this one was taken for dead and replaced."""
        try:
            sample = self._others.poll()
            newer = sample is not None and ProgressMessage.decode(sample.payload).epoch > self._epoch
        except ProtocolError:
            return
        if newer:
            raise UsageError(f"a newer learner of run {self._options.run} has taken this one's place.")

    def _apply_imitations(self) -> None:
        for incoming in self._imitations.waiting():
            try:
                message = ImitationMessage.decode(incoming.payload)
                if message.epoch != self._epoch:
                    raise ProtocolError("the event is for another start of the learner.")
                sender = Envelope.decode(incoming.attachment)
                if not self._commands.lease.holds(sender.name, sender.incarnation):
                    raise ProtocolError("another coordinator leads.")
                event = message.to_event()
                applied = self.trainer.imitate(event)
            except ProtocolError as error:
                incoming.reply(ReceiptMessage(False, str(error)[:400]).encode())
                continue
            if applied:
                record = imitation_record(self._team, event)
                self._journal.write("imitation", episodes=self.trainer.episodes, **record)
                self._publish()
            incoming.reply(ReceiptMessage(True, "" if applied else "applied before").encode())

    def _publish(self) -> None:
        self._times["publish"] = time.monotonic()
        trainer = self.trainer
        marks = trainer.updates + trainer.events
        if marks == self._published_updates and not self._options.lockstep:
            return
        self._published_updates = marks
        version = trainer.next_version()
        actors = trainer.actors()
        message = ParametersMessage(
            epoch=self._epoch,
            version=version,
            event=trainer.events,
            environment_steps=trainer.environment_steps,
            progress=min(1.0, trainer.episodes / self._config.episodes),
            team=self._team.digest,
            hidden=actors.hidden,
            head=actors.head,
            flat=actors.flat,
        )
        self._parameters.put(message.encode())
        self._receiver.version = version
        self._publish_progress()

    def _publish_progress(self) -> None:
        self._times["progress"] = time.monotonic()
        t = self.trainer
        counters = (t.version, t.events, t.episodes, t.environment_steps, t.updates)
        self._progress.put(ProgressMessage(self._epoch, *counters, self._state).encode())

    def _report(self) -> None:
        self._times["report"] = time.monotonic()
        self._receiver.throttle.release()
        t = self.trainer
        ledger, ledgers = self._receiver.intake.accounts()
        values = {
            "state": self._state,
            "episodes": t.episodes,
            "episodes_total": self._config.episodes,
            "environment_steps": t.environment_steps,
            "updates": t.updates,
            "version": t.version,
            "event": t.events,
            "lag_versions": self._lag,
            **self._receiver.figures(),
            "malformed_commands": self._commands.malformed,
            "elapsed": self._journal.elapsed,
            "waits": dict(self._waited),
            "ledger": {**ledger, "unexplained": self._unexplained()},
            "ledgers": ledgers,
            "imitations": list(self._journal.imitations),
            "curves": self._curves.smoothed(),
            "statistics": t.statistics(),
            "evaluation_steps": t.evaluation_steps,
            "checkpoints": self._storage.statistics(),
            "alarms": self._alarms(),
        }
        self._presence.report(values, t.version)
        agents = t.diagnostics.by_agent()
        told = ("lag_versions", "queue", "curves", "statistics", "checkpoints", "waits", "ledger")
        self._tensorboard.write(
            t.environment_steps, flattened({name: values[name] for name in told} | {"agents": agents})
        )
        del values["alarms"], values["imitations"]
        self._journal.write("status", **values, agents=agents)

    def _alarms(self) -> list[str]:
        late = self._deadline.alarm(self.trainer.events, self.trainer.episodes, time.monotonic())
        written = (self._storage.alarm, self._journal.failure, self._tensorboard.failure, self._history.failure)
        found = (diverging(self.trainer.statistics()), *written, late)
        return [text for text in found if text] + self._receiver.peer_penalties.alarms()

    def _unexplained(self) -> int:
        """Return by how many steps the ledger fails to close, and misses replay and queue; anything but 0 is a defect.

        Both count as sizes, so that neither makes up for the other.
        """
        receiver = self._receiver
        with receiver.gate:
            accepted, unclosed = receiver.intake.totals()["accepted"], receiver.intake.unexplained()
            queued = sum(arrival.chunk.rows.steps for arrival in list(receiver.arrivals.queue))
        return abs(int(accepted - self.trainer.environment_steps - queued)) + unclosed

    def _checkpoint(self, *, wait: bool = False) -> None:
        started = time.monotonic()
        self._storage.save(self.trainer, self._absorbed, self._journal.elapsed, self._epoch, wait=wait)
        self._times["checkpoint"] = time.monotonic()
        self._waited["checkpoint"] += self._times["checkpoint"] - started

    def _absorb_remaining(self) -> None:
        """Absorb what workers still hold, who stop flying when they hear of it, until nothing comes any more."""
        started = quiet = time.monotonic()
        while (now := time.monotonic()) - started < DRAIN_SECONDS and now - quiet < QUIET_SECONDS:
            arrival = self._await_arrival()
            if arrival is not None:
                self._absorb(arrival)
                quiet = time.monotonic()
            self._stop_if_replaced()
            self._commands.answer()

    def _end(self, state: str) -> None:
        self._state = state
        self._publish_progress()
        if state == "draining" and not self._options.lockstep:
            self._absorb_remaining()
        self._receiver.close()
        while not self._receiver.arrivals.empty():
            self._absorb(arrival := self._receiver.arrivals.get_nowait())
            self._settle(arrival)
        self._publish()
        self._publish_progress()
        self._checkpoint(wait=True)
        missing = self._storage.write_policy(self.trainer)
        self._report()
        self._journal.write("end", state=state, episodes=self.trainer.episodes, digest=self.trainer.actors().digest())
        time.sleep(FAREWELL_SECONDS)
        self._commands.answer()
        self._journal.close()
        self._tensorboard.close()
        self._history.close()
        if missing:
            raise EiaSecError(missing)


def serve(options: LearnerOptions, config: RunConfig, team: TeamSpec) -> bool:
    """Run the learner until it is done; return whether the run is finished.

    Args:
        options: how to start.
        config: the run.
        team: the layout of the team of the run's environment.

    Raises:
        EndpointError: when the endpoint is taken, or the router does not answer.
        RunDirError: when the run directory belongs to another configuration.
    """
    torch.set_num_threads(config.learner.threads)
    stop = StopSignal()
    stop.install()

    def lane(name: str) -> Bus:
        if options.listen:
            return Bus.listen(options.endpoint, "bulk" if name == "bulk" else "control")
        return connect(options.endpoint, name, stop, options.patience)

    with lane("control") as control, lane("bulk") as bulk:
        learner = Learner(options, config, team, control, bulk)
        try:
            return learner.run(stop)
        finally:
            # A thread that is still inside Zenoh when the interpreter ends aborts the whole process.
            bulk.close()
            learner.join()
