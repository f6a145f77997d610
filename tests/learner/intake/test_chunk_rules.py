"""A worker that lies about steps, episodes and versions: it is refused and named, and the other ledgers stay exact."""

from dataclasses import replace

import numpy as np
import pytest

from eia_sec.common.actors import TeamActors
from eia_sec.common.config.presets import preset
from eia_sec.common.errors import SchemaError
from eia_sec.common.history.history import Entry, History, Start, read
from eia_sec.common.protocol import keys
from eia_sec.common.protocol.chunk_messages import MOST_COUNT, to_message, to_request
from eia_sec.common.protocol.chunk_rules import ChunkRules
from eia_sec.common.protocol.messages import Envelope
from eia_sec.common.seeds import stream
from eia_sec.common.transitions import TRANSITION, TRUNCATED, Chunk, EpisodeSummary, Rows
from eia_sec.deploy.monitor.audit import audit
from eia_sec.learner.intake.episode_tracker import EpisodeTracker
from eia_sec.learner.intake.limits import IntakeLimits
from eia_sec.learner.intake.peer_penalties import LIMIT
from eia_sec.learner.intake.receiver import Receiver
from eia_sec.rollout.worker.collector import Collector
from tests.faults.tools.channel import RUN, TEAM, Door, Parcel, receiving, shut

FARM = ChunkRules(environments=2, chunk_steps=10, spool_chunks=4, shortest=30, longest=30)
"""Rules as on a farm, where every episode lasts 30 steps."""
VARYING = replace(FARM, shortest=1, longest=100)


def a_chunk(ends: dict[tuple[int, int], int], environments: int = 2, steps: int = 10) -> Chunk:
    """Return a chunk with episodes of these lengths that end at (environment, step)."""
    flags: list[int] = []
    for environment in range(environments):
        for step in range(steps):
            ended = (environment, step) in ends
            flags += [TRANSITION | (TRUNCATED if ended else 0)] + [0] * (ended or step == steps - 1)
    sizes = (TEAM.observation_size, TEAM.action_size, TEAM.agents)
    rows = Rows(*(np.zeros((len(flags), size), np.float32) for size in sizes), np.array(flags, np.uint8))
    order = sorted(ends, key=lambda end: (end[1], end[0]))
    episodes = tuple(EpisodeSummary(0, k, ends[end], (0.0,) * TEAM.agents, {}) for k, end in enumerate(order))
    return Chunk(rows, episodes)


def sender(number: int, name: str = "w", start: int = 1) -> Envelope:
    return Envelope("rollout", name, start, number)


def parcel(*chunks: Chunk, number: int = 1, name: str = "w", version: int = 0, **claims: int) -> Parcel:
    """Return an honest request with chunks of 20 steps, but for the claims."""
    sealed = [
        to_message(chunk, TEAM, version, claims.get("produced", 20 * (number + index))).encode()
        for index, chunk in enumerate(chunks)
    ]
    last = 20 * (number + len(chunks) - 1)
    payload = to_request(sealed, claims.get("oldest", number), claims.get("flown", last))
    return Parcel(keys.TRANSITION.key(RUN, worker=name), payload, sender(number, name).encode())


def front_door(rules: ChunkRules = FARM, history: History | None = None) -> tuple[Receiver, Door]:
    door, bounds = Door(), IntakeLimits(64, None)
    return receiving(door, rules, bounds, history=history), door


def finished(receiver: Receiver) -> int:
    """Return the episodes in all chunks that are queued."""
    return sum(len(arrival.chunk.episodes) for arrival in list(receiver.arrivals.queue))


def test_one_chunk_of_one_step_episodes_does_not_end_a_farm_run():
    """Episodes of a farm last as long as its configuration says; a chunk full of shorter ones is refused."""
    receiver, door = front_door()
    short = a_chunk({(environment, step): 1 for environment in range(2) for step in range(10)})
    answer = door.pass_on(parcel(short)).answer
    assert answer.verdicts == ("refused",)
    assert "episodes last 30 to 30" in answer.reasons[0]
    assert finished(receiver) == 0
    shut(receiver, door)


@pytest.mark.parametrize("count", [0, 1, 2, 4])
def test_states_are_those_of_the_runs_environments(count):
    """A chunk of actors with memory is taken with a state for each environment, and refused with another number."""
    receiver, door = front_door(replace(FARM, log_probabilities=True, memory=4))
    rows = a_chunk({}).rows
    state = np.zeros((count, TEAM.agents, 4), np.float32)
    chunk = Chunk(replace(rows, log_probability=np.zeros_like(rows.reward), state=state))
    answer = door.pass_on(parcel(chunk)).answer
    assert answer.verdicts == ("accepted" if count == 2 else "refused",)
    assert "environment" in answer.reasons[0] or count == 2
    shut(receiver, door)


def test_episodes_that_were_not_flown_do_not_count():
    """Without delivered steps behind them whole episodes end the run of nobody, over however many starts."""
    receiver, door = front_door()
    for start in range(1, 21):
        claimed = parcel(a_chunk({(0, 5): 30, (1, 5): 30}), number=1_000)
        claimed.attachment = sender(1_000, start=start).encode()
        assert door.pass_on(claimed).verdict == "accepted"
    assert finished(receiver) == 0
    assert receiver.uncounted_episodes == 40
    shut(receiver, door)


def test_whole_flights_count_exactly():
    """Every episode of a worker whose chunks all arrive counts, also across chunks and after a refused one."""
    receiver, door = front_door()
    for number in range(1, 13):
        ended = {(0, 9): 30, (1, 9): 30} if number % 3 == 0 else {}
        assert door.pass_on(parcel(a_chunk(ended), number=number)).verdict == "accepted"
    assert (finished(receiver), receiver.uncounted_episodes) == (8, 0)
    assert door.pass_on(parcel(a_chunk({}), number=13, produced=1)).verdict == "refused"
    assert door.pass_on(parcel(a_chunk({(0, 9): 30, (1, 9): 30}), number=14)).verdict == "accepted"
    # Of the chunk that was refused 20 steps are missing: one of the two episodes is not proven.
    assert (finished(receiver), receiver.uncounted_episodes) == (8, 2)
    shut(receiver, door)


@pytest.mark.parametrize(
    ("ends", "reason"),
    [
        ({(0, 4): 6}, "6 steps ended after 5"),
        ({(0, 4): 5, (0, 6): 3}, "3 steps ended after 2"),
        ({(0, 4): 101}, "101 steps, but episodes last 1 to 100"),
        ({(1, 0): 2**63 - 1}, "episodes last 1 to 100"),
    ],
)
def test_an_episode_is_as_long_as_its_environment_flew(ends, reason):
    """Where the last end is known, an episode's length follows from the rows, and no other is believed."""
    tracker = EpisodeTracker(VARYING)
    first = a_chunk({(0, 9): 10, (1, 9): 10})
    tracker.follow(sender(1), tracker.check(sender(1), first))
    with pytest.raises(SchemaError, match=reason):
        tracker.check(sender(2), a_chunk(ends))
    assert tracker.check(sender(2), a_chunk({(0, 4): 5, (0, 6): 2})).tolist() == [3, 10]


def test_an_end_that_was_not_seen_leaves_only_the_bounds():
    """A worker met anew may be in the midst of an episode, which is at least as long as what is seen of it."""
    tracker = EpisodeTracker(VARYING)
    assert tracker.check(sender(7), a_chunk({(0, 4): 60})).tolist() == [5, -1]
    with pytest.raises(SchemaError, match="4 steps ended after 5"):
        tracker.check(sender(7), a_chunk({(0, 4): 4}))


def test_random_flights_are_taken_as_they_were_flown():
    """Whatever ends when: summaries in the order of the collector fit the rows, chunk after chunk."""
    draw, tracker = stream(0, "flights"), EpisodeTracker(VARYING)
    length = np.zeros(2, np.int64)
    for number in range(1, 200):
        ends: dict[tuple[int, int], int] = {}
        for step in range(10):
            length += 1
            for environment in np.flatnonzero((draw.random(2) < 0.15) | (length >= 100)):
                ends[int(environment), step] = int(length[environment])
                length[environment] = 0
        tracker.follow(sender(number), tracker.check(sender(number), a_chunk(ends)))


@pytest.mark.parametrize(
    "chunk",
    [a_chunk({}, 2, 9), a_chunk({}, 1, 20), a_chunk({}, 4, 5), a_chunk({}, 2, 11), a_chunk({(0, 9): 30}, 1, 10)],
)
def test_chunks_of_another_shape_are_refused(chunk):
    """Each chunk holds so many steps of so many environments, so histories stay short."""
    receiver, door = front_door(replace(FARM, shortest=1))
    assert door.pass_on(parcel(chunk)).verdict == "refused"
    shut(receiver, door)


def test_the_rows_of_a_collector_fit():
    """The rules of a run's configuration take what its workers fly, also where a chunk is longer than an episode."""
    config = preset("eia-sec")
    world = replace(config.farm.world, steps=7)
    rollout = replace(config.rollout, environments=2, chunk_steps=10)
    config = replace(config, farm=replace(config.farm, world=world), rollout=rollout)
    collector = Collector(config, "w", 0)
    tracker = EpisodeTracker(ChunkRules.of(config, collector.environments.spec))
    actors = TeamActors.initial(collector.team, 4, 0, per_type=False)
    for number in range(1, 6):
        chunk = collector.collect(actors, 0.1, uniform=False)
        tracker.follow(sender(number), tracker.check(sender(number), chunk))


LIES = {
    "a number without end": {"number": MOST_COUNT, "oldest": MOST_COUNT},
    "more produced than was sent": {"produced": 2**40},
    "less produced than was sent": {"produced": 20, "number": 2},
    "more flown than a spool holds": {"flown": 2**40},
    "a gap in what it delivers": {"number": 9, "oldest": 9},
}


@pytest.mark.parametrize("claims", LIES.values(), ids=LIES)
def test_a_liar_is_named_and_the_ledger_stays_exact(claims, tmp_path):
    """No claim of one worker leaves anything unexplained, inflates what is lost, or fails the audit."""
    history = History(tmp_path / "history" / "learner.jsonl")
    receiver, door = front_door(history=history)
    assert door.pass_on(parcel(a_chunk({}), name="honest")).verdict == "accepted"
    assert door.pass_on(parcel(a_chunk({}), name="liar")).verdict == "accepted"
    for _ in range(LIMIT):
        lie = {"number": receiver.ledger.workers["liar"].expected, **claims}
        door.pass_on(parcel(a_chunk({}), name="liar", **lie))
    assert "worker liar is blocked" in receiver.peer_penalties.alarms()[0]
    assert door.pass_on(parcel(a_chunk({}), name="honest", number=2)).verdict == "accepted"
    totals, rows = receiver.ledger.accounts()
    assert receiver.ledger.unexplained() == 0
    assert (rows["honest"]["accepted"], totals["accepted"], totals["lost"]) == (40, 60, 0)
    shut(receiver, door)
    history.close()
    found = audit(tmp_path)
    assert found.clean, found.named()
    assert found.workers["honest"]["accepted"] == 40


def test_one_chunk_many_times_in_a_delivery_is_taken_once(tmp_path):
    """Copies under the numbers that follow do not fit these, and only the first is learnt from."""
    receiver, door = front_door()
    copies = parcel(*[a_chunk({})] * 64, produced=20, flown=20)
    assert door.pass_on(copies).answer.verdicts == ("accepted",) + ("refused",) * 63
    assert (receiver.ledger.totals()["accepted"], receiver.ledger.unexplained()) == (20, 0)
    shut(receiver, door)


@pytest.mark.parametrize("version", [8, 2**63 - 1])
def test_no_chunk_counts_as_newer_than_what_was_published(version):
    """A version from the future would pass every limit of age and spoil the running means."""
    receiver, door = front_door()
    receiver.room.set_version(7)
    assert door.pass_on(parcel(a_chunk({}), version=version)).verdict == "accepted"
    assert receiver.arrivals.get_nowait().sender.version == 7
    shut(receiver, door)


def test_good_and_refused_chunks_in_turn_do_not_break_the_account(tmp_path):
    """A first chunk that cannot be used is refused, and the audit knows that those before it never came."""
    history = History(tmp_path / "history" / "learner.jsonl")
    receiver, door = front_door(history=history)
    assert door.pass_on(parcel(a_chunk({}), number=500, produced=1)).verdict == "refused"
    assert door.pass_on(parcel(a_chunk({}), number=501)).verdict == "accepted"
    shut(receiver, door)
    history.close()
    assert audit(tmp_path).clean
    records = read(tmp_path / "history" / "learner.jsonl")[0]
    assert [r.verdict for r in records if isinstance(r, Entry)] == ["missing", "refused", "missing", "accepted"]


def test_what_a_replaced_start_never_delivered_is_in_the_history(tmp_path):
    """The learner counts as lost what the earlier start had flown beyond its last chunk, and its history says so."""
    history = History(tmp_path / "history" / "learner.jsonl")
    history.add(Start("learner", "learner", 1))
    receiver, door = front_door(history=history)
    assert door.pass_on(parcel(a_chunk({}), flown=50)).verdict == "accepted"
    next_start = parcel(a_chunk({}))
    next_start.attachment = sender(1, start=2).encode()
    assert door.pass_on(next_start).verdict == "accepted"
    shut(receiver, door)
    history.close()
    assert receiver.ledger.totals()["lost"] == 30
    found = audit(tmp_path)
    assert found.clean
    assert (found.steps["lost"], found.lost_with["unknown"]) == (30, 30)


def test_a_short_chunk_is_taken_and_the_next_one_follows_it():
    """A worker that was interrupted goes on with whole chunks; every step is accounted for."""
    receiver, door = front_door()
    produced = 0
    for number, steps in enumerate((10, 3, 10, 1, 10), start=1):
        produced += 2 * steps
        sent = parcel(a_chunk({}, steps=steps), number=number, produced=produced, flown=produced)
        assert door.pass_on(sent).verdict == "accepted"
    totals = receiver.ledger.totals()
    assert (totals["produced"], totals["accepted"], totals["lost"], totals["unexplained"]) == (68, 68, 0, 0)
    shut(receiver, door)


@pytest.mark.parametrize("produced", [20, 24, 28, 40])
def test_a_short_chunk_hides_no_steps(produced):
    """A worker that claims to have produced more or less than it sent is refused."""
    receiver, door = front_door()
    assert door.pass_on(parcel(a_chunk({}))).verdict == "accepted"
    answer = door.pass_on(parcel(a_chunk({}, steps=3), number=2, produced=produced)).answer
    assert answer.verdicts == ("refused",)
    assert "produced with chunk 2 of 6 steps, but 20 before" in answer.reasons[0]
    shut(receiver, door)


def test_chunks_of_networks_with_memory_are_never_short():
    """They learn from whole sequences of equally many steps."""
    receiver, door = front_door(replace(FARM, memory=4))
    answer = door.pass_on(parcel(a_chunk({}, steps=3), produced=6)).answer
    assert answer.verdicts == ("refused",)
    assert "each chunk of this run holds 20 to 20" in answer.reasons[0]
    shut(receiver, door)
