"""Where a step's time goes: the simulator's own step, compiled with the processor's clock read after every stage."""

import ast
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numba
import numpy as np
from llvmlite import ir
from numba.core import cgutils, types
from numba.extending import intrinsic

import eia_sec.rollout.sim.core.step as kernel
from eia_sec.common.config import FarmConfig
from eia_sec.rollout.sim.batch import FarmBatch
from eia_sec.rollout.sim.core.compile import ALLOCATION_FREE

STAGED = ("_move", "_serve", "_observe")
"""Functions whose calls are the stages, in the order in which a step calls them."""
STAGES = 40
PLACE = np.zeros(STAGES + 1, np.int64)
"""Cycles spent in each stage, and the clock when the last stage ended."""
ADDRESS: int = PLACE.ctypes.data


@intrinsic
def _cycles(typing: Any) -> Any:
    """Return the processor's cycle counter."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        kind = ir.FunctionType(ir.IntType(64), [])
        return builder.call(cgutils.get_or_insert_function(builder.module, kind, "llvm.readcyclecounter"), [])

    return types.int64(), generate


@intrinsic
def _write(typing: Any, address: Any, value: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        builder.store(arguments[1], builder.inttoptr(arguments[0], ir.IntType(64).as_pointer()))
        return context.get_dummy_value()

    return types.void(types.int64, types.int64), generate


@intrinsic
def _read(typing: Any, address: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.load(builder.inttoptr(arguments[0], ir.IntType(64).as_pointer()))

    return types.int64(types.int64), generate


@numba.njit(**ALLOCATION_FREE)
def _tick(stage: int) -> None:
    """End a stage; a negative one only begins the first."""
    now, last = _cycles(), ADDRESS + 8 * STAGES
    if stage >= 0:
        _write(ADDRESS + 8 * stage, _read(ADDRESS + 8 * stage) + now - _read(last))
    _write(last, _cycles())


def _called(statement: ast.stmt) -> str:
    """Return the name of the function that a statement calls, "" if none."""
    calls = [
        node.func.id for node in ast.walk(statement) if isinstance(node, ast.Call) and isinstance(node.func, ast.Name)
    ]
    return calls[0] if calls else ""


def _ticking(statements: Sequence[ast.stmt], stages: list[str]) -> list[ast.stmt]:
    """Return statements with a tick after each that calls a function; the stages' names are appended."""
    body = list[ast.stmt]()
    for statement in statements:
        body.append(statement)
        if isinstance(statement, ast.If):
            statement.body = _ticking(statement.body, stages)
            statement.orelse = _ticking(statement.orelse, stages)
        elif name := _called(statement):
            body += ast.parse(f"_tick({len(stages)})").body
            stages.append(name.strip("_"))
    return body


def instrumented() -> tuple[str, list[str]]:
    """Return the source of the instrumented simulator, and the stage that each tick ends.

    Raises:
        LookupError: the simulator's own step has no function of a name in STAGED any more.
    """
    module, stages = ast.parse(Path(kernel.__file__).read_text()), list[str]()
    functions = {node.name: node for node in module.body if isinstance(node, ast.FunctionDef)}
    if missing := [name for name in STAGED if name not in functions]:
        raise LookupError(f"the simulator's step has no {', '.join(missing)}; name its stages in STAGED.")
    for name in STAGED:
        functions[name].body = _ticking(functions[name].body, stages)
    functions[STAGED[0]].body.insert(0, ast.parse("_tick(-1)").body[0])
    return ast.unparse(ast.fix_missing_locations(module)).replace("@allocation_free_entry", "@allocation_free"), stages


def _compiled(source: str) -> Any:
    """Return the entrance of an instrumented simulator."""
    names: dict[str, Any] = {"_tick": _tick, "__name__": "instrumented"}
    exec(compile(source, "instrumented step", "exec"), names)  # our own source, read from beside this file
    return names["step_range"]


def stage_shares(config: FarmConfig, environments: int) -> dict[str, float]:
    """Return each stage's share of a step, over an episode of a batch."""
    source, stages = instrumented()
    step_range = _compiled(source)
    batch = FarmBatch(config, environments)
    random = np.random.default_rng(0)
    for _ in range(2):
        for index in range(environments):
            batch.reset(index, index, 0)
        PLACE[:] = 0
        for _ in range(config.world.steps):
            batch._action[...] = random.uniform(-1.0, 1.0, batch._action.shape)
            step_range(batch._arguments[0].address, 0, environments, False, kernel.STEP)
    cycles = dict.fromkeys(stages, 0.0)
    for name, count in zip(stages, PLACE.tolist(), strict=False):
        cycles[name] += count
    total = sum(cycles.values())
    return {name: count / total for name, count in cycles.items()}
