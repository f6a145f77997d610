"""The coordinators' lease: the learner grants it for a few seconds and applies only the holder's events."""

from dataclasses import dataclass

from eia_sec.common.imitation import LEASE_SECONDS


@dataclass
class Lease:
    """A lease with one holder at a time; the first claimant holds it until it is silent for LEASE_SECONDS.

    Imitation events take effect only in the learner. If two coordinators both believe that they lead, the learner
    refuses the one that was silent for too long.

    Attributes:
        holder: name and incarnation of the leading coordinator, or None before the first claim.
    """

    holder: tuple[str, int] | None = None
    _until: float = 0.0

    def claim(self, name: str, incarnation: int, now: float) -> bool:
        """Grant or extend the lease at a time in seconds; return whether the claimant leads."""
        if self.holder != (name, incarnation) and self.holder is not None and now < self._until:
            return False
        self.holder, self._until = (name, incarnation), now + LEASE_SECONDS
        return True

    def holds(self, name: str, incarnation: int) -> bool:
        """Return whether this coordinator was the last one to get the lease."""
        return self.holder == (name, incarnation)

    def current(self, now: float) -> bool:
        """Return whether its holder has claimed it in the last LEASE_SECONDS."""
        return self.holder is not None and now < self._until
