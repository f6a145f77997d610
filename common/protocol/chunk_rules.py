"""The shape of every chunk of a run.

The learner refuses other chunks. Workers check their own by the same rules before they send them, so that no chunk is
refused for ever: a worker that cannot make a valid one ends and says why.

Every worker simulates the configured number of environments, and a chunk holds equally many steps of each:
`chunk_steps`, or fewer where the worker was interrupted or asked for a shorter one. Networks with memory learn from
whole sequences of equally many steps, so their chunks are never shorter. So the steps that a worker's start has
produced follow from the chunks before, and are bounded where some of these are missing.

Only the parameter version, and the values of actors' states, cannot be checked. `Receiver` clamps a future version to
the newest published one and trusts an older one; docs/reference/security.md describes what a false one can do.
"""

from dataclasses import dataclass

import numpy as np

from eia_sec.common.config import RunConfig
from eia_sec.common.environment import EnvironmentSpec
from eia_sec.common.errors import SchemaError
from eia_sec.common.protocol.chunk_messages import from_message
from eia_sec.common.protocol.messages import ChunkMessage, Envelope
from eia_sec.common.team import TeamSpec
from eia_sec.common.transitions import TRANSITION, Chunk


@dataclass(frozen=True)
class ChunkRules:
    """The shape of every chunk of a run.

    Attributes:
        environments: environments of one worker, E.
        chunk_steps: most steps of each of them in one chunk, S.
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
        """Environment steps of a whole chunk."""
        return self.environments * self.chunk_steps

    def chunk_of(self, message: ChunkMessage, team: TeamSpec) -> Chunk:
        """Return the chunk of a message, checked against the team.

        Raises:
            VersionError, SchemaError: see `eia_sec.common.protocol.chunk_messages.from_message`.
        """
        # Before an object is made for each of its episodes, of which a small chunk may claim millions.
        steps = np.count_nonzero(message.flag & TRANSITION) if message.flag.dtype == np.uint8 else 0
        fewest = self.steps if self.memory else self.environments
        if not fewest <= steps <= self.steps or steps % self.environments:
            raise SchemaError(
                f"the chunk holds {steps} steps, but each chunk of this run holds {fewest} to {self.steps}, equally "
                f"many of {self.environments} environments."
            )
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

    def check_counts(
        self, sender: Envelope, steps: int, produced: int, flown: int, before: int, *, follows: bool
    ) -> None:
        """Raise SchemaError unless a worker's counts follow from the chunks before.

        Args:
            sender: who sent the chunk, with the chunk's own number.
            steps: environment steps in it.
            produced: steps that its start has produced up to and including it, as the chunk states.
            flown: steps that its start has flown, as the delivery states.
            before: steps that its start has produced with the last chunk of which that is known.
            follows: whether that was the chunk just before.
        """
        least = before + steps
        most = least if follows else sender.sequence * self.steps
        if not least <= produced <= most or produced % self.environments:
            raise SchemaError(
                f"{produced} steps produced with chunk {sender.sequence} of {steps} steps, but {before} before."
            )
        if flown > produced + self.spool_chunks * self.steps:
            raise SchemaError(f"{flown} steps flown, but a spool holds at most {self.spool_chunks} chunks.")
