"""Checks whether an open file is still the one at its path."""

import os
from pathlib import Path


def names_open_file(path: Path, descriptor: int) -> bool:
    """Return whether the path still leads to the open file; False once the file was removed, renamed or replaced.

    Writes to a removed file succeed but are lost when it is closed, so a long-running writer must check.
    """
    try:
        return os.path.samestat(path.stat(), os.fstat(descriptor))
    except OSError:
        return False
