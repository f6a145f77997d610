"""The entries of docs/reference/configuration.md, from the dataclasses in `eia_sec.common.config` and the presets."""

import ast
import dataclasses
import inspect
import textwrap
from collections.abc import Iterator, Mapping
from operator import attrgetter
from typing import Any, Literal, get_args, get_origin, get_type_hints

from eia_sec.common.config import ALGORITHM_CONFIGS, AlgorithmConfig, RunConfig
from eia_sec.common.config.ablations import ABLATIONS
from eia_sec.common.config.algorithms import OPTIONAL_SECTIONS
from eia_sec.common.config.farm.sites import Sites
from eia_sec.common.config.farm.stress import Areas
from eia_sec.common.config.farm.zones import Zones
from eia_sec.common.config.files import format_value
from eia_sec.common.config.plugin_names import PluginNames
from eia_sec.common.config.presets import PRESETS

_ALGORITHM = """`name` selects the algorithm, and with it the options of this section; an option of another algorithm is
refused. The ablations of EIA-SEC are presets as well, `eia-sec` with one or two switches: `eia`
(`ensemble = false`), `sec` (`elite.enabled = false`) and `base` (both).
"""
SHOWN = {name: config for name, config in PRESETS.items() if name not in ABLATIONS}
"""Presets that the tables compare; the ablations are told in words."""


def field_docs(section: type[Any]) -> dict[str, str]:
    """Return the docstring that stands under each field of a dataclass, by field name, on one line."""
    docs: dict[str, str] = {}
    for base in reversed(section.__mro__):
        if inspect.get_annotations(base):
            docs |= _own_field_docs(base)
    return docs


def _own_field_docs(section: type[Any]) -> dict[str, str]:
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
    """Return one part for each section of the configuration, with one entry for each key.

    An entry has a heading of its own, by which the site's search finds it.
    """
    parts = []
    for name, section in sections(RunConfig()):
        if name == "algorithm":
            parts += _algorithm_tables()
            continue
        presets = {shown: config for shown, config in SHOWN.items() if _reads(config, name)}
        entries = [_entry(name, section, field.name, presets) for field in dataclasses.fields(section)]
        entries = [entry for entry in entries if entry]
        if entries:
            title = f"`[{name}]`" if name else "Top of the file"
            about = _about(type(section)) + _readers(name)
            parts.append(f"## {title}\n\n{about}\n\n" + "\n".join(entries))
    return "\n".join(parts)


def _reads(config: RunConfig, section: str) -> bool:
    """Return whether a configuration has a section, and its algorithm reads it."""
    if section.startswith("algorithm."):
        return hasattr(config.algorithm, section.removeprefix("algorithm."))
    return section not in config.unused_sections


def _about(section: type[Any]) -> str:
    """Return the first paragraph of a class's docstring on one line."""
    return " ".join((inspect.getdoc(section) or "").partition("\n\n")[0].split())


def _readers(name: str) -> str:
    """Return which algorithms read a section, where not all of them do."""
    if name not in OPTIONAL_SECTIONS:
        return ""
    return f" For {_listed([key for key, kind in ALGORITHM_CONFIGS.items() if name in kind.sections])}."


def _listed(names: list[str]) -> str:
    return ", ".join(f"`{name}`" for name in names)


def _algorithm_tables() -> Iterator[str]:
    """Yield the options that all algorithms share, and those that each class adds."""
    yield f"## `[algorithm]`\n\n{_ALGORITHM}"
    for owner in _declaring_classes():
        users = [name for name, kind in ALGORITHM_CONFIGS.items() if issubclass(kind, owner)]
        options = {field.name for field in dataclasses.fields(owner)}  # class variables are none
        hints = get_type_hints(owner)
        names = [field for field in inspect.get_annotations(owner) if field in options]
        fields = [field for field in names if not dataclasses.is_dataclass(hints[field])]
        if owner is not AlgorithmConfig:
            fields = [field for field in fields if field != "name"]
        presets = {name: config for name, config in SHOWN.items() if isinstance(config.algorithm, owner)}
        own = [_plain_entry(owner, field) for field in fields]
        section = next((config.algorithm for config in presets.values()), None)
        entries = own if section is None else [_entry("algorithm", section, field, presets) for field in fields]
        if entries:
            yield f"## `[algorithm]` of {_listed(users)}\n\n{_about(owner)}\n\n" + "\n".join(entries)


def _declaring_classes() -> list[type[Any]]:
    """Return every class that declares options of an algorithm, those that more algorithms share first."""
    lines = [reversed(kind.__mro__) for kind in ALGORITHM_CONFIGS.values()]
    return list(dict.fromkeys(owner for line in lines for owner in line if dataclasses.is_dataclass(owner)))


def _plain_entry(owner: type[Any], field: str) -> str:
    """Return the entry of an option that no preset's algorithm has."""
    default = next(entry.default for entry in dataclasses.fields(owner) if entry.name == field)
    kind = _type(get_type_hints(owner)[field])
    return _written(f"algorithm.{field}", kind, _value(default), field_docs(owner)[field], "")


def _entry(section_name: str, section: Any, field: str, presets: Mapping[str, RunConfig]) -> str:
    """Return one key's entry: its type, its value in the first preset, its meaning, and presets with another value.

    It is empty when the field is a section of its own.
    """
    if dataclasses.is_dataclass(getattr(section, field)):
        return ""
    key = f"{section_name}.{field}" if section_name else field
    values = {name: attrgetter(key)(config) for name, config in presets.items()}
    first = next(iter(values.values()))
    others: dict[str, list[str]] = {}
    for name, value in values.items():
        if value != first:
            others.setdefault(f"`{_value(value)}`" if _value(value) else "empty", []).append(name)
    differing = "; ".join(f"{value}: {', '.join(names)}" for value, names in others.items())
    kind = _type(get_type_hints(type(section))[field])
    if key == "algorithm.name":
        kind = " or ".join(f"`{name}`" for name in ALGORITHM_CONFIGS)
    return _written(key, kind, _value(first), field_docs(type(section))[field], differing)


def _written(key: str, kind: str, default: str, meaning: str, differing: str) -> str:
    value = f"`{default}`" if default else "empty"
    presets = f"\n\nPresets that differ: {differing}." if differing else ""
    return f"#### `{key}`\n\n{kind[0].upper()}{kind[1:]}, by default {value}. {meaning}{presets}\n"


def _value(value: Any) -> str:
    if isinstance(value, Mapping):
        return ", ".join(f"{key} = {entry}" for key, entry in value.items())
    return value if isinstance(value, str) else format_value(value)


_LISTS = {Sites: "list of places", Zones: "list of polygons", Areas: "list of [growth, polygon]"}


def _type(wanted: Any) -> str:
    if get_origin(wanted) is Literal:
        return " or ".join(f"`{choice}`" if choice != "" else "empty" for choice in get_args(wanted))
    if get_origin(wanted) is Mapping:
        entry = _type(get_args(wanted)[1])
        return f"table of {entry.replace('list', 'lists', 1) if entry.startswith('list') else f'{entry}s'}"
    if get_origin(wanted) is tuple:
        return _LISTS.get(wanted, f"list of {_type(get_args(wanted)[0])}s")
    if wanted is PluginNames:
        return "list of names"
    return {bool: "boolean", int: "integer", float: "number", str: "text"}[wanted]
