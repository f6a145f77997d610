"""The provenance of a result: command, commit and package versions."""

import platform
import re
import shlex
import subprocess
import sys
from collections.abc import Sequence
from importlib.metadata import packages_distributions, version
from typing import Any, Final

PACKAGES: Final = ("eclipse-zenoh", "torch", "numpy", "numba")
LOCAL: Final = ("--venvs", "--pip-args", "--records", "--keep")
"""Options that concern only one machine, such as paths."""


def command(program: str, arguments: Sequence[str]) -> str:
    """Return the command line of a result without the options in LOCAL."""
    words = [program]
    for place, argument in enumerate(arguments):
        value_of = arguments[place - 1] if place else ""
        if argument.partition("=")[0] not in LOCAL and value_of not in LOCAL:
            words.append(shlex.quote(argument))
    return " ".join(words)


def commit() -> str:
    """Return the current folder's commit, with -dirty if files differ, or "unknown"."""
    try:
        asked = subprocess.run(
            ["git", "describe", "--always", "--dirty", "--exclude=*"], capture_output=True, text=True, check=False
        )
    except OSError:  # there is no git
        return "unknown"
    return asked.stdout.strip() or "unknown"


def versions(modules: Sequence[str] = ()) -> dict[str, Any]:
    """Return commit and package versions.

    Args:
        modules: modules, or module:name, whose packages count, too; those without a version are left out.
    """
    owners = packages_distributions() if modules else {}
    others = [owner for module in modules for owner in owners.get(re.split("[.:]", module)[0], ())]
    return {
        "commit": commit(),
        "python": platform.python_version(),
        "packages": {name: version(name) for name in dict.fromkeys((*PACKAGES, *others))},
    }


def made_by(program: str, arguments: Sequence[str], modules: Sequence[str] = ()) -> dict[str, Any]:
    """Return command line, commit and package versions; `modules` as in `versions`."""
    return {"command": command(program, arguments), **versions(modules)}


def provenance(module: str) -> dict[str, Any]:
    """Return the provenance of a result of `python -m MODULE`."""
    return made_by(f"python -m {module}", sys.argv[1:])
