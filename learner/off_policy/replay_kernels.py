"""The replay buffer's compiled kernels, for index sets and for the small arrays beside the ring of rows."""

from typing import cast

import numba
import numpy as np
from numpy.typing import NDArray

from eia_sec.common.transitions import TRANSITION
from eia_sec.learner.networks.compilation import Function
from eia_sec.learner.networks.compiled import Table


def compiled(function: Function) -> Function:
    """Compile a function that keeps Python's lock: releasing and regaining it would take longer than the function."""
    return cast(Function, numba.njit(error_model="numpy", cache=True)(function))


@compiled
def put_in(places: Table, slot: Table, count: int, new: Table) -> int:
    """Append indices to the `count` first of a set's array, and note the slot of each; return the new count."""
    for n in range(new.shape[0]):
        places[count + n] = new[n]
        slot[new[n]] = count + n
    count += new.shape[0]
    return count


@compiled
def take_out(places: Table, slot: Table, count: int, gone: Table) -> int:
    """Remove those indices that are in a set, and fill each hole with the last one; return the new count."""
    for n in range(gone.shape[0]):
        hole = slot[gone[n]]
        if hole >= 0:
            count -= 1
            last = places[count]
            places[hole], slot[last] = last, hole
            slot[gone[n]] = -1
    return count


@compiled
def enter(
    flags: NDArray[np.uint8],
    starts: Table,
    held: Table,
    version: int,
    written: int,
    flag: NDArray[np.uint8],
    versions: Table,
    successor: Table,
    uses: Table,
) -> tuple[Table, Table, Table, int, int]:
    """Enter a chunk's rows into the small arrays beside the ring.

    Args:
        flags: the chunk's flags.
        starts: its rows whose observations are already in the ring, in order.
        held: the running number of each of these rows in the ring.
        version: policy version of the chunk.
        written: rows ever written into the ring, which is the running number of the next row.
        flag: the ring's flags; changed in place, like the arrays below.
        versions: policy versions.
        successor: index of each row's successor.
        uses: how often each row was drawn.

    Returns:
        The running numbers of the chunk's rows; its new rows; the indices that may now be drawn; how many transitions
        were overwritten; how often these had been drawn.
    """
    rows, capacity = flags.shape[0], flag.shape[0]
    numbers, new = np.empty(rows, np.int64), np.empty(rows - starts.shape[0], np.int64)
    known, count = 0, 0
    for r in range(rows):
        if known < starts.shape[0] and starts[known] == r:
            numbers[r] = held[known]
            known += 1
        else:
            numbers[r], new[count] = written + count, r
            count += 1
    gone, total = 0, 0
    for r in new:
        place = numbers[r] % capacity
        if flag[place] & TRANSITION:
            gone += 1
            total += uses[place]
        uses[place] = 0
    drawable, steps = np.empty(rows, np.int64), 0
    for r in range(rows):
        place = numbers[r] % capacity
        flag[place], versions[place] = flags[r], version
        if flags[r] & TRANSITION:
            successor[place] = numbers[r + 1] % capacity
            drawable[steps] = place
            steps += 1
    return numbers, new, drawable[:steps], gone, total


@compiled
def exchange(places: Table, slot: Table, count: int, gone: Table, new: Table) -> int:
    """Remove indices from a set and append others, see `take_out` and `put_in`; return the new count."""
    return put_in(places, slot, take_out(places, slot, count, gone), new)
