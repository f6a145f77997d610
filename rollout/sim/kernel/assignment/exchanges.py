"""Repair of an assignment with capacities by exchanges, and the proof that it is the unique optimum.

The columns are the nodes of a graph. The arc from a to b is the row of a that can move to b at the least extra cost. If
the columns have more slots than there are rows, one more node, the room, stands for the free slots: every column with a
free slot has an arc to it, and it has an arc to every column. An assignment is optimal if and only if no cycle has a
negative cost (Klein 1967); it is the unique optimum if every cycle has a positive cost. Bellman-Ford node prices prove
both. If no prices exist, the arcs that lowered them form a cycle, and exchanges along it improve the assignment.
"""

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from eia_sec.rollout.sim.kernel.compiler.decorators import allocation_free

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

TIE: Final = 1e-9
"""Costs that differ by less count as equal when a solution is checked."""
MARGIN: Final = 2.0 * TIE
"""Amount by which every exchange is made cheaper, so that prices exist only if every cycle costs more than TIE."""


class Exchanges(NamedTuple):
    """Working memory for R rows and C columns; the last node is the room.

    Attributes:
        load: [C] rows in each column.
        head: [C] one of a column's rows, -1 if it has none.
        next: [R] another row of the same column, -1 after the last.
        cost: [C + 1, C + 1] cost of moving one row from a column to another, less MARGIN.
        mover: [C, C] the row that would move.
        price: [C + 1] price of a slot in each column.
        source: [C + 1] the node from which each price follows, -1 if none.
        used: [C + 1] the price from which others were last derived.
        mark: [C + 1] marks of the search for cycles.
    """

    load: Indices
    head: Indices
    next: Indices
    cost: Array
    mover: Indices
    price: Array
    source: Indices
    used: Array
    mark: Indices


def make_exchanges(rows: int, columns: int) -> Exchanges:
    """Allocate the working memory."""
    nodes = columns + 1
    return Exchanges(
        load=np.zeros(columns, np.int64),
        head=np.zeros(columns, np.int64),
        next=np.zeros(rows, np.int64),
        cost=np.zeros((nodes, nodes)),
        mover=np.zeros((columns, columns), np.int64),
        price=np.zeros(nodes),
        source=np.zeros(nodes, np.int64),
        used=np.zeros(nodes),
        mark=np.zeros(nodes, np.int64),
    )


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
