"""A chunk on the wire is bounded by what is in it."""

import numpy as np
import pytest

from common.chunks import from_message, to_message
from common.errors import SchemaError
from common.transitions import TRANSITION, Chunk, EpisodeSummary, Rows
from tests.faults.channel import TEAM


def of_short_episodes(steps: int, episodes: int) -> Chunk:
    """Return a chunk of so many environment steps in which so many episodes end."""
    sizes = (TEAM.observation_size, TEAM.action_size, TEAM.agents)
    flag = np.array([TRANSITION] * steps + [0], np.uint8)
    rows = Rows(*(np.zeros((steps + 1, size), np.float32) for size in sizes), flag)
    return Chunk(rows, tuple(EpisodeSummary(0, k, 1, (0.0,) * TEAM.agents, {}) for k in range(episodes)))


def test_a_chunk_may_finish_as_many_episodes_as_it_has_steps():
    """Thousands of episodes of one step are lawful; one more than there are steps is not."""
    whole = of_short_episodes(5000, 5000)
    assert from_message(to_message(whole, TEAM, 1, 5000), TEAM, ()).episodes == whole.episodes
    with pytest.raises(SchemaError, match="do not fit together"):
        from_message(to_message(of_short_episodes(3, 4), TEAM, 1, 3), TEAM, ())


@pytest.mark.parametrize(
    "figures",
    [{}, {"aoi": 1.0}, {"aoi": 1.0, "updates": 2.0}, {"aoi": 1.0, "vdf": 2.0, "kind": 3.0}, {"aoi": 1.0, "vdf": 1e31}],
)
def test_an_episode_comes_to_what_the_environment_tells(figures):
    """Names of others would meet those of the learner's own records; and no figure makes a mean infinite."""
    whole = of_short_episodes(1, 1)
    told = EpisodeSummary(0, 0, 1, (1.0,) * TEAM.agents, {"vdf": 2.0, "aoi": 1.0})
    assert from_message(to_message(Chunk(whole.rows, (told,)), TEAM, 1, 1), TEAM, ("aoi", "vdf")).episodes == (told,)
    odd = Chunk(whole.rows, (EpisodeSummary(0, 0, 1, (1.0,) * TEAM.agents, figures),))
    with pytest.raises(SchemaError, match="finished"):
        from_message(to_message(odd, TEAM, 1, 1), TEAM, ("aoi", "vdf"))
    assert from_message(to_message(Chunk(whole.rows), TEAM, 1, 1), TEAM, ("aoi", "vdf")).episodes == ()
