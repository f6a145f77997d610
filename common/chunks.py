"""Between a chunk of experience and its message on the wire."""

import numpy as np

from common.errors import SchemaError, VersionError
from common.messages import ChunkMessage
from common.team import TeamSpec
from common.transitions import Chunk, EpisodeSummary, Rows

MAX_EPISODES = 4096
"""Most episodes that one chunk may finish."""
MAX_FIGURES = 64
"""Most figures of an episode."""
MAX_NAME = 64
"""Most characters of a figure's name."""


def to_message(chunk: Chunk, team: TeamSpec, oldest: int, produced: int, flown: int) -> ChunkMessage:
    """Return the message of a chunk; see `ChunkMessage` for `oldest`, `produced` and `flown`."""
    done = chunk.episodes
    names = tuple(done[0].figures) if done else ()
    figures = [[e.figures[name] for name in names] for e in done]
    rewards = [e.reward for e in done]
    return ChunkMessage(
        team=team.digest,
        oldest=oldest,
        produced=produced,
        flown=flown,
        observation=chunk.rows.observation,
        action=chunk.rows.action,
        reward=chunk.rows.reward,
        flag=chunk.rows.flag,
        farm=np.array([e.farm for e in done], np.int64),
        episode=np.array([e.episode for e in done], np.int64),
        steps=np.array([e.steps for e in done], np.int64),
        episode_reward=np.array(rewards, np.float32).reshape(len(done), team.agents),
        episode_figures=np.array(figures, np.float64).reshape(len(done), len(names)),
        figure_names=names,
    )


def from_message(message: ChunkMessage, team: TeamSpec) -> Chunk:
    """Return the chunk of a message, checked against the team.

    Raises:
        VersionError: when it is for another team.
        SchemaError: when a shape does not fit, a number is not finite, or an action leaves [-1, 1].
    """
    if message.team != team.digest:
        raise VersionError(f"rows for team {message.team[:16]} sent to a learner of team {team.digest}.")
    rows = Rows(message.observation, message.action, message.reward, message.flag)
    rows.check(team)
    count = message.farm.shape[0] if message.farm.ndim == 1 else -1
    names = message.figure_names
    if len(names) > MAX_FIGURES or len(set(names)) != len(names) or any(len(name) > MAX_NAME for name in names):
        raise SchemaError("the finished episodes' figures have impossible names.")
    shapes = (message.episode.shape, message.steps.shape, message.episode_reward.shape, message.episode_figures.shape)
    if not 0 <= count <= MAX_EPISODES or shapes != ((count,), (count,), (count, team.agents), (count, len(names))):
        raise SchemaError("the finished episodes' arrays do not fit together.")
    if not (np.isfinite(message.episode_reward).all() and np.isfinite(message.episode_figures).all()):
        raise SchemaError("a finished episode holds a number that is not finite.")
    episodes = tuple(
        EpisodeSummary(
            int(message.farm[k]),
            int(message.episode[k]),
            int(message.steps[k]),
            tuple(message.episode_reward[k].tolist()),
            dict(zip(names, message.episode_figures[k].tolist(), strict=True)),
        )
        for k in range(count)
    )
    return Chunk(rows, episodes)
