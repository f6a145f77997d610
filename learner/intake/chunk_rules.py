"""Checks of a worker's chunks against the run's configuration, so that no worker can lie about its steps.

Every worker simulates the configured number of environments, `chunk_steps` steps of each per chunk. So the sequence
number determines a chunk's steps and the steps that its start has produced. The rows determine which episodes end and
how long they were.

Only the parameter version, and the values of actors' states, cannot be checked. `Receiver` clamps a future version to
the newest published one and trusts an older one; docs/reference/security.md describes what a false one can do.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from eia_sec.common.config import RunConfig
from eia_sec.common.environment import EnvironmentSpec
from eia_sec.common.errors import SchemaError
from eia_sec.common.protocol.chunk_messages import from_message
from eia_sec.common.protocol.messages import ChunkMessage, Envelope
from eia_sec.common.team import TeamSpec
from eia_sec.common.transitions import TERMINATED, TRANSITION, TRUNCATED, Chunk, EpisodeSummary

MOST_TRACKED: Final = 4096
"""Most workers whose running episodes are tracked; beyond that, the least recent one is forgotten."""
UNKNOWN: Final = -1
"""Stands for the steps since an episode's end that was not seen."""


@dataclass(frozen=True)
class ChunkRules:
    """The shape of every chunk of a run.

    Attributes:
        environments: environments of one worker, E.
        chunk_steps: steps of each of them in one chunk, S.
        spool_chunks: most chunks that a worker holds.
        shortest: fewest steps of an episode.
        longest: most steps of an episode.
        episode_metrics: names of the environment's episode metrics.
        log_probabilities: whether rows hold log-probabilities, as algorithms that learn on policy need.
        memory: numbers in an actor's state, which rows then hold; 0 for actors without memory.
        rounded: whether rows hold observations as bfloat16 numbers.
    """

    environments: int
    chunk_steps: int
    spool_chunks: int
    shortest: int
    longest: int
    episode_metrics: tuple[str, ...] = ()
    log_probabilities: bool = False
    memory: int = 0
    rounded: bool = False

    @classmethod
    def of(cls, config: RunConfig, environment: EnvironmentSpec) -> "ChunkRules":
        """Return the rules of a run."""
        rollout, steps = config.rollout, environment.episode_steps
        sizes = rollout.environments, rollout.chunk_steps, rollout.spool_chunks
        on_policy, memory, rounded = config.learns_on_policy, config.memory_size, config.bfloat16_observations
        return cls(*sizes, *steps, environment.metric_names, on_policy, memory, rounded)

    @property
    def steps(self) -> int:
        """Environment steps of one chunk."""
        return self.environments * self.chunk_steps

    def chunk_of(self, message: ChunkMessage, team: TeamSpec) -> Chunk:
        """Return the chunk of a message, checked against the team.

        Raises:
            VersionError, SchemaError: see `eia_sec.common.protocol.chunk_messages.from_message`.
        """
        # Before an object is made for each of its episodes, of which a small chunk may claim millions.
        steps = np.count_nonzero(message.flag & TRANSITION) if message.flag.dtype == np.uint8 else 0
        if steps != self.steps:
            raise SchemaError(f"the chunk holds {steps} steps, but each chunk of this run holds {self.steps}.")
        chunk = from_message(
            message,
            team,
            self.episode_metrics,
            on_policy=self.log_probabilities,
            memory=self.memory,
            rounded=self.rounded,
        )
        state = chunk.rows.state
        if state is not None and len(state) != self.environments:
            raise SchemaError(f"the states are those of {len(state)} environments, not of {self.environments}.")
        return chunk

    def check_counts(self, sender: Envelope, produced: int, flown: int) -> None:
        """Raise SchemaError unless a worker's counts follow from the sequence number of its chunk.

        Args:
            sender: who sent the chunk, with the chunk's own number.
            produced: steps that its start has produced up to and including it, as the chunk states.
            flown: steps that its start has flown, as the delivery states.
        """
        if produced != sender.sequence * self.steps:
            raise SchemaError(f"{produced} steps produced with chunk {sender.sequence} of {self.steps} steps each.")
        if flown > produced + self.spool_chunks * self.steps:
            raise SchemaError(f"{flown} steps flown, but a spool holds at most {self.spool_chunks} chunks.")


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
            SchemaError: when the rows do not hold S steps of E environments each, or an episode's length is out of
                bounds or differs from what its environment flew.
        """
        rules = self._rules
        at, ends = self._ends(chunk.rows.flag)
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
        return np.where(known, since + rules.chunk_steps, UNKNOWN)

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

    def _ends(self, flag: NDArray[np.uint8]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return the environment and the step of each episode's end, in order of time."""
        count, steps = self._rules.environments, self._rules.chunk_steps
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
