"""Decides before every chunk whether a worker collects or waits."""

from eia_sec.common.actors import TeamActors
from eia_sec.common.config import RolloutConfig
from eia_sec.rollout.worker.learner_link import COLLECTING, LearnerLink
from eia_sec.rollout.worker.sender import Sender

FOREIGN_SECONDS = 5.0
"""A learner publishes a version before an answer asks for it. If its progress still names a lower one so long after the
answer, the answer was not its own."""


class CollectionGate:
    """Makes a worker wait in each of these cases.

    - No parameters have come yet, or the run drains.
    - The spool is full, because the workers produce more than the learner takes in. Nothing is dropped.
    - It has as many steps under way as the learner's window allows (on policy), or its actors are older than the
      learner's last answer asks for. More would be too old when their turn comes.
    - Its actors are more than `rollout.max_lag_versions` versions behind the learner's.
    - The learner has published nothing for more than `rollout.max_silence_seconds`.

    While the learner is gone, a worker collects until its spool or the window is full, then waits for the learner to
    come back. In lockstep it waits after every chunk for the answer and for the parameters that the answer requires.

    Args:
        config: the limits.
        learner: the state of the learner.
        sender: the spool.
        lockstep: whether worker and learner take turns.

    Attributes:
        pause_reason: alarm that says why the actors are too old to collect with, or empty.
    """

    def __init__(self, config: RolloutConfig, learner: LearnerLink, sender: Sender, lockstep: bool) -> None:
        self._config, self._learner, self._sender, self._lockstep = config, learner, sender, lockstep
        self.pause_reason = ""
        self._epoch = 0

    def actors(self) -> TeamActors | None:
        """Return the actors to collect the next chunk with, or None to wait."""
        store, sender = self._learner.store, self._sender
        self.pause_reason = ""
        if self._learner.epoch != self._epoch:
            if self._epoch:
                # Versions of another learner; this one may have begun anew below them.
                sender.required_version = 0
            self._epoch = self._learner.epoch
        heard_since = self._learner.heard_at - sender.answered_at
        if heard_since > FOREIGN_SECONDS and self._learner.newest_version < sender.required_version:
            # The answer was an earlier learner's, and came after this one had been followed.
            sender.required_version = 0
        if store.actors is None or self._learner.state not in COLLECTING:
            return None
        if self._lockstep:
            answered = sender.spooled == 0
            return store.actors if answered and store.version >= max(1, sender.required_version) else None
        self.pause_reason = self._too_old()
        return None if self.pause_reason or sender.full or self._awaits_learner() else store.actors

    @property
    def asked_steps(self) -> int:
        """Environment steps with which a chunk ends, if it is not whole before: several workers share an iteration."""
        return self._newest.asked_steps

    @property
    def _newest(self) -> LearnerLink | Sender:
        """Where the learner's newest terms are: its answers, or what it publishes."""
        return self._learner if self._learner.heard_at > self._sender.answered_at else self._sender

    def _awaits_learner(self) -> bool:
        """Return whether the learner lets nothing more be under way, or asks for newer parameters first."""
        too_many = self._newest.window <= self._sender.in_flight
        return too_many or self._learner.store.version < self._sender.required_version

    def _too_old(self) -> str:
        """Return why the actors are too old to collect with, or an empty text."""
        learner, config = self._learner, self._config
        lag = learner.newest_version - learner.store.version
        if 0 < config.max_lag_versions < lag and learner.store.epoch == learner.epoch:
            return f"its actors are {lag} versions old, more than {config.max_lag_versions}"
        if 0 < config.max_silence_seconds < learner.silence:
            return f"the learner has been silent for {learner.silence:.0f} s"
        return ""
