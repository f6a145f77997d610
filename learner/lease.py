"""Which coordinator leads: the learner grants it, for a few seconds at a time, and applies nobody else's events."""

from dataclasses import dataclass

LEASE_SECONDS = 3.0
"""Time after its last claim for which a silent coordinator still leads."""


@dataclass
class Lease:
    """One holder at any time; whoever claims first has it until it has been silent for LEASE_SECONDS.

    The learner is the only place where events take effect, so two coordinators that both believe to lead cannot both
    be right: the one that was silent too long finds another holder here, and is refused.

    Attributes:
        holder: name and incarnation of the leading coordinator, or None before the first.
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
        """Return whether this coordinator was the last to be granted the lease."""
        return self.holder == (name, incarnation)
