"""The compiler's pass that removes copies of variables."""

import numba
import numpy as np
import pytest
from numba.core import ir
from numba.core.compiler_machinery import FunctionPass, register_pass

from eia_sec.rollout.sim.core.copies import Compiler, RemoveCopies

LEFT: list[list[str]] = []
"""The copies in each function that `Plain` or `Watching` compiled."""


@register_pass(mutates_CFG=False, analysis_only=True)
class CountCopies(FunctionPass):
    """Notes the variables that copy others."""

    _name = "count_copies"

    def __init__(self):
        FunctionPass.__init__(self)

    def run_pass(self, state):
        """Note them, and change nothing."""
        every = [s for block in state.func_ir.blocks.values() for s in block.find_insts(ir.Assign)]
        LEFT.append([s.target.name for s in every if isinstance(s.value, ir.Var)])
        return False


class Plain(Compiler):
    """Numba's own compiler, which notes the copies that are left."""

    added = (CountCopies,)


class Watching(Compiler):
    """The simulator's compiler, which notes the copies that are left."""

    added = (RemoveCopies, CountCopies)


def swap(turns):
    """Return the first of two numbers that change places."""
    a, b = 1, 2
    for _ in range(turns):
        a, b = b, a
    return a


def before_the_last(turns):
    """Return the number before the last turn of a loop that is left at its end."""
    number = 0
    while True:
        old = number
        number = number + 1
        if number >= turns:
            break
    return 10 * old + number


def chosen(turns):
    """Return a variable that is assigned in one branch only."""
    kept = -1
    for k in range(turns):
        square = k * k
        if k % 2:
            kept = square
    return kept


def fibonacci(turns):
    """Return a Fibonacci number."""
    a, b = 0, 1
    for _ in range(turns):
        c = a
        a = b
        b = c + b
    return a


def changed(turns):
    """Return a copy of a variable that changes afterwards."""
    first = turns
    copy = first
    first = first + 1
    return 100 * copy + first


def overwritten(turns):
    """Return a sum of arrays one of which changes afterwards."""
    a, b = np.arange(3.0), np.full(3, float(turns))
    both, _ = a + b, a - b
    b[0] = 100.0
    return (both * 2.0).sum()


def read_twice(turns):
    """Return two uses of a sum of arrays."""
    a, b = np.arange(3.0), np.full(3, float(turns))
    both, _ = a + b, a - b
    double = both * 2.0
    return double[0] + both[1]


RESULTS = [swap, before_the_last, chosen, fibonacci, changed, overwritten, read_twice]


@pytest.mark.parametrize("function", RESULTS)
def test_results_stay(function):
    """Loops that hand values on, and arrays, give what Python gives."""
    compiled = numba.njit(pipeline_class=Compiler)(function)
    for turns in range(1, 9):
        assert compiled(turns) == function(turns)


def test_arguments_of_inlined_functions_are_not_copied():
    """A record that goes through functions that are inlined keeps one name."""

    @numba.njit(inline="always")
    def inner(record):
        return record[0] + record[1]

    @numba.njit(inline="always")
    def middle(record):
        return inner(record) * inner(record)

    names = []
    for pipeline in (Plain, Watching):
        outer = numba.njit(pipeline_class=pipeline)(lambda record: middle(record) + middle(record))
        assert outer((2, 3)) == 50
        names.append([name for name in LEFT[-1] if "record" in name])
    assert len(names[0]) >= 6
    assert names[1] == []
