"""Whether an open file is still the one that its path names."""

import os
from pathlib import Path


def names_open_file(path: Path, descriptor: int) -> bool:
    """Return whether the path still leads to the open file; False once it was removed, renamed or replaced.

    Writes to a file without a name succeed and are gone when it is closed, so a long-running writer has to look.
    """
    try:
        return os.path.samestat(path.stat(), os.fstat(descriptor))
    except OSError:
        return False
