"""The coordinator of a population of learners: scores all members in rounds, and lets weak ones imitate the best.

It is the elite coordinator of each member as well, with a session of its own for each: members need not know of one
another, and there is no head node. A round waits for the slowest member that takes part, and members train on
meanwhile. It does not wait for ever: one that is away, comes no further, is not scored in time, or cannot be told, is
left out of it.
"""

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass

import numpy as np

from eia_sec.common.clock import monotonic
from eia_sec.common.config.files import differences, method_of, read_saved
from eia_sec.common.config.run import RunConfig
from eia_sec.common.errors import CancelledError, EndpointError, ProtocolError, UsageError
from eia_sec.common.imitation import LEASE_SECONDS
from eia_sec.common.log import log
from eia_sec.common.loops import Loop, Running, run
from eia_sec.common.population import Exploit, checked_hyperparameters, round_due
from eia_sec.common.process import StopSignal, fetch_configuration
from eia_sec.common.protocol import keys
from eia_sec.common.protocol.messages import ExploitMessage, ParametersMessage, ProgressMessage
from eia_sec.common.reward_sums import RewardSums
from eia_sec.common.team import Float32, TeamSpec
from eia_sec.common.transport.bus import Bus
from eia_sec.elite.evaluation_plan import population_plan
from eia_sec.elite.rounds import Ranking, perturbed, ranked, weak_members
from eia_sec.elite.service import IDLE_SECONDS, Coordinator, CoordinatorOptions

JOIN_SECONDS = 1.0
"""Pause after the first attempt to reach a member; each further one doubles it, up to PATIENCE_SECONDS."""
AWAY_SECONDS = 3.0 * LEASE_SECONDS
"""Time for which a member may be out of reach before a round begins without it, or begins again."""
PATIENCE_SECONDS = 5.0
"""Time between two lines of the log while a member does not answer."""
LATE_SECONDS, LATE_FACTOR = 120.0, 3.0
"""A round goes on without those that are not scored in this time, or in so many times that of the first, if longer."""
STALLED_SECONDS = 300.0
"""Time without a step or an update after which rounds do not wait for a member that trains."""
MOST_ATTEMPTS = 3
"""Attempts at a round that may fail by one member before it is held without it."""


_NOBODY: Float32 = np.zeros((0, 0), np.float32)


class Member:
    """One member, once it has been reached.

    Args:
        name: its run's name.
        coordinator: its elite coordinator.
        config: its configuration.
        team: the layout of its team.
        bus: the session with it.
    """

    def __init__(self, name: str, coordinator: Coordinator, config: RunConfig, team: TeamSpec, bus: Bus) -> None:
        self.name, self.coordinator, self.config, self.team = name, coordinator, config, team
        self._parameters = bus.subscribe_state(keys.PARAMETERS.key(name))
        self._newest: ParametersMessage | None = None
        self._malformed = False
        self._done, self._moved, self._stalled = (0, 0, 0), monotonic(), False

    @property
    def progress(self) -> ProgressMessage | None:
        """Its progress if it can take part in a round, else None."""
        self._listen()
        now = self.coordinator.now
        if now is None or not self.coordinator.can_evaluate or self._newest is None:
            return None
        usable = self._newest.epoch == now.epoch and now.round is not None and now.hyperparameters is not None
        return now if usable else None

    @property
    def parameters(self) -> ParametersMessage:
        """Its newest actors, once it has progress."""
        if self._newest is None:
            raise ProtocolError(f"{self.name} has published no parameters yet.")
        return self._newest

    def note_alive(self) -> None:
        """Count an evaluation, for which its workers stop training, as a sign that it comes further."""
        self._moved = monotonic()

    def moves(self, now: ProgressMessage) -> bool:
        """Return whether it has come further of late; log when that changes."""
        done = now.epoch, now.environment_steps, now.updates
        if done != self._done:
            self._done, self._moved = done, monotonic()
        stalled = monotonic() - self._moved > STALLED_SECONDS
        if stalled != self._stalled:
            said = f"has done nothing for {STALLED_SECONDS:g} s; rounds do not wait for it" if stalled else "goes on"
            log(f"population: {self.name} {said}.")
        self._stalled = stalled
        return not stalled

    def _listen(self) -> None:
        if (sample := self._parameters.poll()) is None:
            return
        try:
            message = ParametersMessage.decode(sample.payload)
            fits = message.team == self.team.digest and len(message.flat) == len(self.team.groups)
            if not fits or not all(flat.ndim == 2 and np.isfinite(flat).all() for flat in message.flat):
                raise ProtocolError("its parameters are not those of its team.")
        except ProtocolError as error:
            if not self._malformed:
                log(f"population: dropped parameters of {self.name}: {error}")
            self._malformed = True
            return
        self._newest, self._malformed = message, False


@dataclass(frozen=True)
class _Candidate:
    """A member in a round.

    Attributes:
        member: who takes part.
        progress: its progress when the round began.
        parameters: its actors at that time: those that are evaluated, and that others imitate.
        evaluation: the evaluation, under way.
    """

    member: Member
    progress: ProgressMessage
    parameters: ParametersMessage
    evaluation: Running[tuple[RewardSums, int, int] | None]


@dataclass(frozen=True)
class _Result:
    """A member's evaluation in a round.

    Attributes:
        member, progress, parameters: as in the candidate.
        rewards: of its agents.
        steps: environment steps of the evaluation.
    """

    member: Member
    progress: ProgressMessage
    parameters: ParametersMessage
    rewards: RewardSums
    steps: int


class Population:
    """The loops of a population's coordinator.

    Args:
        options: how to reach each member.
    """

    def __init__(self, options: Sequence[CoordinatorOptions]) -> None:
        self._options = options
        self._members: dict[str, Member] = {}
        self._compared: dict[tuple[Member, Member], bool] = {}
        self._expected = {one.run for one in options}
        self._held = self._round = 0
        self._failed: Counter[str] = Counter()
        self._reached = False
        self._unfit: list[UsageError | ProtocolError] = []
        # Until the end: a member may finish while it is told of a round.
        self._sessions = ExitStack()
        self._dials = ThreadPoolExecutor(len(options), "dial")

    def run(self, stop: StopSignal) -> Loop[None]:
        """Return the loop that coordinates until a stop signal comes or all members are finished.

        Raises:
            EndpointError: none of the members was reached in time.
            UsageError: none of the members can be coordinated, because of a mistake of the user.
            ProtocolError: none of them can, because of what it answers.
        """
        begun, patience = monotonic(), max(one.patience for one in self._options)
        with self._sessions, self._dials:
            members = [Running(self._joined(options, stop)) for options in self._options]
            rounds = Running(self._rounds(stop))
            while members:
                members = [one for one in members if not one.step()]
                rounds.step()
                if not (self._reached or self._unfit or stop) and monotonic() - begun > patience:
                    where = ", ".join(f"{one.run} at {one.endpoint}" for one in self._options)
                    raise EndpointError(f"no member has answered in {patience:g} s: {where}.")
                yield IDLE_SECONDS
        if len(self._unfit) == len(self._options):
            raise self._unfit[-1]

    def _joined(self, options: CoordinatorOptions, stop: StopSignal) -> Loop[None]:
        """Reach a member, and be its elite coordinator until its run is finished; leave one out that cannot be."""
        try:
            bus = yield from self._dialled(options, stop)
            if bus is not None:
                yield from self._coordinated(options, bus, stop)
        except (UsageError, ProtocolError) as error:
            log(f"population: {options.run} is left out: {error}")
            self._unfit.append(error)
        self._expected.discard(options.run)
        if self._members.pop(options.run, None) is not None:
            log(f"population: {options.run} left.")

    def _dialled(self, options: CoordinatorOptions, stop: StopSignal) -> Loop[Bus | None]:
        """Return a session with a member; None if a stop signal comes first.

        Threads dial: an attempt takes a second, and the leads over other members have to be renewed meanwhile.
        """
        said, pause = monotonic(), JOIN_SECONDS
        while not stop:
            attempt = self._dials.submit(self._connected, options, stop)
            while not attempt.done():
                yield IDLE_SECONDS
            try:
                bus = attempt.result()
            except CancelledError:
                return None
            except EndpointError as error:
                if type(error) is not EndpointError:
                    raise
                if monotonic() - said >= PATIENCE_SECONDS:
                    said = monotonic()
                    log(f"population: waiting for {options.run} at {options.endpoint}: {error}")
            else:
                self._reached = True
                return bus
            end = monotonic() + pause
            pause = min(2.0 * pause, PATIENCE_SECONDS)
            while monotonic() < end and not stop:
                yield IDLE_SECONDS
        return None

    def _connected(self, options: CoordinatorOptions, stop: StopSignal) -> Bus:
        """Return a session that stays open until the end."""
        return self._sessions.enter_context(Bus.connect(options.endpoint, "control", waiting=lambda: not stop))

    def _coordinated(self, options: CoordinatorOptions, bus: Bus, stop: StopSignal) -> Loop[None]:
        answer = yield from fetch_configuration(bus, options.run, options.name, lambda: not stop, PATIENCE_SECONDS)
        if answer is None:
            return
        config, team = read_saved(answer.toml), TeamSpec.from_dict(answer.team)
        coordinator = Coordinator(options, config, team, bus)
        if config.population.members:
            self._members[options.run] = Member(options.run, coordinator, config, team, bus)
            log(f"population: {options.run} joined.")
        else:
            self._exclude(options.run, "its configuration says that it is a run alone")
        yield from coordinator.run(stop)

    def _exclude(self, name: str, reason: str) -> None:
        self._expected.discard(name)
        log(f"population: {name} takes no part, because {reason}.")

    def _belongs(self, member: Member, first: Member) -> bool:
        """Return whether a member learns the same as the first of those that are there; log once why not."""
        pair = (member, first)
        if pair not in self._compared:
            reason = _other_method(member, first)
            if reason:
                self._exclude(member.name, reason)
            self._compared[pair] = not reason
        return self._compared[pair]

    def _rounds(self, stop: StopSignal) -> Loop[None]:
        """Hold each round when it is due, without end."""
        begun, alone = monotonic(), 0
        while True:
            yield IDLE_SECONDS
            gathering = monotonic() - begun < AWAY_SECONDS
            if gathering and self._expected.difference(self._members):
                continue
            present = self._present()
            if gathering and self._expected.difference(member.name for member, _ in present):
                continue
            if len(present) < 2:
                alone = self._tell_alone(present, alone)
                continue
            told = sorted((now.round or 0 for _, now in present), reverse=True)
            # Weak members are told before all others: a round that fewer know than those is not over.
            held = max(self._held, told[weak_members(len(present)) - 1])
            # Who has not even come to that one has joined late, or was away: nobody waits, and it takes part at once.
            dues = [_due(member, now) for member, now in present]
            number = min((due for due in dues if due >= held), default=held)
            if number <= held:
                continue
            if number > self._round:
                self._round = number
                self._failed.clear()
            present = [(member, now) for member, now in present if self._failed[member.name] < MOST_ATTEMPTS]
            if len(present) > 1:
                yield from self._hold(number, present, stop)
                # A learner that has died is known to be away only then.
                end = monotonic() + (LEASE_SECONDS if self._held < number else 0.0)
                while monotonic() < end:
                    yield IDLE_SECONDS
            else:
                self._skip(number)

    def _tell_alone(self, present: Sequence[tuple[Member, ProgressMessage]], told: int) -> int:
        """Log once that a round is due for a member that is alone; return the newest round of which this was said."""
        for member, now in present:
            if (number := _due(member, now)) > max(told, self._held, now.round or 0):
                log(f"population: round {number} is due for {member.name}, and no other member is there.")
                return number
        return told

    def _present(self) -> list[tuple[Member, ProgressMessage]]:
        """Return the members that can take part in a round, in the order in which they were named, with their progress.

        Those of another method than the first one that is there do not.
        """
        members = [self._members[one.run] for one in self._options if one.run in self._members]
        members = [member for member in members if self._belongs(member, members[0])]
        found = [(member, now) for member in members if (now := member.progress) is not None]
        return [(member, now) for member, now in found if member.moves(now)]

    def _skip(self, number: int) -> None:
        """Give up a round for which fewer than two members are left."""
        log(f"population: round {number} is not held, because fewer than two members are left for it.")
        self._held = number

    def _fail(self, number: int, member: Member, reason: str) -> None:
        """Note that an attempt at a round failed by a member, and leave it out after the last one."""
        self._failed[member.name] += 1
        if self._failed[member.name] < MOST_ATTEMPTS:
            log(f"population: round {number} begins again, because {member.name} {reason}.")
        else:
            self._leave_out(number, member, f"{reason} in {MOST_ATTEMPTS} attempts")

    def _leave_out(self, number: int, member: Member, reason: str) -> None:
        log(f"population: round {number} goes on without {member.name}, because it {reason}.")
        member.coordinator.note_missed(f"round {number} was held without it, because it {reason}")

    def _hold(self, number: int, present: Sequence[tuple[Member, ProgressMessage]], stop: StopSignal) -> Loop[None]:
        """Evaluate all members on the same episodes, and tell each what follows; if one leaves meanwhile, give up."""
        results = yield from self._scored(number, present, stop)
        if results is None:
            return
        if len(results) < 2:
            self._skip(number)
            return
        team, elite = present[0][0].team, present[0][0].config.elite
        ranking = ranked(team, elite, {result.member.name: result.rewards for result in results})
        yield from self._tell(number, ranking, results, stop)

    def _scored(
        self, number: int, present: Sequence[tuple[Member, ProgressMessage]], stop: StopSignal
    ) -> Loop[list[_Result] | None]:
        """Return the evaluations of those that are scored in time; None if one leaves meanwhile."""
        plan = population_plan(present[0][0].config, number)
        asked = []
        for member, now in present:
            actors = member.parameters
            evaluation = Running(member.coordinator.evaluate(number, plan, now, stop, actors))
            asked.append(_Candidate(member, now, actors, evaluation))
        results: list[_Result] = []
        begun, allowed, waits = monotonic(), math.inf, False
        seen = {member.name: begun for member, _ in present}
        while asked:
            yield IDLE_SECONDS
            for one in list(asked):
                member, done, current = one.member, one.evaluation.step(), one.member.progress
                if current is not None:
                    seen[member.name] = monotonic()
                restarted = current is not None and current.epoch != one.progress.epoch
                if restarted or monotonic() - seen[member.name] > AWAY_SECONDS:
                    self._fail(number, member, "is away")
                    return None
                if done and one.evaluation.result is None:
                    if not stop:
                        self._fail(number, member, "could not be evaluated")
                    return None
                if done and one.evaluation.result is not None:
                    rewards, _, steps = one.evaluation.result
                    results.append(_Result(member, one.progress, one.parameters, rewards, steps))
                    asked.remove(one)
                    member.note_alive()
                    if len(results) == 1:
                        allowed = max(LATE_SECONDS, LATE_FACTOR * (monotonic() - begun))
            if not (results or waits) and monotonic() - begun > LATE_SECONDS:
                waits = True
                log(f"population: round {number} waits for workers: none has scored a member in {LATE_SECONDS:g} s.")
            if monotonic() - begun > allowed:
                for one in asked:
                    self._leave_out(number, one.member, f"was not scored within {allowed:.0f} s")
                break
        return results

    def _tell(self, number: int, ranking: Ranking, results: Sequence[_Result], stop: StopSignal) -> Loop[None]:
        """Tell each member what the round means for it, the weak ones first: if one cannot be told, nobody else is."""
        events = []
        for result in results:
            try:
                event = _outcome(number, ranking, result, {other.member.name: other for other in results})
            except ProtocolError as error:
                log(f"population: round {number} for {result.member.name}: {error}")
                continue
            if (result.progress.round or 0) < number:  # a weak one may know it from an attempt before this
                events.append((result, event))
        first = [(result, event) for result, event in events if result.member.name in ranking.weak]
        missed = yield from self._delivered(first, stop)
        if missed:
            for member in missed if not stop else ():
                self._fail(number, member, "could not be told")
            return
        self._held = number
        yield from self._delivered([one for one in events if one not in first], stop)

    def _delivered(self, events: Sequence[tuple[_Result, Exploit]], stop: StopSignal) -> Loop[list[Member]]:
        """Send members what a round means for them; return those that did not take it."""
        asked, missed = [], list[Member]()
        for result, event in events:
            payload = ExploitMessage.of(event, result.progress.epoch).encode()
            loop = result.member.coordinator.deliver(keys.POPULATION, payload, f"round {event.round}", stop)
            asked.append((result.member, event, Running(loop)))
        while asked:
            yield IDLE_SECONDS
            for member, event, running in list(asked):
                if running.step():
                    asked.remove((member, event, running))
                    if running.result:
                        log(_sentence(member, event))
                    else:
                        missed.append(member)
        return missed


def _other_method(member: Member, first: Member) -> str:
    """Return in what a member differs from another one beyond seed and hyperparameters; empty if in nothing."""
    if member.team != first.team:
        return f"its team is not that of {first.name}"
    own = {"seed", *(f"algorithm.{option}" for option in first.config.population.hyperparameters)}
    lines = differences(method_of(first.config), method_of(member.config))
    found = [line for line in lines if line.partition(":")[0] not in own]
    more = f" and {len(found) - 3} more" if len(found) > 3 else ""
    return f"it differs from {first.name} in {'; '.join(found[:3])}{more}" if found else ""


def _due(member: Member, now: ProgressMessage) -> int:
    """Return the newest round that is due for a member."""
    return round_due(member.config, member.config.progress(now.episodes, now.environment_steps))


def _outcome(number: int, ranking: Ranking, result: _Result, results: Mapping[str, _Result]) -> Exploit:
    """Return what a round means for one member; raise SchemaError if the best one's hyperparameters are impossible."""
    member, weak = result.member, result.member.name in ranking.weak
    sources = ranking.sources(member.name)
    best = results[ranking.best] if weak else result
    values = checked_hyperparameters(member.config, best.progress.hyperparameters or {})
    flat = []
    for kind, (source, (elite, agent)) in enumerate(zip(sources, ranking.elites, strict=True)):
        found = results[elite].parameters.flat[kind] if source else _NOBODY
        if source and result.progress.separate_since is None and len(found) > 1:
            found = found[agent : agent + 1]  # its agents still share their actors
        flat.append(found)
    return Exploit(
        round=number,
        rate=member.config.population.rate if any(sources) else 0.0,
        scores=ranking.scores,
        sources=sources,
        flat=tuple(flat),
        hyperparameters=perturbed(member.config, values, number, member.name) if weak else values,
        evaluation_steps=result.steps,
    )


def _sentence(member: Member, event: Exploit) -> str:
    """Return what a round meant for a member."""
    score = event.scores[member.name]
    whom = [f"{g.name} of {s}" for g, s in zip(member.team.groups, event.sources, strict=True) if s]
    values = ", ".join(f"{name} {value:.3g}" for name, value in event.hyperparameters.items())
    said = f"imitates {', '.join(whom)} with rate {event.rate:.3g}" if whom else "imitates nobody"
    values = f"; {values}" if values else ""
    return f"population: round {event.round}: {member.name} scores {score:.4g} and {said}{values}."


def serve(options: Sequence[CoordinatorOptions]) -> None:
    """Run the coordinator of a population until all members are finished or a signal comes.

    Raises:
        EndpointError: when no member is reached in time.
        UsageError: when no member's configuration can be read.
        ProtocolError: when the answers of all are malformed.
    """
    stop = StopSignal()
    stop.install()
    run(Population(options).run(stop))
