"""The ring of rows: what can be drawn from it is always one step and its own successor."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from common.errors import CheckpointError, ConfigError, EiaSecError
from common.seeds import stream
from common.team import GroupSpec, TeamSpec
from common.transitions import TERMINATED, TRANSITION, TRUNCATED, Rows
from learner.replay import Replay

TEAM = TeamSpec((GroupSpec("a", 2, 2, 1), GroupSpec("b", 1, 1, 2)))


def segments(lengths, first, ends=TRUNCATED):
    """Return rows whose every number tells the row's running number, which is unique over all calls."""
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


@pytest.mark.parametrize("chunks", [1, 3, 9])
def test_a_restored_ring_draws_the_same(chunks):
    """A ring put back from its state draws the same batches, and takes further rows alike."""
    replay, twin = Replay(TEAM, 40), Replay(TEAM, 40)
    for number in range(chunks):
        replay.add(segments([4, 3], 9 * number), number)
    twin.restore({name: tensor.clone() for name, tensor in replay.state().items()})
    for ring in (replay, twin):
        ring.add(segments([5], 1000), 99)
    assert twin.transitions == replay.transitions
    for ours, theirs in zip(replay.sample(50, stream(1)), twin.sample(50, stream(1)), strict=True):
        assert torch.equal(ours, theirs)


@pytest.mark.parametrize("damage", ["missing", "shape", "dtype", "head", "rows"])
def test_a_state_that_does_not_fit_is_refused(damage):
    """A field that is missing, of another shape or type, or counters out of range raise CheckpointError."""
    replay = Replay(TEAM, 40)
    replay.add(segments([4, 3], 0), 1)
    state = {name: tensor.clone() for name, tensor in replay.state().items()}
    if damage == "missing":
        del state["reward"]
    elif damage == "shape":
        state["action"] = state["action"][:, 1:]
    elif damage == "dtype":
        state["version"] = state["version"].int()
    elif damage == "head":
        state["ring"][0] = 3
    else:
        state["ring"][1] = 41
    with pytest.raises(CheckpointError):
        Replay(TEAM, 40).restore(state)
