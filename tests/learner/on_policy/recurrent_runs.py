"""Experience of actors with memory, and runs that learn from it."""

from typing import Any

import numpy as np

from eia_sec.common.actors import TeamActors
from eia_sec.common.config import RunConfig
from eia_sec.common.team import Float32
from eia_sec.common.transitions import TERMINATED, TRANSITION, TRUNCATED, Chunk, EpisodeSummary, Rows
from tests.learner.on_policy.small_runs import configured, observations

LENGTH = 5
"""Steps of a sequence."""
ENDS = (
    ((7, TRUNCATED), (10, TERMINATED), (3, 0)),
    ((5, TERMINATED), (15, 0)),
)
"""Segments of two environments of 20 steps: episodes end inside a sequence and between two."""


def with_memory(name: str = "ippo", **options: Any) -> RunConfig:
    """Return a run of ten episodes whose networks have memory."""
    return configured(name, **{"memory": "gru", "sequence_steps": LENGTH, **options})


def played(
    actors: TeamActors, observation: Float32, flag: Any, state: Float32, draw: np.random.Generator
) -> tuple[Float32, Float32]:
    """Return what actors sample in one environment's rows, and its log-probability, one step after another.

    Args:
        actors: actors with memory.
        observation: rows [R, O].
        flag: [R].
        state: [1, agents, h] state before the first row, updated in place.
        draw: where the noise is drawn.
    """
    action = np.zeros((len(flag), actors.team.action_size), np.float32)
    log_probability = np.zeros((len(flag), actors.team.agents), np.float32)
    for row in range(len(flag)):
        if row and flag[row - 1] == 0:
            state[:] = 0.0
        if flag[row]:
            noise = (
                draw.standard_normal((1, action.shape[1]), np.float32),
                draw.random((1, action.shape[1]), np.float32),
            )
            action[row], log_probability[row] = actors.sample(observation[row : row + 1], *noise, state)
    return action, log_probability


def remembered_chunk(actors: TeamActors, seed: int, ends: Any = ENDS, episodes: int = 0) -> Chunk:
    """Return a chunk that actors with memory flew in random observations, in the middle of episodes at first.

    Args:
        actors: the actors.
        seed: of everything that is drawn.
        ends: for each environment its segments, (steps, flag of the last step).
        episodes: how many finished episodes it states.
    """
    draw, team, parts = np.random.default_rng(seed), actors.team, []
    for segments in ends:
        flag = np.concatenate([[TRANSITION] * (steps - 1) + [TRANSITION | end, 0] for steps, end in segments])
        observation = observations(team, len(flag), draw)
        state = draw.uniform(-0.9, 0.9, (1, team.agents, actors.hidden)).astype(np.float32)
        first = state.copy()
        action, log_probability = played(actors, observation, flag, state, draw)
        reward = draw.normal(1.0, 2.0, (len(flag), team.agents)).astype(np.float32)
        reward[flag == 0] = 0.0
        parts.append((observation, action, reward, flag.astype(np.uint8), log_probability, first))
    rows = Rows(*(np.concatenate(part) for part in zip(*parts, strict=True)))
    rows.check(team, actors.hidden)
    done = tuple(EpisodeSummary(n, n, 20, (0.0,) * team.agents, {"energy_j": 1.0}) for n in range(episodes))
    return Chunk(rows, done)
