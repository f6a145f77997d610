"""Follows the episodes in each worker's chunks, so that no worker can lie about their number and length."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from eia_sec.common.errors import SchemaError
from eia_sec.common.protocol.chunk_rules import ChunkRules
from eia_sec.common.protocol.messages import Envelope
from eia_sec.common.transitions import TERMINATED, TRANSITION, TRUNCATED, Chunk, EpisodeSummary

MOST_TRACKED: Final = 4096
"""Most workers whose running episodes are tracked; beyond that, the least recent one is forgotten."""
UNKNOWN: Final = -1
"""Stands for the steps since an episode's end that was not seen."""


class EpisodeTracker:
    """Follows the running episodes of each worker's environments, from chunk to chunk.

    Once an episode's end has been seen, the length of the environment's next episode is known. Before that, after a gap
    or a chunk refused for its content, and for a new worker, it is unknown, and only the rules' bounds are checked.
    """

    def __init__(self, rules: ChunkRules) -> None:
        self._rules = rules
        self._since: dict[str, tuple[Envelope, NDArray[np.int64]]] = {}

    def check(self, sender: Envelope, chunk: Chunk) -> NDArray[np.int64]:
        """Check a chunk's episodes against its rows and the chunks before it.

        Returns:
            [E] steps of each environment since its last episode's end, for `follow`.

        Raises:
            SchemaError: when the rows do not hold equally many steps of E environments, or an episode's length is out
                of bounds or differs from what its environment flew.
        """
        rules = self._rules
        steps = chunk.rows.steps // rules.environments
        at, ends = self._ends(chunk.rows.flag, steps)
        since = self._before(sender)
        known = since != UNKNOWN
        lengths = [episode.steps for episode in chunk.episodes]
        for environment, step, length in zip(at.tolist(), ends.tolist(), lengths, strict=True):
            if not rules.shortest <= length <= rules.longest:
                raise SchemaError(
                    f"an episode of {length} steps, but episodes last {rules.shortest} to {rules.longest} steps."
                )
            flown = step + 1 + (int(since[environment]) if known[environment] else 0)
            if length < flown or (known[environment] and length != flown):
                raise SchemaError(f"an episode of {length} steps ended after {flown} steps.")
            since[environment], known[environment] = -step - 1, True
        return np.where(known, since + steps, UNKNOWN)

    def follow(self, sender: Envelope, since: NDArray[np.int64]) -> None:
        """Remember the environments' steps since their last ends, once a chunk is booked."""
        self._since.pop(sender.name, None)
        self._since[sender.name] = sender, since
        if len(self._since) > MOST_TRACKED:
            self._since.pop(next(iter(self._since)))

    def _before(self, sender: Envelope) -> NDArray[np.int64]:
        last, since = self._since.get(sender.name, (None, None))
        follows = last is not None and (last.incarnation, last.sequence + 1) == (sender.incarnation, sender.sequence)
        return since.copy() if follows and since is not None else np.full(self._rules.environments, UNKNOWN, np.int64)

    def _ends(self, flag: NDArray[np.uint8], steps: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return the environment and the step of each episode's end, in order of time.

        Args:
            flag: [R] flags of the rows.
            steps: steps of each environment.
        """
        count = self._rules.environments
        place = np.flatnonzero(flag & TRANSITION)
        ended = np.flatnonzero(flag[place] & (TERMINATED | TRUNCATED))
        cut = int(np.count_nonzero(ended % steps != steps - 1))
        last = place[steps - 1 :: steps] + 1
        if len(place) != count * steps or len(flag) - len(place) != count + cut or (flag[last] & TRANSITION).any():
            raise SchemaError(f"the rows do not hold {count} environments with {steps} steps each.")
        order = np.lexsort((ended // steps, ended % steps))
        return ended[order] // steps, ended[order] % steps


def provable(episodes: tuple[EpisodeSummary, ...], room: int) -> tuple[EpisodeSummary, ...]:
    """Return those of a chunk's episodes, in order, that fit into `room` delivered steps.

    An episode counts for the run only if the learner has received all its steps. An episode that began before this
    learner's account of the worker may be too long for that.
    """
    counted: list[EpisodeSummary] = []
    for episode in episodes:
        if episode.steps <= room:
            room -= episode.steps
            counted.append(episode)
    return tuple(counted)
