"""Where a result comes from: command, commit and packages."""

import platform
import subprocess
import sys
from collections.abc import Sequence
from importlib.metadata import version
from typing import Any, Final

PACKAGES: Final = ("eclipse-zenoh", "torch", "numpy", "numba")
LOCAL: Final = ("--venvs", "--pip-args", "--records")
"""Options that only concern one machine, its paths and indexes."""


def command(program: str, arguments: Sequence[str]) -> str:
    """Return the command line that made a result, without the options in LOCAL."""
    told = [program]
    for place, argument in enumerate(arguments):
        value_of = arguments[place - 1] if place else ""
        if argument.partition("=")[0] not in LOCAL and value_of not in LOCAL:
            told.append(argument)
    return " ".join(told)


def commit() -> str:
    """Return the commit of the present folder, -dirty behind it where files differ, or unknown."""
    asked = subprocess.run(["git", "describe", "--always", "--dirty"], capture_output=True, text=True, check=False)
    return asked.stdout.strip() or "unknown"


def made_by(program: str, arguments: Sequence[str]) -> dict[str, Any]:
    """Return the command line, the commit and the versions that a result is made with."""
    return {
        "command": command(program, arguments),
        "commit": commit(),
        "python": platform.python_version(),
        "packages": {name: version(name) for name in PACKAGES},
    }


def provenance(module: str) -> dict[str, Any]:
    """Return where the result of a module comes from that was started by `python -m`."""
    return made_by(f"python -m {module}", sys.argv[1:])
