"""Reading files that a user names: regular ones of a bounded size, so that no pipe or device is waited for."""

import errno
import os
import stat
from pathlib import Path
from typing import Final

MOST_TEXT_BYTES: Final = 64 * 2**20
"""Largest text that is read."""


def read_regular(path: Path, most: int) -> bytes:
    """Return a file's bytes.

    Args:
        path: the file.
        most: its largest size, bytes.

    Raises:
        OSError: it cannot be read, is a pipe, device or folder, or is larger.
    """
    # Opening a pipe waits for a writer, unless told otherwise.
    with open(path, "rb", opener=lambda name, flags: os.open(name, flags | os.O_NONBLOCK)) as file:
        known = os.fstat(file.fileno())
        if not stat.S_ISREG(known.st_mode):
            raise OSError(errno.EINVAL, "it is not a regular file", str(path))
        if known.st_size > most:
            raise OSError(errno.EFBIG, f"it has more than {most:,} bytes", str(path))
        return file.read(known.st_size)


def read_regular_text(path: Path) -> str:
    """Return a UTF-8 text without its byte order mark; raise OSError as `read_regular`, or UnicodeDecodeError."""
    return read_regular(path, MOST_TEXT_BYTES).decode("utf-8-sig")
