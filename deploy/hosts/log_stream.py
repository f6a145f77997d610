"""The remote end of `eia-sec logs --follow`: new lines of the logs, for as long as the caller listens."""

import json
import select
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import IO, Any, Final

from eia_sec.common.errors import HostError
from eia_sec.deploy.hosts.agent import LINE_BYTES, log_files

LOOK_SECONDS: Final = 0.25
"""Seconds between two reads of the files."""
MOST_READ: Final = 256 * 1024
"""Most bytes that are read from one file at a time; the rest waits in the file."""
MAX_REQUEST: Final = 64 * 1024
"""Longest request, bytes."""


class Follower:
    """Follows one file from its last lines on; a file that was truncated is read from its beginning.

    Args:
        path: the file, which need not exist yet.
        lines: number of existing lines that come first.
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
        """Return new complete lines; a line longer than MOST_READ comes in pieces."""
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
    """Follows all logs in a host's folder, including those of processes that start later.

    Args:
        folder: the host's folder.
        names: processes to follow; empty for all and the keeper.
        lines: number of existing lines of each that come first.
    """

    def __init__(self, folder: Path, names: Sequence[str], lines: int) -> None:
        self._folder, self._names, self._lines = folder, names, lines
        self._followers: dict[str, Follower] = {}

    def more(self) -> Iterator[tuple[str, str]]:
        """Yield pairs of a process's name and a new line of its log."""
        for name, path in log_files(self._folder, self._names).items():
            if name not in self._followers:
                self._followers[name] = Follower(path, self._lines)
            for line in self._followers[name].more():
                yield name, line


def follow(folder: Path, requests: IO[bytes], answers: IO[bytes]) -> None:
    """Write one JSON array [name, line] for each new line until the caller closes its end.

    Args:
        folder: the host's folder.
        requests: one line with the request; it stays open while the caller listens.
        answers: where the lines go; a caller that does not read stops the reading here.

    Raises:
        HostError: the request is malformed.
    """
    try:
        request: Any = json.loads(requests.readline(MAX_REQUEST))
        following = Following(folder, [str(name) for name in request["names"]], int(request["lines"]))
    except (ValueError, KeyError, TypeError) as error:
        raise HostError(f"this version of eia-sec does not understand the request: {error!r}.") from error
    try:
        while True:
            for pair in following.more():
                answers.write(json.dumps(pair).encode() + b"\n")
            answers.flush()
            if select.select([requests], [], [], LOOK_SECONDS)[0]:
                return
    except BrokenPipeError:
        return
