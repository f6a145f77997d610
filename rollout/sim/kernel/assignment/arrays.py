"""The working memory of the assignment of UAVs to relays, allocated once."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from eia_sec.rollout.sim.kernel.assignment.exchanges import Exchanges, make_exchanges

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


class AssignmentScratch(NamedTuple):
    """Working memory of the assignment.

    Attributes:
        pair: [n_m + n_d, n_c] cost of each pair.
        exchanges: working memory of the exchanges between relays.
        cost: [n_m + n_d, L] cost of each UAV in each slot of a relay; L is the largest number of slots.
        numbers: [3, L] scratch.
        indices: [4, L] scratch.
    """

    pair: Array
    exchanges: Exchanges
    cost: Array
    numbers: Array
    indices: Indices


def make_assignment_scratch(served: int, relays: int, places: int) -> AssignmentScratch:
    """Allocate the working memory for so many served UAVs and relays, and slots of all relays together."""
    return AssignmentScratch(
        pair=np.zeros((served, relays)),
        exchanges=make_exchanges(served, relays),
        cost=np.zeros((served, places)),
        numbers=np.zeros((3, places)),
        indices=np.zeros((4, places), np.int64),
    )
