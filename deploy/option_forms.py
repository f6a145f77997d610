"""How options are read and shown: tyro's rules for types, in the words of people who do not program in Python."""

import itertools
import re
import shlex
from collections.abc import Callable, Mapping, Sequence
from dataclasses import is_dataclass, replace
from types import NoneType, UnionType
from typing import Annotated, Any, Final, Union, get_args, get_origin

import tyro
from tyro.constructors import (
    ConstructorRegistry,
    PrimitiveConstructorSpec,
    PrimitiveTypeInfo,
    StructConstructorSpec,
    StructFieldSpec,
    StructTypeInfo,
)

from eia_sec.common.config import EnvConfig, EvaluationConfig, LearnerConfig, RunConfig, WorldConfig
from eia_sec.common.config.algorithms import ALGORITHM_CONFIGS, AlgorithmConfig
from eia_sec.common.config.farm.sites import Sites
from eia_sec.common.config.farm.stress import Areas
from eia_sec.common.config.farm.zones import Zones
from eia_sec.common.config.maps import FrozenMap
from eia_sec.common.config.plugin_names import PluginNames
from eia_sec.common.config.population import PopulationConfig
from eia_sec.common.spelling import did_you_mean

NUMBERS: Final = {int: "a whole number", float: "a number"}
WORDS: Final = {int: "NUMBER", float: "NUMBER", str: "TEXT"}
"""What help calls a value of a type."""
SHOWN: Final[Mapping[type, frozenset[str]]] = {
    RunConfig: frozenset(("seed", "episodes", "steps")),
    EnvConfig: frozenset(("name", "arguments")),
    WorldConfig: frozenset(("communication_uavs", "monitoring_uavs", "collection_uavs", "sensors", "steps")),
    AlgorithmConfig: frozenset(("name", "hidden", "actor_rate", "entropy_start", "start_policy", "memory")),
    LearnerConfig: frozenset(("device",)),
    EvaluationConfig: frozenset(("farms",)),
    PopulationConfig: frozenset(("members",)),
}
"""Settings that `--help` shows; `--help-all` shows the others, too. Of sections without an entry it shows none."""


def registry(*, most_used: bool) -> ConstructorRegistry:
    """Return the rules.

    Args:
        most_used: hide the settings of a run that few set; they are read all the same.
    """
    found = ConstructorRegistry()
    inside: list[type] = []

    @found.struct_rule
    def section(info: StructTypeInfo) -> StructConstructorSpec | None:
        if info.type in (Sites, Zones, Areas, PluginNames):  # `--farm-file` and `--plugin` set them
            return StructConstructorSpec(lambda: info.default, ())
        if not is_dataclass(info.type) or info.type in inside:
            return None
        inside.append(info.type)
        try:
            spec = ConstructorRegistry.get_struct_spec(info)
        finally:
            inside.pop()
        if not isinstance(spec, StructConstructorSpec):
            return None
        shown = _shown(info.type) if most_used else None
        algorithm = issubclass(info.type, AlgorithmConfig)
        return replace(spec, fields=tuple(_field(one, shown, algorithm=algorithm) for one in spec.fields))

    for rule in (_map_rule, _number_rule, _text_rule, _optional_rule):
        found.primitive_rule(rule)
    return found


def _shown(section: type) -> frozenset[str] | None:
    """Return which settings of a section are shown; None for all, as of a command's own options."""
    for kind, names in SHOWN.items():
        if issubclass(section, kind):
            return names
    return frozenset() if section.__module__.startswith(RunConfig.__module__.rpartition(".")[0]) else None


def _field(field: StructFieldSpec, shown: frozenset[str] | None, *, algorithm: bool) -> StructFieldSpec:
    """Return an option with its default in words; hidden if it is not among those shown."""
    if _holds_section(field.type):
        return field
    kind: Any = Annotated[field.type, tyro.conf.arg(help_behavior_hint=_default)]
    if algorithm and field.name == "name":  # the section's class has its own name only
        kind = Annotated[kind, tyro.conf.arg(metavar="|".join(ALGORITHM_CONFIGS))]
    if shown is not None and field.name not in shown:
        kind = Annotated[kind, tyro.conf.Suppress]
    return replace(field, type=kind)


def _holds_section(kind: Any) -> bool:
    inner = get_args(kind)[0] if get_origin(kind) is Annotated else kind
    return is_dataclass(inner) or (
        get_origin(inner) in (Union, UnionType) and any(map(_holds_section, get_args(inner)))
    )


def _default(text: str) -> str:
    """Return what help says about a default."""
    if text in ("None", "False", "", "''"):
        return ""
    return f"(default: {'on' if text == 'True' else text})"


def _map_rule(info: PrimitiveTypeInfo) -> PrimitiveConstructorSpec[Mapping[str, Any]] | None:
    """Read a map as KEY=VALUE ..., each an argument of its own."""
    if info.type_origin is not Mapping:
        return None
    value = get_args(info.type)[1]
    span = get_origin(value) is tuple

    def read(words: list[str]) -> Mapping[str, Any]:
        pairs = [word.partition("=") for word in words]
        if not all(key and equals for key, equals, _ in pairs):
            raise ValueError("needs entries KEY=VALUE, with spaces between")
        if span:
            return FrozenMap({key: _span(text) for key, _, text in pairs})
        return FrozenMap({key: _number(value, text) if value in NUMBERS else text for key, _, text in pairs})

    def written(entries: Mapping[str, Any]) -> list[str]:
        return [f"{key}={':'.join(map(str, entry)) if span else entry}" for key, entry in entries.items()]

    word = "LOW:HIGH" if span else WORDS[value]
    return PrimitiveConstructorSpec("*", f"[KEY={word} ...]", read, lambda held: isinstance(held, Mapping), written)


def _span(text: str) -> tuple[float, ...]:
    """Return the two numbers of LOW:HIGH."""
    return tuple(_number(float, part) for part in text.split(":"))


def _number(kind: Callable[[str], Any], text: str) -> Any:
    try:
        return kind(text)
    except ValueError:
        what = NUMBERS[int] if kind is int else NUMBERS[float]
        raise ValueError(f"must be {what}, not {text!r}") from None


def _number_rule(info: PrimitiveTypeInfo) -> PrimitiveConstructorSpec[Any] | None:
    if info.type not in NUMBERS:
        return None
    kind: Any = info.type
    return PrimitiveConstructorSpec(
        1,
        WORDS[kind],
        lambda words: _number(kind, words[0]),
        lambda held: type(held) is kind or ("~" if kind is float and type(held) is int else False),
        lambda held: [str(held)],
    )


def _text_rule(info: PrimitiveTypeInfo) -> PrimitiveConstructorSpec[str] | None:
    if info.type is not str:
        return None
    return PrimitiveConstructorSpec(
        1, WORDS[str], lambda words: words[0], lambda held: isinstance(held, str), lambda held: [held]
    )


def _optional_rule(info: PrimitiveTypeInfo) -> PrimitiveConstructorSpec[Any] | None:
    """Read what may be left out as what it is otherwise; `None` takes an earlier one back."""
    kinds = [kind for kind in get_args(info.type) if kind is not NoneType]
    if get_origin(info.type) not in (Union, UnionType) or len(kinds) != 1 or len(get_args(info.type)) != 2:
        return None
    inner = ConstructorRegistry.get_primitive_spec(PrimitiveTypeInfo.make(kinds[0], info.markers))
    if not isinstance(inner, PrimitiveConstructorSpec) or inner.nargs != 1:
        return None

    def read(words: list[str]) -> Any:
        if words == ["None"]:
            return None
        if inner.choices is not None and words[0] not in inner.choices:
            raise ValueError(_choice(words[0], inner.choices))
        return inner.instance_from_str(words)

    return PrimitiveConstructorSpec(
        1,
        inner.metavar,
        read,
        lambda held: held is None or inner.is_instance(held),
        lambda held: ["None"] if held is None else inner.str_from_instance(held),
    )


def _choice(given: str, choices: Sequence[str]) -> str:
    return f"must be one of {', '.join(map(shlex.quote, choices))}, not {given!r}{did_you_mean(given, choices)}"


def refusal(box: str, subcommands: Sequence[str]) -> str:
    """Return tyro's complaint about a command line, which it draws in a box, as one sentence without a full stop.

    Args:
        box: the complaint.
        subcommands: words of which a command needs one, or nothing.
    """
    # The first row is a title. Where the terminal knows no lines, a rule follows it, of hyphens.
    _, *rows = [*filter(None, (line.strip("│ ") for line in box.splitlines())), ""]
    rest = itertools.dropwhile(_is_rule, rows)
    reasons = list(itertools.takewhile(lambda row: not _is_rule(row), rest))
    reason = " ".join(reasons).rstrip(".") or "invalid command line"
    if unknown := re.match(r"Unrecognized options: ([^,]+)", reason):
        word = unknown[1].strip()
        if not word.startswith("-"):
            return f"{word!r} was not expected{did_you_mean(word, subcommands)}"
        lines = [row for row in rows if row.startswith("--") and not _is_rule(row)]
        return f"there is no option {word}" + (f"; did you mean {lines[0].split()[0]}?" if lines else "")
    if reason.startswith("Missing from"):
        missing = [found[1] for row in reasons[1:] if (found := re.match(r"(--[\w.-]+(?= |$)|[A-Z_]+(?=  |$))", row))]
        return f"missing: {', '.join(missing)}"
    if subcommands and reason.startswith("Expected one of"):
        return f"missing: one of {', '.join(subcommands)}"
    if wrong := re.match(r"invalid choice '(.*)' for argument '(.*)'\. Expected one of \((.*)\)", reason):
        choices = re.findall("'([^']*)'", wrong[3])
        return f"{wrong[2]} {_choice(wrong[1], choices)}"
    return re.sub(r"^Error parsing ([^:]*): ", lambda found: f"{found[1]} ", reason)


def _is_rule(row: str) -> bool:
    return not row.strip("─-╰╯")
