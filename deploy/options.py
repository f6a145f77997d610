"""How command lines become configurations: preset, then file, then options, each over the one before."""

import contextlib
import io
from collections.abc import Sequence
from pathlib import Path
from typing import TypeVar, cast

import tyro

from common.config import RunConfig
from common.config.files import from_toml
from common.config.presets import PRESETS
from common.errors import ConfigError, UsageError
from deploy.rundir import RunDirectory

T = TypeVar("T")


def base_configuration(arguments: Sequence[str], default: str = "default") -> RunConfig:
    """Return the configuration that `--preset` and `--config` name; the options then act on it.

    With `--resume` and neither of them it is that of the run directory.

    Raises:
        ConfigError: for a preset that does not exist, or a file with a mistake.
    """
    named, folder = _value_of(arguments, "--preset"), _value_of(arguments, "--run-dir")
    if "--resume" in arguments and folder and not named and not _value_of(arguments, "--config"):
        held = RunDirectory(Path(folder))
        return held.configuration() if held.path.is_dir() and held.holds_run() else PRESETS[default]
    preset = named or default
    if preset not in PRESETS:
        raise ConfigError(f"there is no preset {preset!r}; the presets are {', '.join(PRESETS)}.")
    config = PRESETS[preset]
    path = _value_of(arguments, "--config")
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
            parsed = tyro.cli(kind, args=list(arguments), prog=f"eia-sec {name}", default=default)
            return cast(T, parsed)
    except SystemExit as stop:
        if stop.code in (0, None):
            raise
        raise UsageError(f"{_sentence(complaint.getvalue())} (eia-sec {name} --help lists the options)") from None


def _sentence(box: str) -> str:
    """Return tyro's complaint, which it draws in a box under a title, as one line."""
    lines = [line.strip("│╭╮╰╯─ ") for line in box.splitlines()]
    lines = [line for line in lines if line.strip("-")]
    reason = lines[1] if len(lines) > 1 else "the command line cannot be used"
    close = next((line.split()[0] for line in lines[2:] if line.startswith("--")), None)
    meant = f"; perhaps you meant {close}" if close and reason.startswith("Unrecognized") else ""
    return reason.rstrip(".") + meant


def _value_of(arguments: Sequence[str], option: str) -> str | None:
    for index, word in enumerate(arguments):
        if word == option and index + 1 < len(arguments):
            return arguments[index + 1]
        if word.startswith(option + "="):
            return word.split("=", 1)[1]
    return None
