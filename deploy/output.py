"""Standard output that survives a full disk: writes that fail are counted, and the command goes on."""

import errno
import sys
from typing import Any, Final, TextIO, cast

FULL: Final = frozenset((errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EFBIG))
"""Error numbers of a disk that takes no more."""


class _Patient:
    """A stream that drops and counts writes to a full disk; everything else is the wrapped stream's."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self.lost = 0

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        """Write a text, preceded by the number of lost writes; return the number of characters written."""
        try:
            if self.lost:
                self._stream.write(f"({self.lost} earlier writes failed: the disk was full)\n")
                self.lost = 0
            return self._stream.write(text)
        except OSError as error:
            return self._lose(error)

    def flush(self) -> None:
        """Flush the stream."""
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
    """Return standard output for a process that other processes depend on."""
    return cast(TextIO, _Patient(sys.stdout))
