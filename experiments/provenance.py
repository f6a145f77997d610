"""Where a result comes from: command, commit and packages."""

import platform
import subprocess
import sys
from collections.abc import Sequence
from importlib.metadata import version
from typing import Any

PACKAGES = ("eclipse-zenoh", "torch", "numpy", "numba")
LOCAL = ("--venvs", "--pip-args")
"""Options that only concern one machine, its paths and indexes."""


def command(module: str, arguments: Sequence[str]) -> str:
    """Return the command line that made a result, without the options in LOCAL."""
    told = [f"python -m {module}"]
    for place, argument in enumerate(arguments):
        value_of = arguments[place - 1] if place else ""
        if argument.partition("=")[0] not in LOCAL and value_of not in LOCAL:
            told.append(argument)
    return " ".join(told)


def provenance(module: str) -> dict[str, Any]:
    """Return the command line, the commit and the versions that a result was made with."""
    asked = subprocess.run(["git", "describe", "--always", "--dirty"], capture_output=True, text=True, check=False)
    return {
        "command": command(module, sys.argv[1:]),
        "commit": asked.stdout.strip() or "unknown",
        "python": platform.python_version(),
        "packages": {name: version(name) for name in PACKAGES},
    }
