"""The ring of rows: what can be drawn from it is always one step and its own successor."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from eia_sec.common.errors import CheckpointError, ConfigError, EiaSecError
from eia_sec.common.seeds import stream
from eia_sec.common.team import GroupSpec, TeamSpec
from eia_sec.common.transitions import TERMINATED, TRANSITION, TRUNCATED, Rows
from eia_sec.learner.checkpoint.tensor_snapshot import PIECE_ROWS, whole
from eia_sec.learner.off_policy.index_set import IndexSet
from eia_sec.learner.off_policy.replay import Replay

TEAM = TeamSpec((GroupSpec("a", 2, 2, 1), GroupSpec("b", 1, 1, 2)))


def segments(lengths, first, ends=TRUNCATED):
    """Return rows whose every number is the row's running number, which is unique over all calls."""
    flags = []
    for steps in lengths:
        flags += [TRANSITION] * (steps - 1) + [TRANSITION | ends] + [0]
    count = len(flags)
    number = np.arange(first, first + count, dtype=np.float32)
    return Rows(
        np.repeat(number[:, None], TEAM.observation_size, axis=1),
        np.repeat(-number[:, None] / 1e6, TEAM.action_size, axis=1),
        np.repeat(number[:, None] + 0.5, TEAM.agents, axis=1),
        np.array(flags, np.uint8),
    )


@settings(max_examples=60, deadline=None)
@given(st.lists(st.lists(st.integers(1, 9), min_size=1, max_size=4), min_size=1, max_size=12), st.integers(40, 70))
def test_drawn_rows_are_live_steps_with_their_own_successors(chunks, capacity):
    """Whatever was written over, each drawn row is in the ring, is a step, and is followed by the very next row."""
    replay, first, steps = Replay(TEAM, capacity), 0, set()
    for chunk in chunks:
        rows = segments(chunk, first)
        steps |= {first + i for i in np.flatnonzero(rows.flag & TRANSITION)}
        replay.add(rows, 0)
        first += rows.flag.shape[0]
        live = set(range(max(0, first - capacity), first))
        batch = replay.sample(64, stream(first, "test"))
        now, following = batch.observation[:, 0], batch.next_observation[:, 0]
        assert torch.equal(following, now + 1)
        drawn = {int(value) for value in now}
        assert drawn <= steps & live
        assert {int(value) for value in following} <= live
        assert torch.equal(batch.observation, now[:, None].expand_as(batch.observation))
        assert torch.equal(batch.action, (-now / 1e6)[:, None].expand_as(batch.action))
        assert torch.equal(batch.reward, (now + 0.5)[:, None].expand_as(batch.reward))
        assert replay.transitions == len(steps & live)
        assert replay.rows == len(live)


def test_every_step_is_drawn_equally_often():
    """Over many draws each step of the ring comes up with the same frequency, across the ring's end too."""
    replay = Replay(TEAM, 23)
    replay.add(segments([4, 5, 3], 0), 0)
    replay.add(segments([6, 4], 15), 0)
    places = replay.draw(60_000, stream(0, "test"))
    numbers, counts = np.unique(replay.observation.numpy()[places, 0], return_counts=True)
    assert numbers.size == replay.transitions
    assert abs(counts / places.size * numbers.size - 1).max() < 0.08


def test_only_terminal_steps_are_terminated():
    """TERMINATED reaches the batch; a time limit does not count as a terminal state."""
    replay = Replay(TEAM, 64)
    replay.add(segments([3], 0, ends=TERMINATED), 0)
    replay.add(segments([3], 4, ends=TRUNCATED), 0)
    batch = replay.sample(200, stream(0, "test"))
    assert torch.equal(batch.terminated, (batch.observation[:, 0] == 2).float())
    assert batch.terminated.sum() > 0


def test_a_segment_cut_by_the_ring_stays_usable_from_where_it_is_whole():
    """When new rows cover the beginning of an old segment, its remaining steps are still drawn, and no others."""
    replay = Replay(TEAM, 12)
    replay.add(segments([10], 0), 0)
    replay.add(segments([3], 11), 0)
    drawn = set(replay.observation.numpy()[replay.draw(500, stream(0, "test")), 0].astype(int))
    assert drawn == {3, 4, 5, 6, 7, 8, 9, 11, 12, 13}


def test_an_empty_ring_and_an_oversized_chunk_are_refused():
    """Sampling from nothing and adding more rows than fit raise typed errors, and change nothing."""
    replay = Replay(TEAM, 8)
    with pytest.raises(EiaSecError, match="no transition"):
        replay.sample(1, stream(0, "test"))
    with pytest.raises(ConfigError, match="cannot hold"):
        replay.add(segments([8], 0), 0)
    assert (replay.rows, replay.transitions, replay.head) == (0, 0, 0)


def test_the_policy_version_behind_a_batch_is_known():
    """The mean version of a batch's rows lies between the versions that produced them."""
    replay = Replay(TEAM, 64)
    replay.add(segments([8], 0), 3)
    replay.sample(10, stream(0, "test"))
    assert replay.drawn_version == 3
    replay.add(segments([8], 9), 7)
    replay.sample(500, stream(0, "test"))
    assert 4 < replay.drawn_version < 6


def saved(replay):
    tensors, plain = replay.snapshot()
    return {name: whole(tensor) for name, tensor in tensors.items()}, plain


@pytest.mark.parametrize("chunks", [0, 1, 3, 9])
def test_a_restored_ring_draws_the_same(chunks):
    """A ring put back from its state draws the same batches, and takes further rows alike."""
    replay, twin = Replay(TEAM, 40), Replay(TEAM, 40)
    twin.add(segments([7], 500), 3, "w", 7)
    for number in range(chunks):
        replay.add(segments([4, 3], 9 * number, ends=0), number, "w", number)
        replay.sample(5, stream(number))
    twin.restore(*saved(replay))
    for ring in (replay, twin):
        ring.add(segments([5], 9 * chunks - 1, ends=0), 99, "w", chunks)
    assert (twin.transitions, twin.rows, twin.reuse) == (replay.transitions, replay.rows, replay.reuse)
    for ours, theirs in zip(replay.sample(50, stream(1)), twin.sample(50, stream(1)), strict=True):
        assert torch.equal(ours, theirs)
    for ours, theirs in zip(saved(replay)[0].values(), saved(twin)[0].values(), strict=True):
        assert torch.equal(ours, theirs)
    assert saved(replay)[1] == saved(twin)[1]


@pytest.mark.parametrize(
    "damage",
    ["missing", "shape", "dtype", "head", "rows", "negative", "ends", "successor", "drawable", "twice", "action"],
)
def test_a_state_that_does_not_fit_is_refused(damage):
    """A field that is missing, of another shape or type, or numbers out of range raise CheckpointError."""
    replay = Replay(TEAM, 40)
    replay.add(segments([4, 3], 0), 1)
    tensors, plain = saved(replay)
    wrong = {
        "missing": lambda: tensors.pop("reward"),
        "shape": lambda: tensors.update(action=tensors["action"][:, 1:]),
        "dtype": lambda: tensors.update(version=tensors["version"].int()),
        "head": lambda: plain.update(head=3),
        "rows": lambda: plain.update(rows=41),
        "negative": lambda: plain.update(drawn=-1),
        "ends": lambda: plain.update(ends={"w": 3}),
        "successor": lambda: tensors["successor"].__setitem__(2, 9),
        "drawable": lambda: tensors["drawable"].__setitem__(2, 9),
        "action": lambda: tensors["action"].__setitem__((2, 0), 1.5),
        "twice": lambda: tensors["drawable"].__setitem__(2, int(tensors["drawable"][1])),
    }
    wrong[damage]()
    target = Replay(TEAM, 40)
    with pytest.raises(CheckpointError):
        target.restore(tensors, plain)
    assert (target.rows, target.transitions) == (0, 0)


class World:
    """Environments whose every number is known, flown in chunks by several workers.

    Attributes:
        known: for each observation's number: reward, whether its step terminated, and the next observation's number.
    """

    def __init__(self, draw, workers, environments):
        self.draw, self.number = draw, 0
        self.known, self.chunks = {}, dict.fromkeys(range(workers), 0)
        self.now = {w: [self._fresh() for _ in range(environments)] for w in self.chunks}

    def _fresh(self):
        self.number += 1
        return self.number

    def chunk(self, worker):
        """Return the rows of the worker's next chunk and its number; an episode may end anywhere."""
        rows = []
        for e, now in enumerate(self.now[worker]):
            steps, here = int(self.draw.integers(1, 7)), now
            for _ in range(steps):
                way = self.draw.choice([0, TERMINATED, TRUNCATED], p=[0.8, 0.1, 0.1])
                following, reward = self._fresh(), float(self.draw.normal())
                self.known[here] = (reward, float(way == TERMINATED), following)
                rows.append((here, reward, TRANSITION | int(way)))
                here = following
                if way:
                    rows.append((here, 0.0, 0))
                    here = self._fresh()
            if not way:
                rows.append((here, 0.0, 0))
            self.now[worker][e] = here
        self.chunks[worker] += 1
        number, reward, flag = (np.array(column) for column in zip(*rows, strict=True))
        wide = number.astype(np.float32)[:, None]
        paid = reward.astype(np.float32)[:, None]
        rows = Rows(
            np.repeat(wide, TEAM.observation_size, axis=1),
            np.repeat(wide / 1e6, TEAM.action_size, axis=1),
            np.repeat(paid, TEAM.agents, axis=1),
            flag.astype(np.uint8),
        )
        return rows, self.chunks[worker]


@pytest.mark.parametrize("seed", range(6))
def test_transitions_follow_trajectories_across_all_borders(seed):
    """A transition's next observation is found over chunks, the ring's end and the write head.

    Every observation stands in the ring once, and every step whose row is there can be drawn.
    """
    draw = np.random.default_rng(seed)
    world = World(draw, workers=2, environments=3)
    replay = Replay(TEAM, 150)
    for _ in range(60):
        worker = int(draw.integers(2))
        rows, number = world.chunk(worker)
        replay.add(rows, 0, f"w{worker}", number)
        held = replay.observation[: replay.rows, 0].int().tolist()
        assert len(set(held)) == len(held)
        assert replay.transitions == sum(number in world.known for number in held)
        batch = replay.sample(40, draw)
        for row in range(40):
            reward, terminated, following = world.known[int(batch.observation[row, 0])]
            found = [batch.reward[row, 1], batch.terminated[row], batch.next_observation[row, 0]]
            assert [float(value) for value in found] == pytest.approx([reward, terminated, following], abs=1e-5)
            assert torch.equal(batch.action[row], batch.observation[row, :1].expand(TEAM.action_size) / 1e6)


def test_a_chunk_after_a_lost_one_begins_anew():
    """Without the chunk between, or from another start of the worker, nothing is joined, and no row is lost."""
    draw = np.random.default_rng(3)
    for source, skipped in (("w", 1), ("other", 0)):
        world = World(draw, workers=1, environments=2)
        replay = Replay(TEAM, 400)
        first, number = world.chunk(0)
        replay.add(first, 0, "w", number)
        second, number = world.chunk(0)
        replay.add(second, 0, source, number + skipped)
        assert replay.rows == first.flag.size + second.flag.size
        assert replay.transitions == first.steps + second.steps


def test_old_rows_are_dropped_and_counted():
    """Rows of versions below the limit are not drawn, also such that come late; they count once."""
    replay = Replay(TEAM, 64)
    for version in range(5):
        replay.add(segments([4], 5 * version), version)
    replay.drop_before(2)
    assert (replay.transitions, replay.dropped) == (12, 8)
    replay.drop_before(3)
    replay.add(segments([4], 100), 1)
    assert (replay.transitions, replay.dropped) == (8, 16)
    assert set(replay.version[replay.draw(300, stream(0))]) == {3, 4}
    replay.sample(300, stream(1))
    assert replay.drawn_oldest == 3


def test_reuse_is_the_mean_number_of_draws_before_overwriting():
    """A ring that is overwritten once reports exactly how often its transitions had been drawn."""
    replay = Replay(TEAM, 20)
    replay.add(segments([9, 9], 0), 0)
    assert replay.reuse is None
    for number in range(10):
        replay.sample(27, stream(number))
    replay.add(segments([9, 9], 20), 0)
    assert replay.reuse == pytest.approx(270 / 18)


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(st.booleans(), st.sets(st.integers(0, 30)), st.sets(st.integers(0, 30))), max_size=20))
def test_a_place_set_is_a_set(calls):
    """After any exchanges and removals the set holds what a Python set holds, each once, and draws only that."""
    places, twin = IndexSet(31), set()
    for exchanged, chosen, others in calls:
        if exchanged:
            twin -= others
            places.exchange(np.array(sorted(others), np.int64), np.array(sorted(chosen - twin), np.int64))
            twin |= chosen
        else:
            assert places.remove(np.array(sorted(chosen), np.int64)) == len(chosen & twin)
            twin -= chosen
        assert sorted(places.members().tolist()) == sorted(twin)
        if twin:
            assert set(places.draw(20, stream(0)).tolist()) <= twin


@pytest.mark.parametrize("reading", ["late", "early", "between"])
def test_a_frozen_ring_is_that_of_its_instant(reading):
    """A snapshot that is read before, while or after the ring is overwritten holds what stood there then."""
    capacity, draw = 5 * PIECE_ROWS // 2, np.random.default_rng(5)
    world, replay = World(draw, workers=2, environments=40), Replay(TEAM, capacity)

    def fly(chunks):
        for _ in range(chunks):
            worker = int(draw.integers(2))
            rows, number = world.chunk(worker)
            replay.add(rows, number, f"w{worker}", number)

    fly(20)
    tensors, plain = saved(replay)
    frozen, later = replay.snapshot()
    assert later == plain
    readers = {
        name: (tensor.pieces() if name in ("observation", "action", "reward") else None)
        for name, tensor in frozen.items()
    }
    found = {name: [] for name, reader in readers.items() if reader}
    if reading != "late":
        for name, parts in found.items():
            parts.extend([next(readers[name])] if reading == "between" else list(readers[name]))
    fly(30)
    for name, parts in found.items():
        parts.extend(readers[name])
        assert torch.equal(torch.cat(parts), tensors[name]), name
    assert not torch.equal(replay.action, tensors["action"])
    for name in ("flag", "version", "successor", "uses", "drawable"):
        assert torch.equal(frozen[name], tensors[name])
