"""Where a result comes from: command, commit and packages."""

import platform
import subprocess
import sys
from importlib.metadata import version
from typing import Any

PACKAGES = ("eclipse-zenoh", "torch", "numpy", "numba")


def provenance(module: str) -> dict[str, Any]:
    """Return the command line, the commit and the versions that a result was made with."""
    asked = subprocess.run(["git", "describe", "--always", "--dirty"], capture_output=True, text=True, check=False)
    return {
        "command": " ".join([f"python -m {module}", *sys.argv[1:]]),
        "commit": asked.stdout.strip() or "unknown",
        "python": platform.python_version(),
        "packages": {name: version(name) for name in PACKAGES},
    }
