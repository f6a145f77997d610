"""The Hungarian assignment: shortest augmenting paths (Jonker and Volgenant) on a rectangular cost matrix.

The scan order is that of `scipy.optimize.linear_sum_assignment` (Crouse 2016), so that ties break the same way.
"""

import math

from eia_sec.rollout.sim.kernel.compiler.decorators import allocation_free
from eia_sec.rollout.sim.kernel.constants import Array, Indices


@allocation_free
def _augment(
    cost: Array, columns: int, numbers: Array, owner: Indices, path: Indices, reached: Indices, todo: Indices, row: int
) -> tuple[int, float]:
    """Grow the shortest path tree from a free row to a free column; return that column and the path's length."""
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


@allocation_free
def assign(cost: Array, rows: int, columns: int, numbers: Array, indices: Indices, chosen: Indices) -> None:
    """Assign each row its own column with the least total cost.

    Args:
        cost: [R, C] or larger, finite.
        rows: R, at most C.
        columns: C.
        numbers: [3, C] or larger, scratch.
        indices: [4, C] or larger, scratch.
        chosen: [R] or larger; out: the column of each row.
    """
    u, v, shortest = numbers[0], numbers[1], numbers[2]
    owner, path, reached, todo = indices[0], indices[1], indices[2], indices[3]
    for column in range(columns):
        u[column], v[column], owner[column] = 0.0, 0.0, -1
    for start in range(rows):
        sink, length = _augment(cost, columns, numbers, owner, path, reached, todo, start)
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
