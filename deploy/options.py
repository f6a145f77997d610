"""From a command line to a configuration: preset, file, algorithm, farm file, options; the later ones win."""

import contextlib
import inspect
import io
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass, replace
from functools import reduce
from pathlib import Path
from typing import Any, Final, TypeVar, cast, get_args, get_origin, get_type_hints

import tyro

from eia_sec.common import plugins
from eia_sec.common.config import EnvConfig, RunConfig
from eia_sec.common.config.effect import switched_off, without_effect
from eia_sec.common.config.environment import FARM
from eia_sec.common.config.files import WITH_MAPS, from_toml, with_setting
from eia_sec.common.config.maps import FrozenMap
from eia_sec.common.config.presets import PRESETS, preset, preset_for
from eia_sec.common.errors import ConfigError, UsageError
from eia_sec.common.farm import require_farm
from eia_sec.deploy.exit_codes import USAGE
from eia_sec.deploy.local.run_directory import RunDirectory
from eia_sec.deploy.option_forms import refusal, registry

T = TypeVar("T")

SHORT: Final = {
    "--env": "--env.name",
    "--algorithm": "--algorithm.name",
    "--algorithm.network": "--algorithm.network.name",
    "--population": "--population.members",
}
"""Short names of options."""

PRESET_HELP: Final = (
    f"Configuration to begin from: {', '.join(PRESETS)}. Without it, the farm has inertial and any other environment "
    "has generic."
)

HELP_ALL: Final = "--help-all"

NO_FARM: Final = "--farm-file needs the farm, and this run uses {}."


def _with_entries(given: Any, parsed: Any) -> Any:
    """Return parsed options whose maps have the entries of the given ones, too; an empty map stays empty."""
    changes = {}
    for field in fields(parsed):
        before, now = getattr(given, field.name, None), getattr(parsed, field.name)
        if isinstance(now, Mapping) and isinstance(before, Mapping) and now:
            changes[field.name] = FrozenMap({**before, **now})
    return replace(parsed, **changes)


def base_configuration(arguments: Sequence[str]) -> RunConfig:
    """Return the configuration of `--preset`, `--config`, `--algorithm` and `--farm-file`; other options act on it.

    With `--resume` and neither of the first two, it is the run directory's.

    Raises:
        ConfigError: for a preset or an algorithm that does not exist, or a file with a mistake.
    """
    farm_file = _value_of(arguments, "--farm-file")
    config = _named_configuration(arguments)
    if name := _value_of(arguments, "--env") or _value_of(arguments, "--env.name"):
        config = config.with_environment(name)
    if name := _value_of(arguments, "--algorithm") or _value_of(arguments, "--algorithm.name"):
        config = config.with_algorithm(name)
    if name := _value_of(arguments, "--algorithm.network") or _value_of(arguments, "--algorithm.network.name"):
        config = config.with_network(name)
    for option in ("episodes", "steps"):
        if value := _value_of(arguments, f"--{option}"):
            config = with_setting(config, f"{option}={value}")
    if plugins.loaded():
        config = replace(config, plugins=plugins.loaded())
    return with_farm_file(config, Path(farm_file)) if farm_file else config


def with_farm_file(config: RunConfig, path: Path) -> RunConfig:
    """Return the configuration with the sensors and the field of a farm file; raise ConfigError for its mistakes."""
    from eia_sec.rollout.farm_files import read_farm  # noqa: PLC0415  (loads the simulator, which most commands do without)

    return replace(config, farm=read_farm(path).on(require_farm(config, NO_FARM)))


def with_settings(config: RunConfig, settings: Sequence[str]) -> RunConfig:
    """Return the configuration with the values of `--set KEY=VALUE ...`; raise ConfigError for their mistakes."""
    for setting in settings:
        config = with_setting(config, setting)
    _refuse_switched_off(config, [setting.partition("=")[0].strip() for setting in settings])
    return config


def require_env(config: RunConfig, named: str | None) -> None:
    """Refuse a run directory's configuration whose environment the command line does not name.

    Loading an environment runs its code, and a run directory may be somebody else's.

    Raises:
        UsageError: the environment is neither the farm nor named; of what others serve, any may be named.
    """
    if config.env.served:
        if named is None or not EnvConfig(named).served:
            raise UsageError(f"this run uses what others serve; add --env {shlex.quote(config.env.name)} to step that.")
    elif config.env.is_third_party and config.env.name != named:
        raise UsageError(f"this run uses {config.env.name}; add --env {config.env.name} to run its code.")


def _named_configuration(arguments: Sequence[str]) -> RunConfig:
    named, folder = _value_of(arguments, "--preset"), _value_of(arguments, "--run-dir")
    env = _value_of(arguments, "--env") or _value_of(arguments, "--env.name")
    if "--resume" in arguments and folder and not named and not _value_of(arguments, "--config"):
        held = RunDirectory(Path(folder))
        if not (held.path.is_dir() and held.holds_run()):
            return preset(preset_for(env or FARM))
        config = held.configuration()
        require_env(config, env)
        return config
    path = _value_of(arguments, "--config")
    config = _with_file(preset(named or preset_for(env or FARM)), path)
    if named or env or config.env.name == FARM:
        return config
    return _with_file(preset(preset_for(config.env.name)), path)


def _with_file(config: RunConfig, path: str | None) -> RunConfig:
    return from_toml(Path(path), config) if path else config


def parse(kind: type[T], arguments: Sequence[str], name: str, default: T | None = None) -> T:
    """Parse the options of one command.

    Args:
        kind: the dataclass of the options.
        arguments: the command line behind the command's name.
        name: the command.
        default: an instance that gives the defaults.

    Raises:
        ConfigError: for an impossible value.
        UsageError: for an option that does not exist or a value of the wrong type.
    """
    complaint = io.StringIO()
    try:
        with contextlib.redirect_stderr(complaint):
            spelt = _spelt_out(kind, arguments)
            given = getattr(default, "settings", None)
            if isinstance(given, RunConfig):
                _refuse_without_effect(given, spelt)
            whole = HELP_ALL in spelt or not isinstance(given, RunConfig)
            few = not whole and bool({"-h", "--help"} & set(spelt))
            words = ["--help" if word == HELP_ALL else word for word in spelt]
            told = inspect.cleandoc(kind.__doc__ or "")
            told += f"\n{HELP_ALL} shows the other settings too; docs/reference/configuration.md explains them." * few
            parsed = tyro.cli(
                kind,
                args=words,
                prog=f"eia-sec {name}",
                description=told,
                default=default,
                registry=registry(most_used=few),
            )
        settings = getattr(parsed, "settings", None)
        if isinstance(given, RunConfig) and isinstance(settings, RunConfig):
            pairs = {name: (getattr(given, name), getattr(settings, name)) for name in WITH_MAPS}
            merged: dict[str, Any] = {name: _with_entries(*pair) for name, pair in pairs.items()}
            settings = replace(settings, **merged)
            parsed = replace(parsed, settings=settings)  # type: ignore[type-var]  # a command's options are a dataclass
        if isinstance(settings, RunConfig):
            _refuse_switched_off(settings, _keys(spelt))
        if isinstance(settings, RunConfig) and _value_of(arguments, "--farm-file"):
            require_farm(settings, NO_FARM)
        return cast(T, parsed)
    except SystemExit as stop:
        if stop.code != USAGE:  # --help, or a signal that came meanwhile
            raise
        said = refusal(complaint.getvalue(), _subcommands(kind))
        page = HELP_ALL if isinstance(given, RunConfig) else "--help"
        raise UsageError(f"{said}{'' if said.endswith('?') else '.'} Options: eia-sec {name} {page}.") from None


def _keys(arguments: Sequence[str]) -> list[str]:
    """Return the configuration keys that a command line names."""
    words = [word[2:].partition("=")[0].replace("-", "_") for word in arguments if word.startswith("--")]
    return [word.replace(".no_", ".") for word in words if "." in word]


def _refuse_without_effect(config: RunConfig, arguments: Sequence[str]) -> None:
    """Raise ConfigError for an option that has no effect with the algorithm."""
    for key in _keys(arguments):
        if reason := without_effect(config, key):
            raise ConfigError(reason)


def _refuse_switched_off(config: RunConfig, keys: Sequence[str]) -> None:
    """Raise ConfigError for an option of a part that is switched off."""
    for key in keys:
        if reason := switched_off(config, key):
            raise ConfigError(reason)


def _spelt_out(kind: type[Any], arguments: Sequence[str]) -> list[str]:
    """Return the arguments with SHORT options written out, for commands that take a whole configuration.

    For the others, the values of a list that is given several times, such as `--set`, are those of one list, as the
    parser would keep the last one alone.
    """
    if "settings" not in get_type_hints(kind):
        return reduce(_joined, sorted(_lists(kind)), list(arguments))
    words = [word.partition("=") for word in arguments]
    return [
        f"{SHORT[name]}{equals}{value}" if name in SHORT else name + equals + value for name, equals, value in words
    ]


def _lists(kind: Any) -> set[str]:
    """Return the options of a command and of its subcommands that take several values."""
    found = set()
    for name, hint in get_type_hints(kind).items():
        if get_origin(hint) is tuple:
            found.add(f"--{name.replace('_', '-')}")
        for member in get_args(hint):
            found |= _lists(member) if is_dataclass(member) else set()
    return found


def _joined(arguments: list[str], option: str) -> list[str]:
    """Return the arguments with all values of a list option behind the first one."""
    others: list[str] = []
    values: list[str] = []
    at, inside = 0, False
    for word in arguments:
        if word == option or word.startswith(f"{option}="):
            at, inside = at if values else len(others), True
            values += [word.removeprefix(f"{option}=")] if "=" in word else []
        elif inside and not word.startswith("--"):
            values.append(word)
        else:
            inside = False
            others.append(word)
    return [*others[:at], option, *values, *others[at:]] if values else arguments


def _subcommands(kind: type[Any]) -> list[str]:
    """Return the words of which a command needs one; none where it has options only."""
    members = [member for hint in get_type_hints(kind, include_extras=True).values() for member in _members(hint)]
    return [one.name for member in members for one in getattr(member, "__metadata__", ()) if hasattr(one, "name")]


def _members(hint: Any) -> tuple[Any, ...]:
    """Return the parts of a union, which may be annotated."""
    return get_args(hint.__origin__) if hasattr(hint, "__metadata__") else get_args(hint)


def _value_of(arguments: Sequence[str], option: str) -> str | None:
    """Return the last value of an option, as the parser does; None if it has none, or `None`."""
    found = None
    for index, text in enumerate(arguments):
        name, equals, value = text.partition("=")
        if name.replace("_", "-") == option and (equals or index + 1 < len(arguments)):
            found = value if equals else arguments[index + 1]
    return None if found == "None" else found
