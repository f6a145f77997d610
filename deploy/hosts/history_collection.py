"""`eia-sec fleet collect`: histories packed on each host and unpacked into one folder here, without trusting the hosts.

The archive is a compressed tar of regular files. A host may write its own files only: its workers' histories, and the
learner's files if the fleet file places the learner there.
"""

import gzip
import os
import re
import tarfile
import zlib
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Final

from eia_sec.common.errors import ConfigError, HostError
from eia_sec.deploy.hosts.fleet_file import FleetSpec
from eia_sec.deploy.hosts.remote import Link, everywhere, links
from eia_sec.deploy.local import contained_files
from eia_sec.deploy.local.run_directory import CONFIG, HISTORY, METRICS, POLICY

OF_THE_LEARNER: Final = (f"{HISTORY}/learner.jsonl", CONFIG, METRICS, POLICY)
"""Files that the learner's host sends besides its workers' histories."""
MAX_ARCHIVE: Final = 2 * 1024**3
"""Largest archive of one host, bytes."""
MAX_UNPACKED: Final = 8 * 1024**3
"""Most bytes that are unpacked from one host."""
MAX_FILES: Final = 10_000
"""Most files from one host."""
PIECE: Final = 2**20


@dataclass
class Collected:
    """The result of a collection.

    Attributes:
        files: number of files written.
        left_out: "HOST NAME" of files that do not belong to their host, for example of a learner that has moved.
        failed: the reason for each host that failed.
    """

    files: int = 0
    left_out: list[str] = field(default_factory=list)
    failed: dict[str, str] = field(default_factory=dict)


def pack(folder: Path, out: IO[bytes]) -> None:
    """Write an archive of a host's run: histories, metrics, configuration and policy, whichever exist.

    A file that grows meanwhile is read up to the size that it had at the start.
    """
    run = folder / "run"
    with tarfile.open(fileobj=out, mode="w|gz", format=tarfile.USTAR_FORMAT) as archive:
        for path in [*sorted((run / HISTORY).glob("*.jsonl")), *(run / name for name in (CONFIG, METRICS, POLICY))]:
            with suppress(FileNotFoundError), path.open("rb") as source:
                known = os.fstat(source.fileno())
                entry = tarfile.TarInfo(path.relative_to(run).as_posix())
                entry.size, entry.mtime = known.st_size, int(known.st_mtime)
                archive.addfile(entry, source)


def collect(fleet: FleetSpec, target: Path) -> Collected:
    """Copy the histories of all hosts and the learner's metrics and policy into one folder, for `eia-sec audit`.

    Raises:
        ConfigError: the folder cannot be made.
    """
    try:
        (target / HISTORY).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError(f"{target} cannot be made: {error.strerror}.") from error
    found = Collected()

    def bring(link: Link) -> tuple[int, list[str]]:
        with link.fetch("collect", most=MAX_ARCHIVE) as packed:
            try:
                return unpack(packed, target, own_names(fleet, link.name))
            except HostError as error:
                raise HostError(f"{link.name}: {error}") from error

    with links(fleet) as ways:
        done, found.failed = everywhere(ways, bring)
    for host, (files, left_out) in done.items():
        found.files += files
        found.left_out += [f"{host} {name}" for name in left_out]
    return found


def own_names(fleet: FleetSpec, host: str) -> Callable[[str], bool]:
    """Return a predicate for the file names that belong to a host."""
    workers = re.compile(rf"{HISTORY}/rollout-{re.escape(host)}-[0-9]+\.jsonl")
    learner = OF_THE_LEARNER if host == fleet.learner.host else ()
    return lambda name: name in learner or workers.fullmatch(name) is not None


def unpack(packed: IO[bytes], target: Path, own: Callable[[str], bool]) -> tuple[int, list[str]]:
    """Unpack an archive of `pack`.

    Args:
        packed: the archive.
        target: the folder.
        own: whether the host may write a name.

    Returns:
        The number of files written, and the names of those left out.

    Raises:
        HostError: the archive is malformed or too large, repeats a name, or cannot be written.
    """
    names: set[str] = set()
    left_out: list[str] = []
    try:
        with gzip.GzipFile(fileobj=packed) as source:
            room = MAX_UNPACKED
            while (entry := _next(source)) is not None:
                room -= entry.size
                if room < 0 or len(names) >= MAX_FILES:
                    raise HostError(f"it sent more than {MAX_UNPACKED} bytes or {MAX_FILES} files.")
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
