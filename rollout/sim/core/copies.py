"""A pass of the compiler that removes copies of variables.

Inlining a function gives each of its arguments one more name. Records of some hundred arrays are arguments of nearly
every function here, and LLVM takes them apart name by name, which took most of the time to compile.
"""

from collections import Counter
from collections.abc import Sequence
from typing import Any

from numba.core import ir
from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.core.compiler_machinery import FunctionPass, register_pass
from numba.core.ir_utils import build_definitions, replace_vars
from numba.core.postproc import PostProcessor
from numba.core.untyped_passes import ReconstructSSA


@register_pass(mutates_CFG=False, analysis_only=False)
class RemoveCopies(FunctionPass):
    """Replaces variables that only copy another one by that one.

    Both must be assigned once, so that the other one has its value wherever the copy does. Copies of phis stay, and
    copies that phis take. A phi becomes assignments at the ends of the blocks before it, one after another. They would
    change what a copy still holds: one variable of a swap, or the value before the last turn of a loop.

    Copies of temporary results stay, too: Numba reads each of those once, and joins the arithmetic of arrays so. The
    pass does not see names in `print(*names)`, and `locals=` of a function would lose the type that it gives a copy.
    """

    _name = "remove_copies"

    def __init__(self) -> None:
        FunctionPass.__init__(self)

    def run_pass(self, state: Any) -> bool:
        """Change the function; return whether anything was copied."""
        blocks = state.func_ir.blocks
        copied = _copies([statement for block in blocks.values() for statement in block.find_insts(ir.Assign)])
        for block in blocks.values():
            block.body = [s for s in block.body if not (isinstance(s, ir.Assign) and s.target.name in copied)]
        replace_vars(blocks, {name: _origin(name, copied) for name in copied})
        state.func_ir._definitions = build_definitions(blocks)
        PostProcessor(state.func_ir).run(emit_dels=False)
        return bool(copied)


def _copies(assignments: Sequence[Any]) -> dict[str, Any]:
    """Return what each copy that can be removed copies, by the copy's name."""
    assigned = Counter(statement.target.name for statement in assignments)
    phis = [s for s in assignments if isinstance(s.value, ir.Expr) and s.value.op == "phi"]
    kept = {value.name for phi in phis for value in phi.value.incoming_values if isinstance(value, ir.Var)}
    fixed = {phi.target.name for phi in phis}
    fixed |= {s.target.name for s in assignments if s.target.is_temp and isinstance(s.value, ir.Expr)}
    return {
        statement.target.name: statement.value
        for statement in assignments
        if isinstance(statement.value, ir.Var)
        and assigned[statement.target.name] == assigned[statement.value.name] == 1
        and statement.target.name not in kept
        and statement.value.name not in fixed
    }


def _origin(name: str, copied: dict[str, Any]) -> Any:
    """Return the variable that the last of a chain of copies copies."""
    origin = copied[name]
    while origin.name in copied:
        origin = copied[origin.name]
    return origin


class Compiler(CompilerBase):
    """Numba's own compiler with passes of ours after the reconstruction of static single assignments."""

    added: tuple[type[FunctionPass], ...] = (RemoveCopies,)

    def define_pipelines(self) -> list[Any]:
        """Return the passes of compilation without Python objects."""
        passes = DefaultPassBuilder.define_nopython_pipeline(self.state)
        for each in reversed(self.added):
            passes.add_pass_after(each, ReconstructSSA)
        passes.finalize()
        return [passes]
