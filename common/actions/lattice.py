"""The formula of the lattice along an axis or both: on arrays, and compiled (`rollout/sim/core/lattice.py`) on numbers.

All numbers are float32, so that agents act alike wherever the formula is computed.
"""

from typing import Any, Final

import numpy as np

EDGE: Final = 1e-4
"""Rounding tolerance, as a share of a cell: an agent this close below the next cell counts as inside it."""
ZERO: Final = np.float32(0)
HALF: Final = np.float32(0.5)
ONE: Final = np.float32(1)
TOLERANCE: Final = np.float32(EDGE)


def share_of(position: Any) -> Any:
    """Return places along a field that spans -1 to 1 as shares of it."""
    return (position + ONE) * HALF


def cell_at(share: Any, count: Any) -> Any:
    """Return which of so many equal cells hold shares of the field, whole numbers."""
    return np.minimum(np.maximum(np.floor(share * count + TOLERANCE), ZERO), count - ONE)


def cell_beside(cell: Any, step: Any, count: Any) -> Any:
    """Return the cells a step of -1, 0 or 1 on, where there are any."""
    return np.minimum(np.maximum(cell + step, ZERO), count - ONE)


def velocity_to(cell: Any, share: Any, count: Any, reach: Any, inset: Any) -> Any:
    """Return the velocities, shares of full speed, that lead to the nearest places so far inside cells.

    Args:
        cell: the cells.
        share: where the agents are, as shares of the field.
        count: cells along the field.
        reach: distance that full speed covers in a step, as a share of the field.
        inset: distance from a cell's border, as a share of the cell.
    """
    goal = np.minimum(np.maximum(share, (cell + inset) / count), (cell + (ONE - inset)) / count)
    return np.minimum(np.maximum((goal - share) / reach, -ONE), ONE)
