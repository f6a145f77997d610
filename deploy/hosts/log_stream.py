"""The far end of `eia-sec logs --follow`: what processes write, line by line, for as long as somebody listens."""

import json
import select
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import IO, Any, Final

from common.errors import HostError
from deploy.hosts.agent import LINE_BYTES, log_files

LOOK_SECONDS: Final = 0.25
"""Pause between two looks at the files."""
MOST_READ: Final = 256 * 1024
"""Bytes of one file that are read at a look; what is behind them waits in the file."""
MAX_REQUEST: Final = 64 * 1024
"""Longest request, bytes."""


class Follower:
    """Reads on in one file, from its last lines on; a file that was cut short is read from its beginning.

    Args:
        path: the file, which need not be there yet.
        lines: how many of those that are there come first.
    """

    def __init__(self, path: Path, lines: int) -> None:
        self._path = path
        self._place, self._rest = 0, b""
        self._before = 0
        if path.exists():
            size = path.stat().st_size
            self._place = max(0, size - LINE_BYTES * lines)
            self._before, self._lines = size - self._place, lines

    def more(self) -> list[str]:
        """Return the whole lines that are new; a line longer than MOST_READ comes in pieces."""
        try:
            with self._path.open("rb") as source:
                if source.seek(0, 2) < self._place:
                    self._place, self._rest = 0, b""
                source.seek(self._place)
                data = source.read(self._before or MOST_READ)
        except OSError:
            return []
        self._place += len(data)
        *whole, self._rest = (self._rest + data).split(b"\n")
        if len(self._rest) >= MOST_READ:
            whole, self._rest = [*whole, self._rest], b""
        if self._before:
            whole, self._before = whole[-self._lines :], 0
        return [line.decode(errors="replace") for line in whole]


class Following:
    """Reads on in all logs of a host's folder; processes that are started later are followed, too.

    Args:
        folder: the host's folder.
        names: processes to follow; empty for all and their keeper.
        lines: how many lines of each come first.
    """

    def __init__(self, folder: Path, names: Sequence[str], lines: int) -> None:
        self._folder, self._names, self._lines = folder, names, lines
        self._followers: dict[str, Follower] = {}

    def more(self) -> Iterator[tuple[str, str]]:
        """Yield the name of a process and a new line of it."""
        for name, path in log_files(self._folder, self._names).items():
            if name not in self._followers:
                self._followers[name] = Follower(path, self._lines)
            for line in self._followers[name].more():
                yield name, line


def follow(folder: Path, asks: IO[bytes], tells: IO[bytes]) -> None:
    """Write one JSON array [name, line] for each new line until the asking end is closed.

    Args:
        folder: the host's folder.
        asks: one line with the request; it stays open for as long as somebody listens.
        tells: where the lines go; while nobody reads there, nothing is read here either.

    Raises:
        HostError: the request is not readable.
    """
    try:
        request: Any = json.loads(asks.readline(MAX_REQUEST))
        following = Following(folder, [str(name) for name in request["names"]], int(request["lines"]))
    except (ValueError, KeyError, TypeError) as error:
        raise HostError(f"this version of eia-sec does not understand the request: {error!r}.") from error
    try:
        while True:
            for pair in following.more():
                tells.write(json.dumps(pair).encode() + b"\n")
            tells.flush()
            if select.select([asks], [], [], LOOK_SECONDS)[0]:
                return
    except BrokenPipeError:
        return
