"""Incarnations: each start of a process gets a greater number than the one before, whatever the clock shows.

A start takes its number from the clock. If the receiver already knows a greater one, because the clock of an earlier
start was ahead, the new start takes a slightly greater number instead.
"""

import secrets
from typing import Final

from eia_sec.common.clock import microseconds
from eia_sec.common.errors import UsageError

LATEST: Final = 2**53
"""Greatest number that is taken from a clock: microseconds since 1970, in the year 2255."""
STRIDE: Final = 2**20
"""Greatest step beyond a known number. It is drawn at random, so that two simultaneous starts differ."""
LIMIT: Final = 2**63
"""First number that no message can carry."""


def new_incarnation(known: int = 0) -> int:
    """Return the incarnation of a new start.

    Args:
        known: the greatest number of an earlier start of the same name, 0 for none.

    Raises:
        UsageError: no greater number is left.
    """
    now = min(microseconds(), LATEST)
    number = now if now > known else known + 1 + secrets.randbelow(STRIDE)
    if number >= LIMIT:
        raise UsageError(f"an earlier start of this name has the number {known}, and no greater one is left.")
    return number


def plausible(number: int, known: int) -> bool:
    """Return whether an honest start can have this number; `known` is the greatest one seen so far, or 0.

    The bound keeps a hostile sender from using up all numbers of a name at once.
    """
    return number <= max(LATEST, known + STRIDE)


def seconds_ahead(known: int) -> float:
    """Return how many seconds the clock behind a number is ahead of this machine's; 0 when it is not."""
    return max(0.0, (known - microseconds()) / 1e6)
