"""Workers that send repeated invalid requests: counted by name, blocked for a while, and reported.

A request is invalid when it cannot be read or used, and also when it is repeated or out of order. On a bad network,
honest workers send some of these, but not many in a row.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from eia_sec.common.clock import monotonic

LIMIT: Final = 20
"""Invalid requests in a row after which a worker is blocked."""
BLOCK_SECONDS: Final = 60.0
"""Duration of a block; afterwards, a valid request ends it and an invalid one renews it."""
MOST_PEERS: Final = 256
"""Most workers with a count; beyond that, the one whose last invalid request is oldest is dropped."""
NAMED: Final = 8
"""Most workers that a report lists."""


@dataclass
class _Account:
    total: int = 0
    row: int = 0
    reason: str = ""
    until: float | None = None


class PeerPenalties:
    """Counts invalid requests by the name in the key, which only the worker's own certificate may use.

    Args:
        clock: returns monotonic seconds; tests replace it.
    """

    def __init__(self, clock: Callable[[], float] = monotonic) -> None:
        self._clock = clock
        self._accounts: dict[str, _Account] = {}
        self._forgotten = 0

    def bad(self, peer: str, reason: str) -> bool:
        """Count an invalid request; return whether it blocks the peer."""
        account = self._accounts.pop(peer, None) or _Account()
        self._accounts[peer] = account
        if len(self._accounts) > MOST_PEERS:
            self._forgotten += self._accounts.pop(next(iter(self._accounts))).total
        account.total += 1
        account.row += 1
        account.reason = reason[:200]
        blocked = account.row >= LIMIT
        if blocked:
            account.until = self._clock() + BLOCK_SECONDS
        return blocked

    def good(self, peer: str) -> None:
        """Note a valid request, which ends the row of invalid ones."""
        if (account := self._accounts.get(peer)) is not None:
            account.row, account.until = 0, None

    def refusal(self, peer: str) -> str | None:
        """Return the answer to a peer that is blocked, or None for one that is served."""
        account = self._accounts.get(peer)
        until = None if account is None else account.until  # another thread may clear it meanwhile
        if account is None or until is None or self._clock() >= until:
            return None
        return f"worker {peer} is blocked after {account.row} bad requests in a row; the last: {account.reason}"

    def alarms(self) -> list[str]:
        """Return one sentence for each peer that is blocked now."""
        found = [text for peer in list(self._accounts) if (text := self.refusal(peer)) is not None]
        return found[:NAMED]

    def counts(self) -> dict[str, int]:
        """Return the number of invalid requests of the worst peers by name, and of all others in total."""
        worst = sorted(self._accounts.items(), key=lambda item: -item[1].total)
        counts = {peer: account.total for peer, account in worst[:NAMED]}
        rest = sum(account.total for _, account in worst[NAMED:]) + self._forgotten
        return {**counts, **({"(others)": rest} if rest else {})}
