"""The tables of docs/reference/configuration.md, from the dataclasses in `common.config` and the presets."""

import ast
import dataclasses
import inspect
import textwrap
from collections.abc import Iterator
from typing import Any, Literal, get_args, get_origin, get_type_hints

from common.config import RunConfig
from common.config.files import flatten, format_value
from common.config.presets import PRESETS
from common.config.sites import Sites


def field_docs(section: type[Any]) -> dict[str, str]:
    """Return the docstring that stands under each field of a dataclass, by field name, on one line."""
    definition = ast.parse(textwrap.dedent(inspect.getsource(section))).body[0]
    assert isinstance(definition, ast.ClassDef)
    docs = {}
    for field, following in zip(definition.body, definition.body[1:], strict=False):
        match field, following:
            case (
                ast.AnnAssign(target=ast.Name(id=name)),
                ast.Expr(value=ast.Constant(value=str(text))),
            ):
                docs[name] = " ".join(text.split())
    return docs


def sections(config: Any, prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield every dataclass of a nested configuration with its dotted name, the outermost (named "") first."""
    yield prefix, config
    for field in dataclasses.fields(config):
        value = getattr(config, field.name)
        if dataclasses.is_dataclass(value):
            yield from sections(value, f"{prefix}.{field.name}" if prefix else field.name)


def configuration_tables() -> str:
    """Return one table for each section of the configuration, with one row for each key."""
    parts = []
    for name, section in sections(RunConfig()):
        rows = [_row(name, section, field.name) for field in dataclasses.fields(section)]
        rows = [row for row in rows if row]
        if rows:
            title = f"`[{name}]`" if name else "Top of the file"
            parts.append(
                f"## {title}\n\n{inspect.getdoc(type(section))}\n\n" + "\n".join([*_table_head(), *rows]) + "\n"
            )
    return "\n".join(parts)


def _table_head() -> list[str]:
    names = ["key", "type", *PRESETS, "meaning"]
    return [_cells(names), _cells(["---"] * len(names))]


def _row(section_name: str, section: Any, field: str) -> str:
    """Return one key's table row, or nothing when the field is a section of its own."""
    if dataclasses.is_dataclass(getattr(section, field)):
        return ""
    key = f"{section_name}.{field}" if section_name else field
    default = flatten(PRESETS["default"])[key]
    values = [flatten(config)[key] for config in PRESETS.values()]
    shown = [_value(value) if value == default else f"**{_value(value)}**" for value in values]
    kind = _type(get_type_hints(type(section))[field])
    return _cells([f"`{field}`", kind, *shown, field_docs(type(section))[field]])


def _value(value: Any) -> str:
    return value if isinstance(value, str) else format_value(value)


def _type(wanted: Any) -> str:
    if get_origin(wanted) is Literal:
        return " or ".join(f"`{choice}`" for choice in get_args(wanted))
    if wanted == Sites:
        return "list of places"
    if get_origin(wanted) is tuple:
        return "list of integers"
    return {bool: "boolean", int: "integer", float: "number", str: "text"}[wanted]


def _cells(cells: list[str]) -> str:
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"
