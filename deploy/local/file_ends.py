"""The last lines of a file that may be long."""

import os
from pathlib import Path


def last_lines(path: Path, most_bytes: int) -> list[str]:
    """Return the lines in the last bytes of a file, the first of which may be cut.

    Raises:
        OSError: it cannot be read.
    """
    with path.open("rb") as file:
        file.seek(max(0, file.seek(0, os.SEEK_END) - most_bytes))
        return file.read(most_bytes).decode(errors="replace").splitlines()
