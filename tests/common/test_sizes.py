"""Runs whose messages no frame holds."""

from dataclasses import replace

import numpy as np
import pytest

from common.actors import ActorBank
from common.chunks import to_message
from common.config import AlgorithmConfig, EnvConfig, ReplayConfig, RolloutConfig, RunConfig
from common.errors import ConfigError
from common.messages import ParametersMessage
from common.sizes import ROOM, actor_bytes, chunk_bytes, require_frames
from common.team import GroupSpec, TeamSpec, farm_team
from common.transitions import FARM_FIGURES, TERMINATED, TRANSITION, Chunk, EpisodeSummary, Rows

TEAM = farm_team(RunConfig().farm)
DEEP = ReplayConfig(capacity=10_000_000)


@pytest.mark.parametrize(("environments", "steps"), [(1, 1), (8, 20), (64, 5)])
def test_the_largest_chunk_is_as_large_as_told(environments, steps):
    """A chunk in which every step ends an episode takes the bytes that are told, but for the room beside them."""
    config = RunConfig(rollout=RolloutConfig(environments=environments, chunk_steps=steps))
    count = environments * steps
    shapes = (TEAM.observation_size, TEAM.action_size, TEAM.agents)
    flag = np.tile(np.array([TRANSITION | TERMINATED, 0], np.uint8), count)
    rows = Rows(*(np.zeros((2 * count, size), np.float32) for size in shapes), flag)
    ended = EpisodeSummary(0, 0, 1, (0.0,) * TEAM.agents, dict.fromkeys(FARM_FIGURES, 0.0))
    size = len(to_message(Chunk(rows, (ended,) * count), TEAM, 1, count).encode())
    assert 0.9 * (size - 1000) <= chunk_bytes(config, TEAM) <= size + 64 * count
    assert size <= chunk_bytes(config, TEAM) + ROOM


@pytest.mark.parametrize("hidden", [4, 64])
@pytest.mark.parametrize("head", ["deterministic", "gaussian"])
def test_the_actors_are_as_large_as_told(hidden, head):
    """All actors take the bytes that are told, but for the room beside them."""
    bank = ActorBank.initial(TEAM, hidden, 0, head=head)
    size = len(ParametersMessage(1, 1, 0, 0, 0.0, TEAM.digest, bank.hidden, bank.head, bank.flat).encode())
    told = actor_bytes(RunConfig(algorithm=AlgorithmConfig(hidden=hidden)), TEAM)
    assert 0.8 * size <= told
    assert size <= told + ROOM


def test_what_no_frame_holds_is_refused():
    """The sentence says what is too large and what to change; the defaults and a large fleet are taken."""
    require_frames(RunConfig(), TEAM)
    require_frames(RunConfig(), TeamSpec(tuple(replace(group, count=32) for group in TEAM.groups)))
    wide = RolloutConfig(environments=512, chunk_steps=1000)
    with pytest.raises(ConfigError, match=r"512 environments times 1000 steps .* lower rollout\.chunk_steps"):
        require_frames(RunConfig(rollout=wide, replay=DEEP), TEAM)
    with pytest.raises(ConfigError, match=r"hidden 4096 take \d+ MiB, .* lower algorithm\.hidden"):
        require_frames(RunConfig(algorithm=AlgorithmConfig(hidden=4096)), TEAM)
    seen = TeamSpec((GroupSpec("agent", 64, 65_536, 2),))
    with pytest.raises(ConfigError, match="8 environments times 20 steps"):
        require_frames(RunConfig(env=EnvConfig(), algorithm=AlgorithmConfig(hidden=1)), seen)
