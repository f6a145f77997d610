"""The assignment of UAVs to relays with capacities: from scratch, or by repairing the one before.

`assign` finds the optimum by shortest augmenting paths (Jonker and Volgenant) on a rectangular cost matrix. Its scan
order is that of `scipy.optimize.linear_sum_assignment` (Crouse 2016), so that ties break the same way.

`settle` repairs an assignment by exchanges, and proves that it is the unique optimum. The columns are the nodes of a
graph. The arc from a to b is the row of a that can move to b at the least extra cost. If the columns have more slots
than there are rows, one more node stands for the free slots: every column with a free slot has an arc to it, and it has
an arc to every column. An assignment is optimal if and only if no cycle has a negative cost (Klein 1967); it
is the unique optimum if every cycle has a positive cost. Bellman-Ford node prices prove both. If no prices exist, the
arcs that lowered them form a cycle, and exchanges along it improve the assignment.
"""

import math
from typing import Annotated, Final, NamedTuple

from eia_sec.rollout.sim.core.compile import allocation_free
from eia_sec.rollout.sim.core.records import Array, Indices

TIE: Final = 1e-9
"""Costs that differ by less count as equal when a solution is checked."""
MARGIN: Final = 2.0 * TIE
"""Amount by which every exchange is made cheaper, so that prices exist only if every cycle costs more than TIE."""


class Exchanges(NamedTuple):
    """Working memory of exchanges; a row is a served UAV, a column a relay, and the last node is the room."""

    load: Annotated[Indices, "n_c", "rows in each column"]
    head: Annotated[Indices, "n_c", "one of a column's rows, -1 if it has none"]
    next: Annotated[Indices, "served", "another row of the same column, -1 after the last"]
    cost: Annotated[Array, "n_c+1 n_c+1", "cost of moving one row from a column to another, less MARGIN"]
    mover: Annotated[Indices, "n_c n_c", "the row that would move"]
    price: Annotated[Array, "n_c+1", "price of a slot in each column"]
    source: Annotated[Indices, "n_c+1", "the node from which each price follows, -1 if none"]
    used: Annotated[Array, "n_c+1", "the price from which others were last derived"]
    mark: Annotated[Indices, "n_c+1", "marks of the search for cycles"]


class AssignmentScratch(NamedTuple):
    """Working memory of the assignment; relays have so many slots together."""

    pair: Annotated[Array, "served n_c", "cost of each pair"]
    exchanges: Exchanges
    cost: Annotated[Array, "served slots", "cost of each UAV in each slot of a relay; L is the largest number of slots"]
    numbers: Annotated[Array, "3 slots", "scratch"]
    indices: Annotated[Indices, "4 slots", "scratch"]


@allocation_free
def settle(pair: Array, chosen: Indices, capacity: int, work: Exchanges) -> bool:
    """Improve an assignment until no cycle of exchanges helps; return whether it is the unique optimum.

    Args:
        pair: [R, C] cost of each row in each column.
        chosen: [R] column of each row, within capacity, or -1 for a row that stays out; updated in place.
        capacity: capacity of each column.
        work: scratch.
    """
    columns = len(work.load)
    held = _list_rows(chosen, work)
    nodes = columns + (1 if columns * capacity > held else 0)
    for column in range(columns):
        _find_exchanges(pair, capacity, work, column, nodes)
    for node in range(nodes):
        work.price[node], work.used[node], work.source[node] = 0.0, math.inf, -1
    for _ in range(8 * nodes):
        if not _lower_prices(work, nodes):
            return True
        if not _improve(pair, chosen, capacity, work, nodes):
            return False
    return False


@allocation_free
def _list_rows(chosen: Indices, work: Exchanges) -> int:
    """List each column's rows; return their number."""
    held = 0
    for column in range(len(work.load)):
        work.load[column], work.head[column] = 0, -1
    for row in range(len(chosen)):
        column = chosen[row]
        if column >= 0:
            work.next[row], work.head[column] = work.head[column], row
            work.load[column] += 1
            held += 1
    return held


@allocation_free
def _find_exchanges(pair: Array, capacity: int, work: Exchanges, column: int, nodes: int) -> None:
    """Find the least cost of moving one row from a column to each other, and the arcs between column and room."""
    columns, has_room = len(work.load), work.load[column] < capacity
    cost, mover = work.cost[column], work.mover[column]
    for other in range(nodes):
        cost[other] = math.inf
    row = work.head[column]
    while row >= 0:
        costs = pair[row]
        own = costs[column] + MARGIN
        for other in range(columns):
            change = costs[other] - own
            less = change < cost[other]
            cost[other] = change if less else cost[other]
            mover[other] = row if less else mover[other]
        row = work.next[row]
    cost[column] = math.inf
    if nodes > columns:
        cost[columns] = 0.0 if has_room else math.inf
        work.cost[columns, column] = 0.0 if has_room else -MARGIN
        work.cost[columns, columns] = math.inf


@allocation_free
def _lower_prices(work: Exchanges, nodes: int) -> bool:
    """Lower prices that exceed another price plus the cost of the exchange; return whether any node was examined."""
    looked = False
    for node in range(nodes):
        price, costs = work.price[node], work.cost[node]
        if price < work.used[node]:
            work.used[node], looked = price, True
            for other in range(nodes):
                reached = price + costs[other]
                less = reached < work.price[other]
                work.price[other] = reached if less else work.price[other]
                work.source[other] = node if less else work.source[other]
    return looked


@allocation_free
def _improve(pair: Array, chosen: Indices, capacity: int, work: Exchanges, nodes: int) -> bool:
    """Make the exchanges of every cycle that lowered prices; return False if one of them saves nothing."""
    found = False
    for node in range(nodes):
        work.mark[node] = -1
    for start in range(nodes):
        node = start
        while node >= 0 and work.mark[node] < 0:
            work.mark[node] = start
            node = work.source[node]
        if node >= 0 and work.mark[node] == start:
            if not _go_round(chosen, work, node):
                return False
            found = True
    if found:
        _list_rows(chosen, work)
        for node in range(nodes):
            work.source[node] = -1
            if work.mark[node] == len(work.mark):
                work.used[node] = math.inf
                if node < len(work.load):
                    _find_exchanges(pair, capacity, work, node, nodes)
    return True


@allocation_free
def _go_round(chosen: Indices, work: Exchanges, last: int) -> bool:
    """Make the exchanges of the cycle through a node, and mark its nodes; return False if that saves nothing."""
    columns, saved, node = len(work.load), 0.0, last
    while True:
        source = work.source[node]
        saved -= work.cost[source, node] + MARGIN if source < columns and node < columns else 0.0
        node = source
        if node == last:
            break
    if saved < TIE:
        return False
    while True:
        source = work.source[node]
        if source < columns and node < columns:
            chosen[work.mover[source, node]] = node
        work.mark[node] = len(work.mark)
        node = source
        if node == last:
            return True


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
