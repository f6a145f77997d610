"""The coordinator of a population: it holds rounds over several runs, and goes on where the one before it stopped."""

import re
import time
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from eia_sec.common.config import RunConfig
from eia_sec.common.config.files import from_toml, to_toml, with_values
from eia_sec.common.errors import EndpointError, UsageError
from eia_sec.common.loops import Running, run
from eia_sec.common.process import StopSignal
from eia_sec.common.protocol import keys
from eia_sec.common.protocol.messages import (
    ConfigurationMessage,
    EvaluationOrder,
    EvaluationResult,
    ExploitMessage,
    MetricMessage,
    ParametersMessage,
    ProgressMessage,
    ReceiptMessage,
)
from eia_sec.common.team import GroupSpec, TeamSpec
from eia_sec.common.transport.bus import Bus
from eia_sec.common.transport.endpoint import free_endpoint
from eia_sec.elite import population
from eia_sec.elite.evaluation_plan import population_plan
from eia_sec.elite.population import Member, Population
from eia_sec.elite.service import CoordinatorOptions
from tests.system.fleet import until

TEAM = TeamSpec((GroupSpec("a", 2, 3, 2), GroupSpec("b", 1, 3, 2)))
CONFIG = from_toml(
    "episodes = 100\n[population]\nmembers = 3\nfarms = 2\ninterval = 0.1\n[population.hyperparameters]\n"
    "actor_rate = [1e-4, 1e-2]\n",
    RunConfig(),
)


class FakeMember:
    """A learner and its worker, as a coordinator sees them.

    Args:
        number: its number, from which its name, its parameters and its rate follow.
        worth: what each agent earns in a step.
        held: what keeps its session.
    """

    def __init__(self, number, worth, held, config=CONFIG):
        self.name, self.worth, self.endpoint = f"member-{number}", worth, free_endpoint()
        self.config = with_values(config, {"seed": number, "algorithm.actor_rate": 1e-3 * (1 + number)})
        self.rate, self.round, self.episodes, self.state = 1e-3 * (1 + number), 0, 0, "training"
        self.orders, self.told, self.refuses = [], [], 0
        self.hangs, self.learns, self.steps, self.version = False, False, 0, 1
        self.toml = to_toml(self.config)
        self.flat = tuple(np.full((1, 5), number, np.float32) for _ in TEAM.groups)
        self.bus = held.enter_context(Bus.listen(self.endpoint, "control"))
        self._commands = self.bus.serve(keys.COMMAND.pattern(self.name), 16)
        self._rounds = self.bus.serve(keys.POPULATION.key(self.name), 4)
        self._evaluations = self.bus.serve(keys.EVALUATION.key(self.name, worker="w"), 4)
        self._token = self.bus.announce(keys.LIVE.key(self.name, role="rollout", name="w"))
        self._progress = self.bus.publish_state(keys.PROGRESS.key(self.name), keys.PROGRESS.encoding)
        self._parameters = self.bus.publish_state(keys.PARAMETERS.key(self.name), keys.PARAMETERS.encoding)
        self._metrics = self.bus.subscribe(keys.METRIC.pattern(self.name), 64)
        self._publish(self.flat)

    def _publish(self, flat):
        message = ParametersMessage(4, self.version, 0, 0, 0.0, TEAM.digest, 8, "gaussian", flat)
        self._parameters.put(message.encode())

    def alarms(self):
        """Return the newest alarms of the coordinator."""
        found = [MetricMessage.decode(sample.payload).values["alarms"] for sample in self._metrics.drain()]
        return found[-1] if found else []

    def turn(self):
        """Answer what has come, and tell the progress."""
        for command in self._commands.waiting():
            if command.key.endswith("/configuration"):
                command.reply(ConfigurationMessage(4, self.toml, TEAM.to_dict(), lockstep=False).encode())
            else:
                command.reply(ReceiptMessage(True, "").encode())
        for incoming in () if self.hangs else self._evaluations.waiting():
            order = EvaluationOrder.decode(incoming.payload)
            if not order.event:  # for those who watch the run
                incoming.refuse("nobody watches.")
                continue
            self.orders.append((order.event, order.farms, order.episodes))
            assert [float(flat[0, 0]) for flat in order.flat] == [float(flat[0, 0]) for flat in self.flat]
            if self.learns:
                self.version += 1
                self._publish(tuple(flat + 100.0 for flat in self.flat))
            reward = np.tile(np.array(self.worth, np.float32), (len(order.farms), 4, 1))
            steps = np.full(len(order.farms), 4, np.int64)
            incoming.reply(EvaluationResult(order.event, order.version, reward, steps).encode())
        for incoming in self._rounds.waiting():
            if self.refuses:
                self.refuses -= 1
                incoming.reply(ReceiptMessage(False, "not now").encode())
                continue
            message = ExploitMessage.decode(incoming.payload)
            event = message.to_event()
            event.check(TEAM, self.config)
            self.told.append(event)
            self.round, self.rate = event.round, event.hyperparameters["actor_rate"]
            incoming.reply(ReceiptMessage(True, "").encode())
        message = ProgressMessage(4, self.version, 0, self.episodes, self.steps, 0, self.state)
        hyperparameters = {"actor_rate": self.rate}
        self._progress.put(replace(message, round=self.round, hyperparameters=hyperparameters).encode())


class Trial:
    """Members, and a coordinator that may be replaced."""

    def __init__(self, members):
        self.members, self._stop = members, StopSignal()
        self._loop = None
        self.replace()

    def replace(self):
        """Start another coordinator in place of the present one."""
        self.end()
        self._stop = StopSignal()
        options = [CoordinatorOptions(member.name, member.endpoint) for member in self.members]
        self._loop = Running(Population(options).run(self._stop))

    def end(self):
        """End the present coordinator."""
        self._stop.event.set()
        while self._loop is not None and not self._loop.step():
            pass
        self._loop = None

    def until(self, condition, what):
        """Let everybody take turns until a condition holds."""

        def turn():
            for member in self.members:
                member.turn()
            assert not self._loop.step()
            return condition()

        until(turn, what, 60.0)

    def held(self, number, *members):
        """Wait until members were told of a round."""
        self.until(lambda: all(one.told and one.told[-1].round == number for one in members), f"round {number}")


@pytest.fixture
def trial():
    """Three members; the second is the best, but its agent of type b is not; the last one is the weakest."""
    with ExitStack() as held:
        worths = ((1.0, 1.0, 5.0), (6.0, 7.0, 1.0), (0.0, 0.0, 0.0))
        found = Trial([FakeMember(number, worth, held) for number, worth in enumerate(worths)])
        yield found
        found.end()


def test_a_round_is_held_when_the_slowest_is_due(trial):
    """All are scored on the same episodes; the weakest imitates the elite team of each type and takes over the rate."""
    first, second, weak = trial.members
    first.episodes = second.episodes = 50
    trial.until(lambda: not any(one.orders for one in trial.members), "nothing")
    weak.episodes = 10
    trial.held(1, *trial.members)
    assert first.orders == second.orders == weak.orders == [(1, *population_plan(CONFIG, 1))]
    (event,) = weak.told
    assert event.sources == ("member-1", "member-0")
    assert [float(flat[0, 0]) for flat in event.flat] == [1.0, 0.0]
    assert (event.rate, event.evaluation_steps) == (1.0, 8)
    assert event.scores == pytest.approx({"member-0": 7 / 3, "member-1": 14 / 3, "member-2": 0.0})
    assert event.hyperparameters["actor_rate"] in (pytest.approx(2e-3 * 1.2), pytest.approx(2e-3 / 1.2))
    for other, rate in ((first, 1e-3), (second, 2e-3)):
        (event,) = other.told
        assert (event.sources, event.rate, event.hyperparameters) == (("", ""), 0.0, {"actor_rate": rate})


def test_another_coordinator_goes_on_with_the_next_round(trial):
    """It repeats none that members took part in, and of several that are due it holds the newest."""
    for member in trial.members:
        member.episodes = 10
    trial.held(1, *trial.members)
    trial.replace()
    for member in trial.members:
        member.episodes = 35
    trial.held(3, *trial.members)
    assert [[event.round for event in member.told] for member in trial.members] == [[1, 3]] * 3


def test_who_joins_late_takes_part_at_once(trial):
    """Rounds that the others have had do not wait for it; it imitates the best in the next one."""
    first, second, late = trial.members
    first.round = second.round = 2
    first.episodes = second.episodes = 25
    turns = []
    trial.until(lambda: turns.append(1) or len(turns) > 40, "turns")
    assert not any(member.told for member in trial.members)
    second.episodes = first.episodes = 30
    trial.held(3, *trial.members)
    assert late.told[0].sources == ("member-1", "member-0")
    assert [len(member.told) for member in trial.members] == [1, 1, 1]


def test_a_round_that_the_weak_one_did_not_take_is_held_again(trial):
    """Nobody else hears of it before, so that another coordinator does not take it for held."""
    first, second, weak = trial.members
    weak.refuses = 1_000_000
    for member in trial.members:
        member.episodes = 10
    trial.until(lambda: weak.refuses < 999_999, "two refusals")
    weak.refuses = 1_000_000
    assert first.told == second.told == []
    trial.replace()
    weak.refuses = 0
    trial.held(1, *trial.members)
    assert weak.told[0].sources == ("member-1", "member-0")


def test_a_round_is_held_until_all_weak_ones_know_it():
    """Of eight members two imitate; while one of them knows a round and the other does not, it is held again."""
    with ExitStack() as held:
        trial = Trial([FakeMember(number, (number, number, number), held) for number in range(8)])
        try:
            weakest, other, *strong = trial.members
            other.refuses = 1
            for member in trial.members:
                member.episodes = 10
            trial.held(1, *trial.members)
            assert [len(member.told) for member in trial.members] == [1] * 8
            assert weakest.told[0].sources == other.told[0].sources == ("member-7", "member-7")
            assert all(len(member.orders) == 2 for member in strong)
        finally:
            trial.end()


def test_a_member_that_has_left_is_not_waited_for(trial, capsys):
    """The others hold their rounds without it; alone, a member holds none."""
    first, second, third = trial.members
    third.state = "finished"
    first.episodes = second.episodes = 20
    trial.held(2, first, second)
    assert (third.told, set(first.told[-1].scores)) == ([], {"member-0", "member-1"})
    assert first.told[-1].sources == ("member-1", "")
    second.state = "finished"
    first.episodes = 40
    seen = []
    trial.until(lambda: seen.append(1) or len(seen) > 60, "turns")
    assert [event.round for event in first.told] == [2]
    assert capsys.readouterr().err.count("round 4 is due for member-0, and no other member is there.") == 1


def test_the_actors_that_were_scored_are_imitated(trial):
    """Not those that their learner has by the time at which the others are told."""
    _, second, weak = trial.members
    for member in trial.members:
        member.episodes, member.learns = 10, True
    trial.held(1, *trial.members)
    assert second.version > 1
    assert [float(flat[0, 0]) for flat in weak.told[0].flat] == [1.0, 0.0]


def test_a_round_goes_on_without_who_is_not_scored(trial, monkeypatch, capsys):
    """A member whose workers hang is left out of the round; log and alarm say so, and the next one asks it again."""
    monkeypatch.setattr(population, "LATE_SECONDS", 1.0)
    first, second, hung = trial.members
    hung.hangs = True
    for member in trial.members:
        member.episodes = 10
    trial.held(1, first, second)
    assert (set(first.told[0].scores), hung.told) == ({"member-0", "member-1"}, [])
    reason = "because it was not scored within 1 s"
    assert f"round 1 goes on without member-2, {reason}." in capsys.readouterr().err
    said = f"rounds of its population that it missed: 1; the last one: round 1 was held without it, {reason}."
    trial.until(lambda: said in hung.alarms(), "the alarm")
    hung.hangs = False
    for member in trial.members:
        member.episodes = 20
    trial.held(2, *trial.members)
    assert set(first.told[-1].scores) == {"member-0", "member-1", "member-2"}


def test_a_round_in_which_nobody_is_scored_says_so(trial, monkeypatch, capsys):
    """Once; it is held when the workers answer again."""
    monkeypatch.setattr(population, "LATE_SECONDS", 0.3)
    for member in trial.members:
        member.episodes, member.hangs = 10, True
    said, told = "round 1 waits for workers: none has scored a member in 0.3 s.", []
    trial.until(lambda: told.append(capsys.readouterr().err) or said in "".join(told), "the log")
    for member in trial.members:
        member.hangs = False
    trial.held(1, *trial.members)
    assert said not in capsys.readouterr().err


def test_a_round_that_is_left_with_one_member_is_not_held(monkeypatch, capsys):
    """There is nobody to compare it with; the next round is held with both."""
    monkeypatch.setattr(population, "LATE_SECONDS", 1.0)
    with ExitStack() as held:
        trial = Trial([FakeMember(number, (number, 1, 1), held) for number in range(2)])
        try:
            trial.members[0].hangs = True
            for member in trial.members:
                member.episodes = 10
            told = []
            trial.until(lambda: told.append(capsys.readouterr().err) or "not held" in "".join(told), "the log")
            trial.members[0].hangs = False
            for member in trial.members:
                member.episodes = 20
            trial.held(2, *trial.members)
            assert [len(member.told) for member in trial.members] == [1, 1]
        finally:
            trial.end()


def test_a_member_that_does_nothing_is_noticed(monkeypatch, capsys):
    """A step, an update or an evaluation is a sign of life; the log says once when there is none, and when there is."""
    clock = SimpleNamespace(now=0.0)
    monkeypatch.setattr(population, "monotonic", lambda: clock.now)
    member = Member("m", None, CONFIG, TEAM, SimpleNamespace(subscribe_state=lambda key: None))

    def moves(seconds, steps, updates=0):
        clock.now += seconds
        return member.moves(ProgressMessage(4, 1, 0, 0, steps, updates, "training"))

    assert all(moves(200.0, steps, updates) for steps, updates in ((1, 0), (2, 0), (2, 1)))
    assert moves(299.0, 2, 1)
    member.note_alive()
    assert moves(299.0, 2, 1)
    assert capsys.readouterr().err == ""
    assert [moves(2.0, 2, 1), moves(500.0, 2, 1), moves(1.0, 3, 1)] == [False, False, True]
    said = capsys.readouterr().err
    assert said.count("m has done nothing for 300 s; rounds do not wait for it.") == said.count("m goes on.") == 1


def test_a_member_that_does_nothing_is_not_waited_for(trial, monkeypatch):
    """Its learner answers, but no step comes; the others hold their rounds until it goes on."""
    first, second, stalled = trial.members
    asleep = {stalled.name}
    monkeypatch.setattr(Member, "moves", lambda member, now: member.name not in asleep)
    first.episodes = second.episodes = 10
    trial.held(1, first, second)
    assert set(first.told[0].scores) == {"member-0", "member-1"}
    asleep.clear()
    first.episodes = second.episodes = stalled.episodes = 20
    trial.held(2, *trial.members)
    assert set(stalled.told[0].scores) == {"member-0", "member-1", "member-2"}


def test_who_refuses_a_round_does_not_hold_it_up(trial, monkeypatch, capsys):
    """After some attempts it is held without that member, which is asked again in the next one."""
    monkeypatch.setattr(population, "LEASE_SECONDS", 0.1)
    first, second, weak = trial.members
    weak.refuses = 1_000_000
    for member in trial.members:
        member.episodes = 10
    trial.held(1, first, second)
    assert weak.refuses == 1_000_000 - population.MOST_ATTEMPTS
    assert (first.told[0].sources, second.told[0].sources) == (("member-1", ""), ("", ""))
    said = capsys.readouterr().err
    assert said.count("round 1 begins again, because member-2 could not be told.") == population.MOST_ATTEMPTS - 1
    assert "round 1 goes on without member-2, because it could not be told in 3 attempts." in said
    weak.refuses = 0
    for member in trial.members:
        member.episodes = 20
    trial.held(2, *trial.members)
    assert weak.told[0].sources == ("member-1", "member-0")


@contextmanager
def three(change):
    """Yield a trial of three members, all due for a round, after a change to the last one."""
    with ExitStack() as held:
        members = [FakeMember(number, (number, 1, 1), held) for number in range(3)]
        change(members[2])
        for member in members:
            member.episodes = 10
        trial = Trial(members)
        try:
            yield trial
        finally:
            trial.end()


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"population.farms": 3}, "it differs from member-0 in population.farms: 2 -> 3."),
        ({"episodes": 200}, "it differs from member-0 in episodes: 100 -> 200."),
        ({"farm.world.sensors": 31, "algorithm.hidden": 7}, "algorithm.hidden: "),
        ({"population.members": 0, "population.hyperparameters": {}}, "its configuration says that it is a run alone."),
    ],
)
def test_a_run_that_is_no_member_takes_no_part(values, said, capsys):
    """One that learns something else, or otherwise: scores would not compare methods. The log says why."""

    def other(member):
        plain = CONFIG if values.get("population.members") != 0 else RunConfig()
        member.toml = to_toml(with_values(plain, {key: value for key, value in values.items() if value != {}}))

    with three(other) as trial:
        trial.held(1, *trial.members[:2])
        assert trial.members[2].told == []
        (line,) = (line for line in capsys.readouterr().err.splitlines() if "member-2 takes no part" in line)
        assert said in line


def test_a_member_that_cannot_be_read_is_left_out(capsys):
    """The others go on without it; once nobody is left, the coordinator fails as for a run alone."""

    def unreadable(member):
        member.toml = "this = is no configuration"

    with three(unreadable) as trial:
        trial.held(1, *trial.members[:2])
        assert "population: member-2 is left out: " in capsys.readouterr().err
    with ExitStack() as held:
        trial = Trial([FakeMember(number, (1, 1, 1), held) for number in range(2)])
        for member in trial.members:
            unreadable(member)
        with pytest.raises(UsageError):
            trial.until(lambda: False, "nothing")


def test_a_member_that_is_out_of_reach_does_not_hold_up_the_others(monkeypatch, capsys):
    """Threads dial: the leads over those that are there do not expire, and the log says for whom it waits."""
    monkeypatch.setattr(population, "PATIENCE_SECONDS", 2.0)
    monkeypatch.setattr(population, "AWAY_SECONDS", 0.0)
    away = free_endpoint()
    with ExitStack() as held:
        member = FakeMember(0, (1, 1, 1), held)
        options = [CoordinatorOptions("member-0", member.endpoint), CoordinatorOptions("gone", away)]
        stop, longest = StopSignal(), 0.0
        loop = Running(Population(options).run(stop))
        said = ""

        def turn():
            nonlocal longest, said
            member.turn()
            begun = time.monotonic()
            assert not loop.step()
            longest = max(longest, time.monotonic() - begun)
            said += capsys.readouterr().err
            return f"waiting for gone at {away}" in said

        until(turn, "the log", 60.0)
        stop.event.set()
        while not loop.step():
            pass
        assert longest < 0.9


def test_a_coordinator_that_reaches_nobody_gives_up():
    """After its patience, in one sentence that names where it looked."""
    where = free_endpoint()
    loop = Population([CoordinatorOptions("member-0", where, patience=1.0)]).run(StopSignal())
    with pytest.raises(EndpointError, match=rf"^no member has answered in 1 s: member-0 at {re.escape(str(where))}\.$"):
        run(loop)
