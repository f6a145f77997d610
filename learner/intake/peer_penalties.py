"""Workers that keep sending what brings nothing: counted by name, cut off for a while, and named.

A request brings nothing when it cannot be read or used, and also when it comes again or out of its turn. Honest workers
send such, on a bad road; but not many in a row.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

LIMIT: Final = 20
"""Bad requests in a row after which a worker is cut off."""
CUT_SECONDS: Final = 60.0
"""How long; afterwards it has one try, and a good one clears it."""
MOST_PEERS: Final = 256
"""Workers that are kept account of; beyond them the one that was bad longest ago is forgotten."""
NAMED: Final = 8
"""Workers that a report names."""


@dataclass
class _Account:
    total: int = 0
    row: int = 0
    reason: str = ""
    until: float | None = None


class PeerPenalties:
    """The account of bad requests, by the name in the key, which no certificate but the worker's own may use.

    Args:
        clock: seconds; for tests.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._accounts: dict[str, _Account] = {}
        self._forgotten = 0

    def bad(self, peer: str, reason: str) -> bool:
        """Book a bad request; return whether it is the one that cuts the peer off."""
        account = self._accounts.pop(peer, None) or _Account()
        self._accounts[peer] = account
        if len(self._accounts) > MOST_PEERS:
            self._forgotten += self._accounts.pop(next(iter(self._accounts))).total
        account.total += 1
        account.row += 1
        account.reason = reason[:200]
        cut = account.row >= LIMIT
        if cut:
            account.until = self._clock() + CUT_SECONDS
        return cut

    def good(self, peer: str) -> None:
        """Book a good request."""
        if (account := self._accounts.get(peer)) is not None:
            account.row, account.until = 0, None

    def refusal(self, peer: str) -> str | None:
        """Return what to answer to a peer that is cut off, or None when its requests are looked at."""
        account = self._accounts.get(peer)
        until = None if account is None else account.until  # another thread may be taking it away
        if account is None or until is None or self._clock() >= until:
            return None
        return f"worker {peer} is cut off after {account.row} bad requests in a row; the last: {account.reason}"

    def alarms(self) -> list[str]:
        """Return one sentence for each peer that is cut off now."""
        found = [text for peer in list(self._accounts) if (text := self.refusal(peer)) is not None]
        return found[:NAMED]

    def counts(self) -> dict[str, int]:
        """Return the bad requests of the worst peers by name, and of all others together."""
        worst = sorted(self._accounts.items(), key=lambda item: -item[1].total)
        counts = {peer: account.total for peer, account in worst[:NAMED]}
        rest = sum(account.total for _, account in worst[NAMED:]) + self._forgotten
        return {**counts, **({"(others)": rest} if rest else {})}
