"""Files of a benchmark: none is read that is too large to be one, and each appears whole or not at all."""

import os
from pathlib import Path
from typing import Final

MOST_BYTES: Final = 64 * 2**20


def read_bounded(path: Path) -> str:
    """Return a file's text.

    Raises:
        OSError: it cannot be read.
        ValueError: it has more than MOST_BYTES, or is no text.
    """
    with path.open("rb") as file:
        data = file.read(MOST_BYTES + 1)
    if len(data) > MOST_BYTES:
        raise ValueError(f"it has more than {MOST_BYTES} bytes")
    return data.decode()


def write_whole(path: Path, text: str) -> None:
    """Write a file, which takes an earlier one's place once it is whole; raise OSError if it cannot."""
    unfinished = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        unfinished.write_text(text, encoding="utf-8")
        os.replace(unfinished, path)
    finally:
        unfinished.unlink(missing_ok=True)
