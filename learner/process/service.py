"""The learner process: takes in experience, updates, publishes parameters, reports and writes checkpoints."""

from collections.abc import Mapping
from pathlib import Path
from typing import Final

import torch

from eia_sec.common import plugins
from eia_sec.common.clock import monotonic
from eia_sec.common.config import RunConfig
from eia_sec.common.config.files import to_toml
from eia_sec.common.environment import EnvironmentSpec
from eia_sec.common.errors import BusError, DivergenceError, EiaSecError, SchemaError, UsageError
from eia_sec.common.history.history import History
from eia_sec.common.imitation import ImitationEvent, ImitationSchedule
from eia_sec.common.incarnation import new_incarnation
from eia_sec.common.log import log
from eia_sec.common.loops import Loop, in_thread, run
from eia_sec.common.policy_file import UNTRAINED
from eia_sec.common.population import Exploit
from eia_sec.common.process import Presence, StopSignal, connect
from eia_sec.common.protocol import keys
from eia_sec.common.protocol.chunk_rules import ChunkRules
from eia_sec.common.protocol.codec import NO_LIMIT
from eia_sec.common.protocol.messages import ConfigurationMessage
from eia_sec.common.team import TeamSpec
from eia_sec.common.transport.admission import AdmissionSource
from eia_sec.common.transport.bus import Bus
from eia_sec.learner.checkpoint.compaction import HistoryCompaction
from eia_sec.learner.checkpoint.recovery import last_epoch, recover_losses
from eia_sec.learner.checkpoint.storage import RunStorage
from eia_sec.learner.group.process_group import Order, ProcessGroup
from eia_sec.learner.intake.arrival import Arrival
from eia_sec.learner.intake.feed import ExperienceFeed
from eia_sec.learner.intake.ledger import Ledger
from eia_sec.learner.intake.limits import IntakeLimits
from eia_sec.learner.intake.receiver import Receiver
from eia_sec.learner.process.command_server import CommandServer
from eia_sec.learner.process.epoch import SuccessorWatch
from eia_sec.learner.process.imitation_server import ImitationServer
from eia_sec.learner.process.membership import Membership
from eia_sec.learner.process.options import LearnerOptions
from eia_sec.learner.process.parameter_publisher import ParameterPublisher
from eia_sec.learner.process.phase_times import PhaseTimes
from eia_sec.learner.process.plugin_callbacks import PluginCallbacks
from eia_sec.learner.process.population_server import PopulationServer
from eia_sec.learner.process.reporter import Reporter
from eia_sec.learner.process.schedule import Schedule
from eia_sec.learner.process.warm_up import warm_up
from eia_sec.learner.trainers import make_trainer

HISTORY: Final = Path("history", "learner.jsonl")
"""Path of the learner's history of chunks in the run directory."""
DATA_SECONDS: Final = 0.02
"""Longest wait for a chunk before the learner polls for other messages."""
IMITATION_SECONDS: Final = 0.002
"""Pause between two polls for messages while training waits for an imitation event."""
FAREWELL_SECONDS: Final = 0.5
"""Time for the last messages to be sent before the sessions close."""


class Learner:
    """The learner's loop; call all methods from the main thread.

    Args:
        options: how to start.
        config: the run.
        environment: the run's environment.
        control: the control lane.
        bulk: the bulk lane, on which chunks arrive.
        group: the learners that make the updates together (on policy), which this one leads; None for this one alone.

    Attributes:
        trainer: networks, replay and counters.
        receiver: where chunks arrive; another thread runs `Receiver.receive`.
    """

    def __init__(
        self,
        options: LearnerOptions,
        config: RunConfig,
        environment: EnvironmentSpec,
        control: Bus,
        bulk: Bus,
        group: ProcessGroup | None = None,
    ) -> None:
        self._options, self._config, self._group, team = options, config, group, environment.team
        warm_up(config, team)
        self.trainer = make_trainer(config, team, group)
        self._storage = RunStorage(options.run_dir, config)
        ledger, elapsed = self._restore()
        self._compaction = HistoryCompaction(self._history, config.learner.keep_checkpoints)
        self._schedule = Schedule(config, await_elite=options.await_elite)
        self._times, self._state = PhaseTimes(), "training"
        self._window = NO_LIMIT
        self._open_control(config, team, control, ledger)
        self._commands.arguments = self._storage.arguments
        presence = Presence(control, options.run, "learner", "learner", self._epoch)
        self._reporter = Reporter(options.run_dir, environment, self.trainer, presence, elapsed)
        self._open_bulk(config, environment, bulk, ledger)
        self._reporter.add(self._feed.metrics, self._feed.alarms)
        self._reporter.add(lambda: {"malformed_commands": self._commands.malformed})
        self._reporter.add(lambda: {"arguments": self._commands.arguments})
        self._reporter.add(self._imitations.metrics, self._imitations.alarms)
        self._reporter.add(self._population.metrics, self._population.alarms)
        self._reporter.add(lambda: {"waits": self._times.seconds()})
        self._reporter.add(lambda: {"group": _group_metrics(group)})
        self._reporter.add(lambda: {"checkpoints": self._storage.statistics()}, self._storage.alarms)
        self._reporter.add(alarms=lambda: [self._history.failure])
        if options.listen:
            crowding = AdmissionSource(options.endpoint)
            self._reporter.add(crowding.metrics, crowding.alarms)
        self._reporter.add(alarms=lambda: [self._schedule.event_alarm(self.trainer, monotonic())])
        self._callbacks = PluginCallbacks(
            config, plugins.callbacks(config.plugins), self.trainer, self._reporter, self._commands
        )
        self._reporter.add(lambda: {"stopped": self._callbacks.reason})
        self._log_begin()

    def _log_begin(self) -> None:
        trainer = self.trainer
        if self._options.resume:
            self._reporter.log_resume()
        resumed = self._options.resume and trainer.environment_steps > 0
        how = "resumed from a checkpoint" if resumed else "begun"
        counts = f"{trainer.episodes} episodes, {trainer.environment_steps} steps, {trainer.updates} updates"
        log(f"run {self._options.run} is {how}: {counts}.")

    def _restore(self) -> tuple[Ledger, float]:
        """Resume from the newest checkpoint if requested; return the ledger and the seconds that the run has taken."""
        ledger, resume, directory = Ledger(), self._options.resume, self._options.run_dir
        elapsed, epoch = self._storage.restore(self.trainer, ledger) if resume else (0.0, 0)
        if not epoch:
            if start := self._options.start():
                self.trainer.begin_with(start)
            self._storage.write_policy(self.trainer, UNTRAINED)
        self._history = History(directory / HISTORY if directory else None)
        self._epoch = new_incarnation(max(epoch, last_epoch(self._history.before)))
        recover_losses(self._history, ledger, self._epoch, resumed=resume)
        return ledger, elapsed

    def _open_control(self, config: RunConfig, team: TeamSpec, control: Bus, ledger: Ledger) -> None:
        run, lockstep = self._options.run, self._options.lockstep
        self._publisher = ParameterPublisher(control, run, self._epoch, self.trainer)
        self._successor = SuccessorWatch(control, run, self._epoch)
        configuration = ConfigurationMessage(self._epoch, to_toml(config), team.to_dict(), lockstep)
        commands = control.serve(keys.COMMAND.pattern(run), 64)
        self._membership = Membership(control, run)
        self._commands = CommandServer(commands, configuration, ledger.newest_incarnation)
        server = control.serve(keys.IMITATION.key(run), 4)
        self._imitations = ImitationServer(
            server, self.trainer, ImitationSchedule.of(config), self._commands.lease, self._epoch, self._on_imitation
        )
        rounds = control.serve(keys.POPULATION.key(run), 4)
        self._population = PopulationServer(rounds, self.trainer, self._commands.lease, self._epoch, self._on_exploit)

    def _open_bulk(self, config: RunConfig, environment: EnvironmentSpec, bulk: Bus, ledger: Ledger) -> None:
        server = bulk.serve(keys.TRANSITION.pattern(self._options.run), 256)
        absorbed = ledger.now()
        rules, lockstep, version = ChunkRules.of(config, environment), self._options.lockstep, self.trainer.version
        team, limits = environment.team, IntakeLimits.of(config)
        resumed = self._options.resume
        self.receiver = Receiver(server, team, rules, ledger, limits, lockstep, self._history, version, resumed=resumed)
        self._open_iteration()
        self._feed = ExperienceFeed(self.receiver, self.trainer, absorbed, self._absorb)

    def run(self, stop: StopSignal) -> Loop[bool]:
        """Return the loop that trains until the run's episodes are done, a signal arrives or a command asks to drain.

        It returns whether the run is finished.
        """
        self._publish()
        step = self._lockstep_step if self._options.lockstep else self._step
        while not (stop or self._commands.draining or self._schedule.finished(self.trainer)):
            yield from step(stop)
            self._do_what_is_due()
        finished = self._schedule.finished(self.trainer)
        yield from self._end("finished" if finished else "draining")
        return finished

    def _step(self, stop: StopSignal) -> Loop[None]:
        """Take in what has arrived, then update; wait for experience or an imitation event if neither is possible."""
        self._feed.absorb_waiting(lambda: self._schedule.takes_in(self.trainer, awaits_event=self._awaits_event()))
        self._open_iteration()
        updates = self._schedule.updates(self.trainer)
        if updates > 0:
            self._train(updates)
            yield 0.0
        elif self._awaits_event():
            yield from self._wait_for_imitation()
        else:
            with self._times.measure("data"):
                yield from self._feed.absorb_next(DATA_SECONDS)

    def _lockstep_step(self, stop: StopSignal) -> Loop[None]:
        """Take in one chunk, do all updates that it allows, publish, wait for due imitation events, acknowledge."""
        with self._times.measure("data"):
            arrival = yield from self._feed.absorb_next(DATA_SECONDS)
        if arrival is None:
            return
        self._open_iteration()
        self._train(max(0, self.trainer.updates_due()))
        self._publish()
        while self._schedule.event_due(self.trainer) and not (stop or self._commands.draining):
            self._do_what_is_due()
            yield from self._wait_for_imitation()
        self.receiver.require_version(self.trainer.version)
        self._feed.answer(arrival)

    def _absorb(self, arrival: Arrival) -> None:
        """Put an accepted chunk into the trainer."""
        chunk, sender = arrival.chunk, arrival.sender
        self.trainer.absorb(chunk, sender.version, f"{sender.name}/{sender.incarnation}", sender.sequence)
        if chunk.episodes:
            self._reporter.log_episodes(chunk.episodes)

    def _open_iteration(self) -> None:
        """Let the receiver take in chunks for the iteration that they will be learned from in."""
        if (wanted := self.trainer.iteration) is not None:
            self.receiver.room.open(*wanted, updating=self.trainer.updates_due() > 0)

    def _train(self, updates: int) -> None:
        before = self.trainer.updates
        with self._times.measure("training"):
            self.trainer.train(updates)
        if not before and self.trainer.updates:
            log(f"the first update was made after {self.trainer.environment_steps} steps.")

    def _awaits_event(self) -> bool:
        if not (self._config.elite.farms or self.trainer.rewards.steps):
            return False  # the agents have earned nothing yet by which they could be scored
        has_coordinator = self._commands.lease.holder is not None
        return self._schedule.awaits_event(self.trainer, has_coordinator=has_coordinator, now=monotonic())

    def _wait_for_imitation(self) -> Loop[None]:
        with self._times.measure("imitation"):
            yield IMITATION_SECONDS

    def _do_what_is_due(self) -> None:
        self._serve_requests()
        now, schedule = monotonic(), self._schedule
        if (schedule.publish_timer.due(now) or self.trainer.publishes_at_once) and not self._options.lockstep:
            self._publish()
        if schedule.progress_timer.due(now) or self.receiver.room.terms.window > self._window:
            self._publish_progress()
        if schedule.report_timer.due(now):
            self._report()
        if schedule.checkpoint_timer.due(now):
            self._checkpoint()

    def _serve_requests(self) -> None:
        """Answer commands and imitation events, and check that this learner may go on."""
        if self.receiver.failed:
            raise BusError("the receiving thread has failed; no more chunks can be received.")
        if self.receiver.repeats:
            raise UsageError(
                "the worker of this lockstep run has been restarted, and would repeat its first episodes; "
                "begin the run again in another folder."
            )
        self._times.lap(producers_wait=self.trainer.leads())
        self._stop_if_replaced()
        self._commands.answer()
        if self.trainer.between_iterations:
            self._imitations.answer()
            self._population.answer()

    def _stop_if_replaced(self) -> None:
        if self._successor.replaced():
            raise UsageError(f"a newer learner of run {self._options.run} has taken this one's place.")

    def _on_imitation(self, event: ImitationEvent) -> None:
        self._reporter.log_imitation(event)
        self._publish(imitated=self._publisher.unpublished == 1)

    def _on_exploit(self, event: Exploit, before: Mapping[str, float]) -> None:
        self._reporter.log_exploit(event, before)
        self._publish(imitated=self._publisher.unpublished == 1)
        self._checkpoint(wait=True)  # a learner that is killed after its answer goes on with what it has taken over

    def _publish(self, *, imitated: bool = False) -> None:
        self._schedule.publish_timer.restart(monotonic())
        every_turn = self._options.lockstep and not self.trainer.publishes_at_once
        if self._publisher.unpublished or every_turn:
            updating = self.trainer.iteration is not None and self.trainer.updates_due() > 0
            # Before any worker can fly with it.
            version = self.trainer.next_version()
            self.receiver.room.set_version(version, updating=updating, imitated=imitated)
            try:
                self._publisher.publish_parameters(self.trainer.actors())
            except SchemaError as error:
                raise self._diverged(error) from error
            self._publish_progress()

    def _diverged(self, error: SchemaError) -> DivergenceError:
        newest = self._storage.newest()
        kept = "no checkpoint was written before" if newest is None else f"the newest checkpoint, {newest}, is finite"
        return DivergenceError(
            f"the training has diverged after {self.trainer.updates} updates: {error} {kept[0].upper()}{kept[1:]}. "
            "Lower the learning rates and begin again."
        )

    def _publish_progress(self) -> None:
        self._schedule.progress_timer.restart(monotonic())
        self._membership.update()
        self.receiver.room.present = self._membership.workers
        terms = self.receiver.room.terms
        self._window = terms.window
        self._publisher.publish_progress(self._state, terms, self._commands.arguments)

    def _report(self) -> None:
        self._schedule.report_timer.restart(monotonic())
        if self._group is not None and self._state == "training":  # afterwards nothing more is learned
            self._group.order(Order.NOTHING)
        self._storage.require_same_directory()
        self.receiver.throttle.release()
        self._reporter.report(self._state)
        if self._state == "training":
            self._callbacks.look()

    def _checkpoint(self, *, wait: bool = False) -> None:
        with self._times.measure("checkpoint"):
            ledger, elapsed = self._feed.ledger, self._reporter.elapsed
            self._storage.arguments = self._commands.arguments
            if self._storage.save(self.trainer, ledger, elapsed, self._epoch, wait=wait):
                self._compaction.on_checkpoint(ledger, failed=bool(self._storage.alarm))
        self._schedule.checkpoint_timer.restart(monotonic())

    def _end(self, state: str) -> Loop[None]:
        """Absorb chunks in flight, publish and save the final state, and close the files.

        Args:
            state: finished or draining.
        """
        self.receiver.room.lift()
        if state == "draining":
            self._tell(state)
            if not self._options.lockstep:
                yield from self._feed.drain(self._answer_while_draining)
        self._feed.close()
        self._publish()
        self._checkpoint(wait=True)
        failure = self._storage.write_policy(self.trainer)
        # Workers end when they hear that a run is finished. Told earlier, they would leave a learner alone that is
        # killed before its last checkpoint is on disk, and resumes before the end.
        self._tell(state)
        self._report()
        self._reporter.log_end(state)
        counts = f"{self.trainer.episodes} episodes, {self.trainer.environment_steps} steps"
        log(f"{state}: {counts}{self._population.ending()}.")
        until = monotonic() + FAREWELL_SECONDS
        while (left := until - monotonic()) > 0:
            yield left
        self._commands.answer()
        self._reporter.close()
        self._history.close()
        if failure:
            raise EiaSecError(failure)
        self._callbacks.end()  # last: it may raise

    def _tell(self, state: str) -> None:
        self._state = state
        self._publish_progress()

    def _answer_while_draining(self) -> None:
        self._stop_if_replaced()
        self._commands.answer()


def _group_metrics(group: ProcessGroup | None) -> dict[str, float]:
    return {"learners": group.size if group else 1, "exchange_seconds": group.seconds if group else 0.0}


def serve(options: LearnerOptions, config: RunConfig, environment: EnvironmentSpec) -> bool:
    """Run the learner until it is done; return whether the run is finished.

    Args:
        options: how to start.
        config: the run.
        environment: the run's environment.

    Raises:
        EndpointError: when the endpoint is in use, or the router does not answer.
        RunDirError: when the run directory belongs to another configuration.
        ConfigError: when the device does not exist, or the algorithm cannot train the team.
        CheckpointError: when a resumed run has checkpoints and all are damaged, or the newest whole one does not fit.
        GroupError: when another learner of its group is gone, or holds other parameters.
        DivergenceError: when actors are no longer finite.
        UsageError: when a newer learner has taken over, or the worker of a lockstep run was restarted.
        EiaSecError: when the final policy cannot be written.
    """
    torch.set_num_threads(config.learner.threads)
    stop = StopSignal()
    stop.install()

    def lane(name: str) -> Bus:
        if options.listen:
            return Bus.listen(options.endpoint, "bulk" if name == "bulk" else "control")
        return connect(options.endpoint, name, stop, options.patience)

    with lane("control") as control, lane("bulk") as bulk, options.group() as group:
        learner = Learner(options, config, environment, control, bulk, group)
        receiver = learner.receiver
        receiving = in_thread("receiver", receiver.receive())
        try:
            return run(learner.run(stop), receiver.dealt_with)
        finally:
            # A thread still inside Zenoh when the interpreter exits would abort the process.
            bulk.close()
            receiver.close()
            receiving.join()
