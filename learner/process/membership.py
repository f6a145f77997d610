"""The log of who joins and leaves a run."""

from typing import Final

from eia_sec.common.errors import ProtocolError
from eia_sec.common.log import log
from eia_sec.common.protocol import keys
from eia_sec.common.transport.bus import Bus

ENTRIES: Final = 50
"""Most entries of one call; a run of a thousand workers that ends together is summed up in one more."""


class Membership:
    """Logs every process of a run that appears or vanishes, by its liveliness token.

    Args:
        bus: the control lane.
        run: the run's name.

    Attributes:
        living: (role, name) of every process that lives now.
        malformed: tokens that were dropped because nothing could be read from their key.
    """

    def __init__(self, bus: Bus, run: str) -> None:
        self._tokens = bus.watch(keys.LIVE.pattern(run), 1024)
        self.living: set[tuple[str, str]] = set()
        self.malformed = 0

    @property
    def workers(self) -> int:
        """Return the number of workers that live now."""
        return sum(role == "rollout" for role, _ in self.living)

    def update(self) -> None:
        """Log what has changed since the last call, at most ENTRIES changes and the number of the others."""
        changes = []
        for sample in self._tokens.drain():
            try:
                found = keys.parse(sample.key).variables
            except ProtocolError:
                self.malformed += 1
                continue
            who = (found["role"], found["name"])
            if sample.present == (who in self.living):
                continue
            (self.living.add if sample.present else self.living.discard)(who)
            changes.append(f"{who[0]} {who[1]} {'joined' if sample.present else 'left'}.")
        for text in changes[:ENTRIES]:
            log(text)
        if len(changes) > ENTRIES:
            log(f"{len(changes) - ENTRIES} more processes joined or left; {len(self.living)} are here now.")
