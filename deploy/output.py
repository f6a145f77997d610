"""Standard output that survives a full disk: what cannot be written there is lost and counted, and ends nothing."""

import errno
import sys
from typing import Any, Final, TextIO, cast

FULL: Final = frozenset((errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EFBIG))
"""What a disk says that takes no more."""


class _Patient:
    """A stream whose writes to a full disk are lost; everything else is the stream's own."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self.lost = 0

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        """Write a text, after how many were lost before it; return how many characters were written."""
        try:
            if self.lost:
                self._stream.write(f"({self.lost} writes before this one could not be written)\n")
                self.lost = 0
            return self._stream.write(text)
        except OSError as error:
            return self._lose(error)

    def flush(self) -> None:
        """Hand on what was written."""
        try:
            self._stream.flush()
        except OSError as error:
            self._lose(error)

    def _lose(self, error: OSError) -> int:
        if error.errno not in FULL:
            raise error
        self.lost += 1
        return 0


def patient_output() -> TextIO:
    """Return standard output for a process that others depend on."""
    return cast(TextIO, _Patient(sys.stdout))
