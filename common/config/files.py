"""Writes configurations as TOML, reads them over a base, compares them and computes their digest.

A section is a nested dataclass, for instance `[farm.world]`, or a map, for instance `[algorithm.discounts]`, and a key
is a field or an entry. A file may hold any part of the configuration; missing keys keep the base's values.
"""

import dataclasses
import difflib
import hashlib
import json
import re
import sys
import tomllib
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, Final, Literal, get_args, get_origin, get_type_hints

from eia_sec.common.config.algorithms import ALGORITHM_CONFIGS, AlgorithmConfig
from eia_sec.common.config.algorithms.network import NetworkConfig, network_named
from eia_sec.common.config.effect import without_effect
from eia_sec.common.config.environment import EnvConfig
from eia_sec.common.config.farm.polygons import MAX_CORNERS
from eia_sec.common.config.farm.sites import MAX_SENSORS, Sites
from eia_sec.common.config.farm.stress import MAX_AREAS, Area, Areas
from eia_sec.common.config.farm.zones import MAX_ZONES, Zones
from eia_sec.common.config.maps import without_entries
from eia_sec.common.config.plugin_names import PluginNames, require_loaded
from eia_sec.common.config.run import EvaluationConfig, LearnerConfig, RunConfig
from eia_sec.common.errors import ConfigError
from eia_sec.common.regular_files import read_regular_text

_TYPE_NAMES: Final = {bool: "true or false", int: "a whole number", float: "a number", str: "a text in quotes"}

FORMAT: Final = 2
"""Number of the form of a saved configuration.

It rises when an option is renamed or means something else, when a new one's default is not what versions without it
did, or when a default changes. An option that is gone is in GONE."""
_FORMAT_KEY: Final = "format"
GONE: Final[Mapping[str, int | float | str | list[float]]] = {
    "farm.reward.positioning": 1.0,
    "farm.reward.energy": 0.005,
    "farm.reward.collision_risk": 5.0,
    "farm.reward.boundary": 10.0,
    "farm.reward.monitoring": 2.0,
    "farm.reward.collection": 2.0,
    "farm.world.cycle_phase": "zero",
    "farm.energy.model": "printed",
    "farm.stress.radius": 60.0,
    "farm.stress.growth": 3,
    "farm.stress.seconds": 200.0,
    "farm.wind.direction": -1.0,
    "farm.dynamics.airspeed": [12.0],
}
"""Options of earlier releases that are constants now, with their values. Files may name them with these."""

Value = bool | int | float | str | PluginNames | tuple[float, ...] | tuple[tuple[float, ...], ...] | Zones | Areas
"""The value of an option."""

_KEY: Final = re.compile(r"[A-Za-z0-9_-]+(\.[A-Za-z0-9_-]+)*")
_BARE: Final = re.compile(r"[A-Za-z0-9_-]+")
"""A key of TOML that needs no quotes."""
_WORD: Final = re.compile(r"[A-Za-z][A-Za-z0-9_.:/+-]*")
"""A string that needs no quotes on a command line."""

WITH_MAPS: Final = ("env", "algorithm", "population")
"""Sections that hold maps."""

_LONG: Final = 8
"""Longest list that a message shows in full."""
_BUDGETS: Final = ("episodes", "steps")


def flatten(config: Any) -> dict[str, Value]:
    """Return every field of a nested configuration by its dotted key, in the order of declaration.

    Sections and options that the algorithm does not read are left out.
    """
    return {f"{section}.{name}" if section else name: value for section, name, value in _options(config)}


def plain_options(config: RunConfig) -> dict[str, bool | float | str]:
    """Return every option by its dotted key, for trackers: what is no number or truth value as TOML has it."""
    return {
        key: value if isinstance(value, bool | int | float | str) else format_value(value)
        for key, value in flatten(config).items()
    }


def _options(config: Any, prefix: str = "") -> Iterator[tuple[str, str, Value]]:
    """Yield the section, name and value of every field of a nested configuration, and of every entry of its maps."""
    unused = config.unused_sections if isinstance(config, RunConfig) else ()
    unused = config.unread if isinstance(config, AlgorithmConfig) else unused
    for field in dataclasses.fields(config):
        value, inner = getattr(config, field.name), f"{prefix}.{field.name}" if prefix else field.name
        if field.name in unused:
            continue
        if dataclasses.is_dataclass(value):
            yield from _options(value, inner)
        elif isinstance(value, Mapping):
            yield from ((inner, _key(key), entry) for key, entry in value.items())
        else:
            yield prefix, field.name, value


def _key(name: str) -> str:
    """Return a name as a key of TOML."""
    return name if _BARE.fullmatch(name) else json.dumps(name)


def to_toml(config: RunConfig) -> str:
    """Return the whole configuration as TOML; `read_saved` and `from_toml` return an equal one."""
    sections: dict[str, list[str]] = {"": []}
    for section, name, value in _options(config):
        sections.setdefault(section, []).append(f"{name} = {format_value(value)}")
    blocks = ["\n".join(([f"[{name}]"] if name else []) + lines) for name, lines in sections.items()]
    return f"{_FORMAT_KEY} = {FORMAT}\n" + "\n\n".join(blocks) + "\n"


def from_toml(source: str | Path, base: RunConfig) -> RunConfig:
    """Return the base with the values of a TOML text or file.

    Entries of a map are added to those of the base, and an empty map removes them. A text with a format number is that
    of `to_toml`: its maps are whole.

    Args:
        source: TOML text, or the path of a file that holds it.
        base: the values of keys that the source leaves out.

    Raises:
        ConfigError: the file cannot be read, is not TOML, has another format, names a key that is unknown or has no
            effect with the algorithm, or gives a key a value of the wrong type or out of range; of a file, its path
            comes first.
    """
    table = _table(source)
    try:
        return _merged(base, table)
    except ConfigError as error:
        if isinstance(source, Path):
            raise ConfigError(f"{source}: {error}") from None
        raise


def read_saved(source: str | Path) -> RunConfig:
    """Return the configuration that `to_toml` wrote, for instance of a run.

    An option that the text leaves out has its default, which does what versions without that option did.

    Args:
        source: TOML text, or the path of a file that holds it.

    Raises:
        ConfigError: see `from_toml`; or it leaves the format out.
    """
    table = _table(source)
    where = f"{source}: " if isinstance(source, Path) else ""
    if _FORMAT_KEY not in table:
        raise ConfigError(f"{where}a run's configuration names its {_FORMAT_KEY}, and this one does not.")
    try:
        return _merged(RunConfig(), table)
    except ConfigError as error:
        raise ConfigError(f"{where}{error}") from None


def _table(source: str | Path) -> dict[str, Any]:
    """Return the table of a TOML text or file."""
    text = _read(source) if isinstance(source, Path) else source
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        where = f"{source} is" if isinstance(source, Path) else "this is"
        raise ConfigError(f"{where} not valid TOML: {str(error).lower().rstrip('.')}.") from error


def with_setting(config: RunConfig, setting: str) -> RunConfig:
    """Return the configuration with one `key=value` setting from a command line.

    The value is TOML. A bare word, as in farm.world.density=clustered, is a string and needs no quotes.

    Raises:
        ConfigError: it is not of the form `key=value`, or `from_toml` refuses it.
    """
    key, equals, value = (part.strip() for part in setting.partition("="))
    if not (equals and _KEY.fullmatch(key)) or "\n" in setting:
        raise ConfigError(f"a setting is KEY=VALUE, farm.world.density=clustered for instance, not {setting!r}.")
    if _WORD.fullmatch(value) and not _is_toml(value):
        value = format_value(value)
    return from_toml(f"{key} = {value}", config)


def with_values(config: RunConfig, values: Mapping[str, Value]) -> RunConfig:
    """Return the configuration with new values by their dotted keys; raise ConfigError like `from_toml`."""
    return from_toml("\n".join(f"{key} = {format_value(value)}" for key, value in values.items()), config)


def differences(a: RunConfig, b: RunConfig) -> list[str]:
    """Return one line `dotted.key: a -> b` for each field in which two configurations differ."""
    before, after = flatten(a), flatten(b)
    return [
        f"{key}: {_brief(before[key]) if key in before else 'none'} -> {_brief(after[key]) if key in after else 'none'}"
        for key in {**before, **after}
        if key not in before or key not in after or before[key] != after[key]
    ]


def digest(config: RunConfig) -> str:
    """Return sixteen hexadecimal digits that identify this configuration; equal ones have equal digests.

    Options at their defaults do not count, so configurations keep their digests when a later version adds options.
    """
    defaults, name = flatten(RunConfig().with_algorithm(config.algorithm.name)), "algorithm.name"
    own = {key: value for key, value in flatten(config).items() if key == name or defaults.get(key) != value}
    text = "".join(f"{key} = {format_value(value)}\n" for key, value in own.items())
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def method_of(config: RunConfig) -> RunConfig:
    """Return the configuration without what a resumed run may change.

    That is `learner`, `evaluation`, `env.step_timeout` and `plugins`, of which more may be named.

    They affect a run's speed, rounding and final evaluation, but not what is trained.
    """
    env = dataclasses.replace(config.env, step_timeout=EnvConfig.step_timeout)
    return dataclasses.replace(
        config, env=env, learner=LearnerConfig(), evaluation=EvaluationConfig(), plugins=PluginNames()
    )


def read_network(table: Any) -> NetworkConfig:
    """Return a network's options as a map of plain values holds them, of which `name` is one.

    Raises:
        ConfigError: there is no such network, or an option does not exist or has an impossible value.
    """
    name = table.get("name") if isinstance(table, dict) else None
    if not isinstance(name, str):
        raise ConfigError("a network has no name.")
    found: NetworkConfig = _merge(network_named(NetworkConfig(), name), table, "")
    return found


def format_value(value: Value | Area | Mapping[str, Value]) -> str:
    """Return a field's value as TOML writes it."""
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{_key(key)} = {format_value(entry)}" for key, entry in value.items()) + "}"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, tuple):
        return "[" + ", ".join(format_value(item) for item in value) + "]"
    return repr(value)


def _read(path: Path) -> str:
    try:
        return read_regular_text(path)
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is not UTF-8 text"
        raise ConfigError(f"the configuration file {path} cannot be read: {reason}.") from error


def _is_toml(value: str) -> bool:
    """Return whether a text is a TOML value."""
    try:
        tomllib.loads(f"value = {value}")
    except ValueError:
        return False
    return True


def _merged(base: RunConfig, table: dict[str, Any]) -> RunConfig:
    """Return the base with a file's values; the file's algorithm decides which options exist."""
    if _FORMAT_KEY in table:
        base, table = _without_maps(base), _of_this_format(table)
    require_loaded(table.get("plugins"))
    _drop_gone(table)
    if isinstance(name := _name_in(table, "env"), str):
        base = base.with_environment(name)
    if isinstance(name := _name_in(table, "algorithm"), str):
        base = base.with_algorithm(name)
    if isinstance(name := _name_in(table.get("algorithm"), "network"), str):
        base = base.with_network(name)
    table = _one_budget(table)
    for section, values in table.items():
        keys = [f"{section}.{key}" for key in values] if isinstance(values, dict) else []
        if found := next(filter(None, (without_effect(base, key) for key in (*keys, section))), None):
            raise ConfigError(found)
    merged: RunConfig = _merge(base, table, "")
    return merged


def _without_maps(config: RunConfig) -> RunConfig:
    """Return the configuration with empty maps."""
    sections: dict[str, Any] = {name: without_entries(getattr(config, name)) for name in WITH_MAPS}
    return dataclasses.replace(config, **sections)


def _of_this_format(table: dict[str, Any]) -> dict[str, Any]:
    """Return a saved configuration's table without its format; raise ConfigError for another one."""
    if type(table[_FORMAT_KEY]) is not int or table[_FORMAT_KEY] != FORMAT:
        raise ConfigError(
            f"this configuration has format {_show(table[_FORMAT_KEY])}, and this version reads {FORMAT}."
        )
    return {key: value for key, value in table.items() if key != _FORMAT_KEY}


def _drop_gone(table: dict[str, Any]) -> None:
    """Remove options that are constants now from a table; raise ConfigError where one has another value."""
    for key, constant in GONE.items():
        *sections, name = key.split(".")
        found: Any = table
        for section in sections:
            found = found.get(section) if isinstance(found, dict) else None
        if not isinstance(found, dict) or name not in found:
            continue
        value = found.pop(name)
        if value != constant or isinstance(value, bool):
            raise ConfigError(f"{key} is no option any more; it is always {_show(constant)}, not {_show(value)}.")


def _name_in(table: Any, section: str) -> Any:
    """Return the name that a table gives a section; None if it gives none."""
    found = table.get(section) if isinstance(table, dict) else None
    return found.get("name") if isinstance(found, dict) else None


def _one_budget(table: dict[str, Any]) -> dict[str, Any]:
    """Return the table with 0 for the other one of `episodes` and `steps` where it names one of them alone."""
    named = [name for name in _BUDGETS if table.get(name)]
    return {name: 0 for name in _BUDGETS} | table if len(named) == 1 else table


def _merge(base: Any, table: dict[str, Any], prefix: str) -> Any:
    """Return a copy of a dataclass with the table's values, checked field by field."""
    hints = get_type_hints(type(base))
    known = [field.name for field in dataclasses.fields(base)]
    changes: dict[str, Any] = {}
    for name, value in table.items():
        key = prefix + name
        if name not in known:
            raise ConfigError(_unknown(key, prefix))
        current = getattr(base, name)
        if isinstance(current, Mapping):
            changes[name] = _entries(key, current, value, get_args(hints[name])[1])
        elif not dataclasses.is_dataclass(current):
            changes[name] = _convert(key, value, hints[name])
        elif isinstance(value, dict):
            changes[name] = _merge(current, value, key + ".")
        else:
            raise ConfigError(f"{key} must be a section [{key}], not {_show(value)}.")
    try:
        return dataclasses.replace(base, **changes)
    except ConfigError as error:
        raise ConfigError(f"in [{prefix[:-1]}], {error}" if prefix else str(error)) from error
    except ArithmeticError as error:
        where = f"in [{prefix[:-1]}]" if prefix else "in the configuration"
        raise ConfigError(f"{where}, a number is too small or too large for the computation: {error}.") from error


def _entries(key: str, current: Mapping[str, Value], value: Any, wanted: Any) -> dict[str, Value]:
    """Return a map with a TOML table's entries; raise ConfigError unless it is a table of such values."""
    if not isinstance(value, dict):
        raise ConfigError(f"{key} must be a section [{key}], not {_show(value)}.")
    given = {name: _convert(f"{key}.{_key(name)}", entry, wanted) for name, entry in value.items()}
    return {**current, **given} if given else {}


def _unknown(key: str, prefix: str) -> str:
    """Return the error sentence for an unknown key, with the closest known one."""
    keys = _all_keys()
    sections = {whole.rpartition(".")[0] for whole in keys} | {whole.split(".")[0] for whole in keys} - {""}
    name = key.removeprefix(prefix)
    ending = {whole.rpartition(".")[2]: whole for whole in keys}
    exact = ending.get(name)
    close = [exact] if exact else difflib.get_close_matches(key, [*keys, *sections], n=1, cutoff=0.0)
    return f"unknown configuration key {key}; the closest known one is {close[0]}."


def _all_keys() -> list[str]:
    """Return the keys of all algorithms, and the names of maps."""
    base = RunConfig()
    configs = [base.with_algorithm(name) for name in ALGORITHM_CONFIGS]
    keys = {key for config in configs for key in flatten(config)}
    algorithms = {f"algorithm.{field.name}" for config in configs for field in dataclasses.fields(config.algorithm)}
    return sorted(keys | algorithms | {f"env.{field.name}" for field in dataclasses.fields(base.env)})


def _convert(key: str, value: Any, wanted: Any) -> Value:
    """Return a TOML value as the field's type, or raise ConfigError."""
    if get_origin(wanted) is Literal:
        choices: tuple[Value, ...] = get_args(wanted)
        if value not in choices or type(value) is not type(choices[0]):
            raise ConfigError(f"{key} must be one of {', '.join(map(format_value, choices))}, not {_show(value)}.")
        return choices[choices.index(value)]
    lists: dict[Any, Callable[[str, Any], Value]] = {
        Sites: _sites,
        Zones: _zones,
        Areas: _areas,
        PluginNames: _plugins,
    }
    if wanted in lists:
        return lists[wanted](key, value)
    if get_origin(wanted) is tuple:
        item, *_ = get_args(wanted)
        if not isinstance(value, list) or any(type(each) not in (int, item) for each in value):
            what = "whole numbers" if item is int else "numbers"
            raise ConfigError(f"{key} must be a list of {what}, not {_show(value)}.")
        return tuple(map(item, value))
    if wanted is float and type(value) is int:
        if abs(value) > sys.float_info.max:
            raise ConfigError(f"{key} is a number that is too large.")
        return float(value)
    if type(value) is not wanted:
        raise ConfigError(f"{key} must be {_TYPE_NAMES[wanted]}, not {_show(value)}.")
    converted: Value = value
    return converted


def _plugins(key: str, value: Any) -> PluginNames:
    """Return a TOML list of plug-ins' names."""
    if not isinstance(value, list) or any(type(name) is not str for name in value):
        raise ConfigError(f"{key} must be a list of names, not {_show(value)}.")
    return PluginNames(value)


def _sites(key: str, value: Any) -> Sites:
    """Return a TOML list of positions as floats; WorldConfig checks their values."""
    if not isinstance(value, list) or len(value) > MAX_SENSORS:
        raise ConfigError(f"{key} must be a list of at most {MAX_SENSORS} places, not {_show(value)}.")
    for site in value:
        if not isinstance(site, list) or any(type(number) not in (int, float) for number in site):
            raise ConfigError(f"{key} must be a list of places [x, y] or [x, y, type], not of {_show(site)}.")
        if any(abs(number) > sys.float_info.max for number in site):
            raise ConfigError(f"{key} names a number that is too large.")
    return tuple(tuple(float(number) for number in site) for site in value)


def _zones(key: str, value: Any) -> Zones:
    """Return a TOML list of polygons as floats; ZoneConfig checks their values."""
    if not isinstance(value, list) or len(value) > MAX_ZONES:
        raise ConfigError(f"{key} must be a list of at most {MAX_ZONES} polygons, not {_show(value)}.")
    for polygon in value:
        if not isinstance(polygon, list) or len(polygon) > MAX_CORNERS:
            raise ConfigError(
                f"{key} must be a list of lists of at most {MAX_CORNERS} corners, not of {_show(polygon)}."
            )
    return tuple(_sites(key, polygon) for polygon in value)


def _areas(key: str, value: Any) -> Areas:
    """Return a TOML list of areas, a growth and corners each; StressConfig checks their values."""
    if not isinstance(value, list) or len(value) > MAX_AREAS:
        raise ConfigError(f"{key} must be a list of at most {MAX_AREAS} areas, not {_show(value)}.")
    for area in value:
        if not isinstance(area, list) or len(area) != 2 or type(area[0]) is not int:
            raise ConfigError(f"{key} must be a list of areas [growth, corners], growth a whole number.")
    polygons = _zones(key, [corners for _, corners in value])
    return tuple((growth, corners) for (growth, _), corners in zip(value, polygons, strict=True))


def _brief(value: Value) -> str:
    """Return a value for a message."""
    return f"a list of {len(value)}" if isinstance(value, tuple) and len(value) > _LONG else format_value(value)


def _show(value: Any) -> str:
    """Return a TOML value for an error message, tables and dates included."""
    if isinstance(value, dict):
        return "a section"
    if isinstance(value, list) and len(value) > _LONG:
        return f"a list of {len(value)}"
    if isinstance(value, list):
        return "[" + ", ".join(map(_show, value)) + "]"
    return format_value(value) if isinstance(value, bool | int | float | str) else str(value)
