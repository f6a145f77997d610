"""A chunk on the wire is bounded by what is in it."""

import dataclasses

import numpy as np
import pytest

from eia_sec.common.errors import SchemaError
from eia_sec.common.protocol.bfloat16 import to_bits
from eia_sec.common.protocol.chunk_messages import from_message, to_message
from eia_sec.common.protocol.messages import ChunkMessage
from eia_sec.common.transitions import TRANSITION, TRUNCATED, Chunk, EpisodeSummary, Rows
from tests.faults.tools.channel import TEAM


def of_short_episodes(steps: int, episodes: int) -> Chunk:
    """Return a chunk of so many environment steps, in whose first ones so many episodes of one step end."""
    sizes = (TEAM.observation_size, TEAM.action_size, TEAM.agents)
    ends = min(steps, episodes)
    flag = np.array([TRANSITION | TRUNCATED, 0] * ends + [TRANSITION, 0] * (steps - ends), np.uint8)
    rows = Rows(*(np.zeros((len(flag), size), np.float32) for size in sizes), flag)
    return Chunk(rows, tuple(EpisodeSummary(0, k, 1, (0.0,) * TEAM.agents, {}) for k in range(episodes)))


def test_a_chunk_may_finish_as_many_episodes_as_it_has_steps():
    """Thousands of episodes of one step are lawful; one more than there are steps is not."""
    whole = of_short_episodes(5000, 5000)
    assert from_message(to_message(whole, TEAM, 1, 5000), TEAM, ()).episodes == whole.episodes
    with pytest.raises(SchemaError, match="fit neither each other"):
        from_message(to_message(of_short_episodes(3, 4), TEAM, 1, 3), TEAM, ())


def test_episodes_end_where_the_rows_say():
    """As many summaries as flags of an end, each of at least one step: their count decides the end of a run."""
    whole = of_short_episodes(8, 3)
    for episodes in (whole.episodes[:2], (), whole.episodes + whole.episodes[:1]):
        with pytest.raises(SchemaError, match="fit neither each other"):
            from_message(to_message(Chunk(whole.rows, episodes), TEAM, 1, 8), TEAM, ())
    odd = (*whole.episodes[:2], dataclasses.replace(whole.episodes[2], steps=-5))
    with pytest.raises(SchemaError, match="no steps"):
        from_message(to_message(Chunk(whole.rows, odd), TEAM, 1, 8), TEAM, ())


@pytest.mark.parametrize("value", [1.01e7, -1e22, np.nan, np.inf])
@pytest.mark.parametrize("part", ["observation", "reward"])
def test_numbers_that_would_spoil_the_training_are_refused(part, value):
    """One far number in one row makes moments infinite, after which a weight never moves again."""
    rows = of_short_episodes(2, 0).rows
    getattr(rows, part)[0, 0] = value
    with pytest.raises(SchemaError, match=f"{part} holds a number"):
        from_message(to_message(Chunk(rows), TEAM, 1, 2), TEAM, ())


def remembering(state) -> Chunk:
    """Return a chunk of two environments with two steps each, and this state."""
    rows = of_short_episodes(4, 0).rows
    flag = np.array([TRANSITION, TRANSITION, 0] * 2, np.uint8)
    parts = (np.zeros((6, part.shape[1]), np.float32) for part in (rows.observation, rows.action, rows.reward))
    return Chunk(Rows(*parts, flag, np.zeros((6, TEAM.agents), np.float32), state))


def test_states_come_over_the_wire():
    """A chunk of actors with memory brings a state for each environment and agent."""
    state = np.random.default_rng(0).uniform(-1, 1, (2, TEAM.agents, 5)).astype(np.float32)
    message = ChunkMessage.decode(to_message(remembering(state), TEAM, 1, 4).encode())
    found = from_message(message, TEAM, (), on_policy=True, memory=5)
    np.testing.assert_array_equal(found.rows.state, state)
    assert found.rows.steps_by_environment().tolist() == [[0, 3], [1, 4]]


@pytest.mark.parametrize(
    ("shape", "value", "memory"),
    [
        (None, 0.0, 5),
        ((2, 2, 5), 0.0, 0),
        ((2, 2, 0), 0.0, 0),
        ((2, 2, 5), 0.0, 6),
        ((2, 3, 5), 0.0, 5),
        ((2, 10), 0.0, 5),
        ((0, 2, 5), 0.0, 5),
        ((3, 2, 5), 0.0, 5),
        ((4, 2, 5), 0.0, 5),
        ((2, 2, 5), 1.01, 5),
        ((2, 2, 5), np.nan, 5),
        ((2, 2, 5), -np.inf, 5),
    ],
)
def test_states_that_do_not_fit_are_refused(shape, value, memory):
    """States are those of the run's memory, of environments with equally many steps, and bounded."""
    state = None if shape is None else np.full(shape, value, np.float32)
    message = to_message(remembering(state), TEAM, 1, 4)
    with pytest.raises(SchemaError, match=r"state|environment"):
        from_message(message, TEAM, (), on_policy=True, memory=memory)


@pytest.mark.parametrize(
    "metrics",
    [{}, {"aoi": 1.0}, {"aoi": 1.0, "updates": 2.0}, {"aoi": 1.0, "vdf": 2.0, "kind": 3.0}, {"aoi": 1.0, "vdf": 2.1e7}],
)
def test_a_finished_episode_has_the_metrics_of_the_environment(metrics):
    """Other names could collide with those of the learner's records, and no value may make a mean infinite."""
    whole = of_short_episodes(1, 1)
    whole_episode = EpisodeSummary(0, 0, 1, (1.0,) * TEAM.agents, {"vdf": 2.0, "aoi": 1.0})
    assert from_message(to_message(Chunk(whole.rows, (whole_episode,)), TEAM, 1, 1), TEAM, ("aoi", "vdf")).episodes == (
        whole_episode,
    )
    odd = Chunk(whole.rows, (EpisodeSummary(0, 0, 1, (1.0,) * TEAM.agents, metrics),))
    with pytest.raises(SchemaError, match="finished"):
        from_message(to_message(odd, TEAM, 1, 1), TEAM, ("aoi", "vdf"))
    none = of_short_episodes(1, 0)
    assert from_message(to_message(none, TEAM, 1, 1), TEAM, ("aoi", "vdf")).episodes == ()


def rounded(rows: Rows) -> Rows:
    """Return the rows with observations of bfloat16 numbers."""
    return dataclasses.replace(rows, observation=to_bits(rows.observation))


def test_rounded_observations_take_half_the_bytes():
    """They arrive as they were sent, in a frame that is shorter by two bytes for each number."""
    whole = of_short_episodes(50, 0)
    whole.rows.observation[:] = np.random.default_rng(0).normal(size=whole.rows.observation.shape)
    halved = Chunk(rounded(whole.rows))
    sent = to_message(halved, TEAM, 1, 50).encode()
    found = from_message(ChunkMessage.decode(sent), TEAM, (), rounded=True).rows
    assert found.observation.dtype == np.uint16
    np.testing.assert_array_equal(found.observation, halved.rows.observation)
    longer = len(to_message(whole, TEAM, 1, 50).encode()) - len(sent)
    assert abs(longer - 2 * whole.rows.observation.size) < 8


@pytest.mark.parametrize("wanted", [True, False])
def test_observations_have_the_type_that_the_run_asks_for(wanted):
    """A worker of another version, or of another configuration, is refused and says which type was wanted."""
    rows = of_short_episodes(2, 0).rows
    message = to_message(Chunk(rows if wanted else rounded(rows)), TEAM, 1, 2)
    kinds = "float32.*uint16" if wanted else "uint16.*float32"
    with pytest.raises(SchemaError, match=f"observation is {kinds}"):
        from_message(message, TEAM, (), rounded=wanted)


@pytest.mark.parametrize("value", [1.01e7, -1e22, np.nan, np.inf])
def test_rounded_numbers_that_would_spoil_the_training_are_refused(value):
    """The bound is the same."""
    rows = of_short_episodes(2, 0).rows
    rows.observation[0, 0] = value
    with pytest.raises(SchemaError, match="observation holds a number"):
        from_message(to_message(Chunk(rounded(rows)), TEAM, 1, 2), TEAM, (), rounded=True)
