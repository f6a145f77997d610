"""The Hungarian assignment: shortest augmenting paths (Jonker and Volgenant) on a rectangular cost matrix.

The scan order is that of `scipy.optimize.linear_sum_assignment` (Crouse 2016), so that ties fall alike.
"""

import math
from typing import Final

from rollout.kernel.compiled import sealed
from rollout.kernel.constants import Array, Indices

TIE: Final = 1e-9
"""Costs that differ by less count as equal when a solution is checked."""


@sealed
def settle(pair: Array, chosen: Indices, capacity: int, load: Indices, exchange: Array, mover: Indices) -> bool:
    """Improve an assignment with capacities by moves and swaps; return whether it is now the only best one.

    It is, when no round of rows that hand over their places costs nothing or less (Klein 1967): every cycle of
    exchanges between columns, and every path of them that ends at a column with room, has a cost above 0.

    Args:
        pair: [R, C] cost of each row in each column.
        chosen: [R] column of each row, no column with more than its capacity; updated.
        capacity: of each column.
        load: [C] scratch.
        exchange: [C, C] scratch: the least cost of moving one row from a column to another, in the end by any way.
        mover: [C, C] scratch: which row that is.
    """
    columns = len(load)
    _exchanges(pair, chosen, load, exchange, mover)
    while _improve(chosen, capacity, load, exchange, mover):
        _exchanges(pair, chosen, load, exchange, mover)
    for by in range(columns):
        for a in range(columns):
            first = exchange[a, by]
            for b in range(columns):
                change = first + exchange[by, b]
                exchange[a, b] = change if change < exchange[a, b] else exchange[a, b]
    for a in range(columns):
        for b in range(columns):
            if exchange[a, b] <= TIE and (a == b or load[b] < capacity):
                return False
    return True


@sealed
def _exchanges(pair: Array, chosen: Indices, load: Indices, exchange: Array, mover: Indices) -> None:
    """Find the least cost of moving one row from each column to each other, and the columns' loads."""
    columns = len(load)
    for a in range(columns):
        load[a] = 0
        for b in range(columns):
            exchange[a, b] = math.inf
    for row in range(len(chosen)):
        a = chosen[row]
        load[a] += 1
        for b in range(columns):
            change = pair[row, b] - pair[row, a] if b != a else math.inf
            less = change < exchange[a, b]
            exchange[a, b] = change if less else exchange[a, b]
            mover[a, b] = row if less else mover[a, b]


@sealed
def _improve(chosen: Indices, capacity: int, load: Indices, exchange: Array, mover: Indices) -> bool:
    """Make the move to a column with room, or the swap, that saves most; return whether any saves more than TIE."""
    columns, least, one, other = len(load), -TIE, -1, -1
    for a in range(columns):
        for b in range(columns):
            change = exchange[a, b] + (0.0 if load[b] < capacity else exchange[b, a])
            if change < least:
                least, one, other = change, a, b
    if one < 0:
        return False
    there, back = mover[one, other], mover[other, one]
    if load[other] == capacity:
        chosen[back] = one
    chosen[there] = other
    return True


@sealed
def _augment(
    cost: Array, numbers: Array, owner: Indices, path: Indices, reached: Indices, todo: Indices, row: int
) -> tuple[int, float]:
    """Grow the shortest path tree from a free row to a free column; return that column and the path's length."""
    columns = cost.shape[1]
    u, v, shortest = numbers[0], numbers[1], numbers[2]
    length, left, sink = 0.0, columns, -1
    for column in range(columns):
        todo[column] = columns - column - 1
        shortest[column] = math.inf
        reached[column] = 0
    while sink < 0:
        best, lowest = 0, math.inf
        for k in range(left):
            column = todo[k]
            reduced = length + cost[row, column] - u[row] - v[column]
            if reduced < shortest[column]:
                path[column], shortest[column] = row, reduced
            if shortest[column] < lowest or (shortest[column] == lowest and owner[column] < 0):
                best, lowest = k, shortest[column]
        length, column = lowest, todo[best]
        reached[column] = 1
        left -= 1
        todo[best] = todo[left]
        if owner[column] < 0:
            sink = column
        else:
            row = owner[column]
    return sink, length


@sealed
def assign(cost: Array, numbers: Array, indices: Indices, chosen: Indices) -> None:
    """Give each row a column of its own so that the sum of costs is least.

    Args:
        cost: [R, C] finite, R <= C.
        numbers: [3, C] scratch.
        indices: [4, C] scratch.
        chosen: [R] out: the column of each row.
    """
    rows, columns = cost.shape
    u, v, shortest = numbers[0], numbers[1], numbers[2]
    owner, path, reached, todo = indices[0], indices[1], indices[2], indices[3]
    for column in range(columns):
        u[column], v[column], owner[column] = 0.0, 0.0, -1
    for start in range(rows):
        sink, length = _augment(cost, numbers, owner, path, reached, todo, start)
        u[start] += length
        for column in range(columns):
            if reached[column] == 1:
                if owner[column] >= 0:
                    u[owner[column]] += length - shortest[column]
                v[column] -= length - shortest[column]
        column = sink
        while True:
            row = path[column]
            owner[column] = row
            column, chosen[row] = chosen[row], column
            if row == start:
                break
