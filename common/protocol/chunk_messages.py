"""Converts chunks of experience to messages and back, and packs several of them into one request."""

import math
from collections.abc import Collection, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from eia_sec.common.errors import FrameError, SchemaError, VersionError
from eia_sec.common.names import is_name
from eia_sec.common.protocol.frame import Data, length
from eia_sec.common.protocol.messages import ChunkMessage, DeliveryMessage
from eia_sec.common.team import TeamSpec
from eia_sec.common.transitions import LARGEST, MOST_INFOS, TERMINATED, TRUNCATED, Chunk, EpisodeSummary, Rows

MOST_CHUNKS: Final = 64
"""Most chunks in one delivery."""
MOST_BYTES: Final = 2 * 2**20
"""Most bytes of chunks in one delivery; a single chunk may be larger."""
SETTLED: Final = ("accepted", "duplicate", "refused")
"""Verdicts after which a worker drops a chunk; after any other it keeps the chunk."""
EPSILON: Final = float(np.finfo(np.float32).eps)
MOST_COUNT = 2**48
"""Largest accepted count of steps or chunks; at a million steps per second it takes nine years to reach."""


def to_message(chunk: Chunk, team: TeamSpec, version: int, produced: int) -> ChunkMessage:
    """Return the message of a chunk; see `ChunkMessage` for `version` and `produced`."""
    done = chunk.episodes
    names = tuple(done[0].metrics) if done else ()
    values = [[e.metrics[name] for name in names] for e in done]
    rewards = [e.reward for e in done]
    info_names = tuple(sorted({name for e in done for name in e.infos}))
    infos = np.array([[e.infos.get(name, math.nan) for name in info_names] for e in done], np.float64)
    log_probability = chunk.rows.log_probability
    if log_probability is None:
        log_probability = np.zeros((len(chunk.rows.flag), 0), np.float32)
    return ChunkMessage(
        team=team.digest,
        version=version,
        produced=produced,
        observation=chunk.rows.observation,
        action=chunk.rows.action,
        reward=chunk.rows.reward,
        flag=chunk.rows.flag,
        log_probability=log_probability,
        farm=np.array([e.farm for e in done], np.int64),
        episode=np.array([e.episode for e in done], np.int64),
        steps=np.array([e.steps for e in done], np.int64),
        episode_reward=np.array(rewards, np.float32).reshape(len(done), team.agents),
        episode_metrics=np.array(values, np.float64).reshape(len(done), len(names)),
        metric_names=names,
        state=chunk.rows.state,
        infos=infos if info_names else None,
        info_names=info_names or None,
    )


def from_message(
    message: ChunkMessage,
    team: TeamSpec,
    episode_metrics: Collection[str],
    *,
    on_policy: bool = False,
    memory: int = 0,
    rounded: bool = False,
) -> Chunk:
    """Return the chunk of a message, checked against the team.

    Args:
        message: the message.
        team: the team that its rows must fit.
        episode_metrics: names of the environment's episode metrics; a finished episode has exactly these.
        on_policy: whether the rows must have log-probabilities; else they must have none.
        memory: numbers in an actor's state; 0 if the rows must have none.
        rounded: as for `eia_sec.common.transitions.observation_type`.

    Raises:
        VersionError: when it is for another team.
        SchemaError: when rows fail `Rows.check`, the worker's step count is impossible, or a finished episode has other
            metrics, or sums larger than its steps allow.
    """
    if message.team != team.digest:
        raise VersionError(f"the rows are for team {message.team[:16]}, the learner trains team {team.digest}.")
    log_probability = message.log_probability
    if log_probability.ndim != 2 or (log_probability.shape[1] > 0) != on_policy:
        raise SchemaError("rows have log-probabilities if the algorithm learns on policy, and only then.")
    columns = message.observation, message.action, message.reward, message.flag
    rows = Rows(*columns, log_probability if on_policy else None, message.state)
    rows.check(team, memory, rounded=rounded)
    if not rows.steps <= message.produced <= MOST_COUNT:
        raise SchemaError(f"a chunk of {rows.steps} steps cannot bring the steps produced to {message.produced}.")
    count = message.farm.shape[0] if message.farm.ndim == 1 else -1
    names = message.metric_names
    if len(set(names)) != len(names) or (count > 0 and set(names) != set(episode_metrics)):
        raise SchemaError("the finished episodes' metrics are not those of the run's environment.")
    shapes = (message.episode.shape, message.steps.shape, message.episode_reward.shape, message.episode_metrics.shape)
    ends = np.count_nonzero(rows.flag & (TERMINATED | TRUNCATED))
    if count != ends or shapes != ((count,), (count,), (count, team.agents), (count, len(names))):
        raise SchemaError("the finished episodes' arrays fit neither each other nor the rows.")
    if count and not 1 <= message.steps.min() <= message.steps.max() <= MOST_COUNT:
        raise SchemaError("a finished episode has no steps, or impossibly many.")
    # Sums are rounded to 32-bit floats.
    most = LARGEST * (1.0 + EPSILON) * message.steps[:, None].astype(np.float64)
    if not (
        (np.abs(message.episode_reward) <= most).all() and (np.abs(message.episode_metrics) <= team.agents * most).all()
    ):
        raise SchemaError("a finished episode holds a number that is not finite or is too large.")
    info_names, infos = _infos(message, count)
    episodes = tuple(
        EpisodeSummary(
            int(message.farm[k]),
            int(message.episode[k]),
            int(message.steps[k]),
            tuple(message.episode_reward[k].tolist()),
            dict(zip(names, message.episode_metrics[k].tolist(), strict=True)),
            {name: value for name, value in zip(info_names, infos[k].tolist(), strict=True) if not math.isnan(value)},
        )
        for k in range(count)
    )
    return Chunk(rows, episodes)


def _infos(message: ChunkMessage, count: int) -> tuple[tuple[str, ...], NDArray[np.float64]]:
    """Return the names of numbers in infos, and the numbers [K, I] of the K finished episodes."""
    names, infos = message.info_names or (), message.infos
    if infos is None:
        infos = np.zeros((count, 0))
    if len(names) > MOST_INFOS or len(set(names)) != len(names) or not all(map(is_name, names)):
        raise SchemaError(f"the numbers in infos have at most {MOST_INFOS} names, each once.")
    if infos.shape != (count, len(names)) or not (np.isnan(infos) | (np.abs(infos) <= LARGEST)).all():
        raise SchemaError("the numbers in infos fit neither the finished episodes nor their limits.")
    return names, infos


def fitting(sizes: Sequence[int]) -> int:
    """Return how many of the first chunks fit into one delivery, at least one; `sizes` are in bytes."""
    count, room = 1, MOST_BYTES - sizes[0]
    while count < min(len(sizes), MOST_CHUNKS) and sizes[count] <= room:
        room -= sizes[count]
        count += 1
    return count


def to_request(sealed: Sequence[bytes], oldest: int, flown: int) -> bytes:
    """Return a request's payload: a `DeliveryMessage`, then the frames of its chunks."""
    return b"".join([DeliveryMessage(oldest, flown, tuple(map(len, sealed))).encode(), *sealed])


def from_request(payload: bytes) -> tuple[DeliveryMessage, list[Data]]:
    """Return a request's DeliveryMessage and the frames of its chunks, neither copied nor decoded.

    Raises:
        FrameError, VersionError: when the payload does not begin with a whole DeliveryMessage, or its length differs
            from what that message states.
        SchemaError: when it holds no chunks, too many chunks or bytes, or an impossible count of steps.
    """
    view = memoryview(payload)
    place = length(view)
    delivery = DeliveryMessage.decode(view[:place])
    sizes = delivery.sizes
    if sum(sizes) != len(view) - place:
        raise FrameError("the chunks' total length differs from what their delivery states.")
    if not sizes or fitting(sizes) < len(sizes):
        raise SchemaError(f"a delivery cannot hold {len(sizes)} chunks of {sum(sizes)} bytes in total.")
    if delivery.flown > MOST_COUNT:
        raise SchemaError(f"a worker cannot have simulated {delivery.flown} steps.")
    parts: list[Data] = []
    for size in sizes:
        parts.append(view[place : place + size])
        place += size
    return delivery, parts
