"""Archives of a host's files: packed there, and unpacked elsewhere without trusting the host.

An archive is a compressed tar of regular files.
"""

import gzip
import os
import tarfile
import zlib
from collections.abc import Callable, Iterable
from contextlib import suppress
from pathlib import Path
from typing import IO, Final

from eia_sec.common.errors import HostError
from eia_sec.deploy.local import contained_files

MAX_UNPACKED: Final = 8 * 1024**3
"""Most bytes that are unpacked from one archive, unless the caller says otherwise."""
MAX_FILES: Final = 10_000
"""Most files in one archive."""
PIECE: Final = 2**20
LEVEL: Final = 1
"""Strength of the compression: networks and replay hardly shrink."""


def pack(base: Path, paths: Iterable[Path], out: IO[bytes]) -> None:
    """Write an archive of files below a folder; those that do not exist are left out.

    A file that grows meanwhile is read up to the size that it had at the start.
    """
    with (
        gzip.GzipFile(fileobj=out, mode="wb", compresslevel=LEVEL) as compressed,
        tarfile.open(fileobj=compressed, mode="w|", format=tarfile.GNU_FORMAT) as archive,
    ):
        for path in paths:
            with suppress(FileNotFoundError), path.open("rb") as source:
                known = os.fstat(source.fileno())
                entry = tarfile.TarInfo(path.relative_to(base).as_posix())
                entry.size, entry.mtime = known.st_size, int(known.st_mtime)
                archive.addfile(entry, source)


def unpack(
    packed: IO[bytes], target: Path, own: Callable[[str], bool], most: int | None = None
) -> tuple[int, list[str]]:
    """Unpack an archive of `pack`.

    Args:
        packed: the archive.
        target: the folder.
        own: whether the host may write a name.
        most: most bytes to unpack; MAX_UNPACKED if it is None.

    Returns:
        The number of files written, and the names of those left out.

    Raises:
        HostError: the archive is malformed or too large, repeats a name, or cannot be written.
    """
    limit = MAX_UNPACKED if most is None else most
    names: set[str] = set()
    left_out: list[str] = []
    try:
        with gzip.GzipFile(fileobj=packed) as source:
            room = limit
            while (entry := _next(source)) is not None:
                room -= entry.size
                if room < 0 or len(names) >= MAX_FILES:
                    raise HostError(f"it sent more than {limit} bytes or {MAX_FILES} files.")
                if entry.name in names:
                    raise HostError(f"it sent {entry.name!r} twice.")
                names.add(entry.name)
                if own(entry.name):
                    with contained_files.writing(target, entry.name, 0o644) as file:
                        _copy(source, entry.size, file)
                else:
                    left_out.append(entry.name)
                    with open(os.devnull, "wb") as nowhere:
                        _copy(source, entry.size, nowhere)
                _take(source, -entry.size % tarfile.BLOCKSIZE)
    except (tarfile.TarError, EOFError, zlib.error, gzip.BadGzipFile) as error:
        raise HostError(f"its archive is incomplete or malformed: {error}.") from error
    except OSError as error:
        raise HostError(f"its files cannot be written: {error.strerror}.") from error
    return len(names) - len(left_out), left_out


def _next(source: gzip.GzipFile) -> tarfile.TarInfo | None:
    """Return the next header, or None at the archive's end; regular files only, so that headers have a fixed size."""
    block = _take(source, tarfile.BLOCKSIZE)
    if not block.strip(b"\0"):
        return None
    entry = tarfile.TarInfo.frombuf(block, "utf-8", "surrogateescape")
    if entry.type not in (tarfile.REGTYPE, tarfile.AREGTYPE) or entry.size < 0:
        raise HostError(f"it sent {entry.name!r}, which is not a regular file.")
    return entry


def _take(source: gzip.GzipFile, size: int) -> bytes:
    """Return exactly `size` bytes; raise EOFError if there are fewer."""
    data = source.read(size)
    if len(data) < size:
        raise EOFError("it ends too early")
    return data


def _copy(source: gzip.GzipFile, size: int, file: IO[bytes]) -> None:
    """Copy `size` bytes into a file; raise EOFError if there are fewer."""
    while size:
        piece = _take(source, min(PIECE, size))
        file.write(piece)
        size -= len(piece)
