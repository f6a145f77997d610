"""Files below one folder, under names that may come from a file, a message or another host.

A name cannot lead out of the folder: not with "..", not as an absolute path, and not through a symbolic link that is
there already. The folder itself is the user's choice and may be a link.
"""

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path, PurePosixPath
from typing import IO

from eia_sec.common.errors import UsageError


def checked_parts(name: str) -> tuple[str, ...]:
    """Return the parts of a relative path.

    Raises:
        UsageError: the path leaves its folder, or holds a character that a terminal would obey.
    """
    path = PurePosixPath(name)
    if path.is_absolute() or not path.parts or ".." in path.parts or not name.isprintable():
        raise UsageError(f"{name[:80]!r} is not a path inside a folder.")
    return path.parts


@contextmanager
def writing(folder: Path, name: str, mode: int = 0o600) -> Iterator[IO[bytes]]:
    """Open a new file that replaces an old one once it is complete; after an error the old one stays.

    Args:
        folder: made if missing.
        name: path in the folder, with "/" between its parts; missing folders are made.
        mode: permissions of the file. Folders get the same, plus the right to enter for those who may read.

    Raises:
        UsageError: the name leaves the folder, or a folder on the way is a symbolic link.
        OSError: the file cannot be written.
    """
    *above, last = checked_parts(name)
    folder_mode = mode | (mode & 0o444) >> 2
    folder.mkdir(parents=True, exist_ok=True)
    inside = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        for part in above:
            with suppress(FileExistsError):
                os.mkdir(part, folder_mode, dir_fd=inside)
            below = _open_folder(part, inside)
            os.close(inside)
            inside = below
        temporary = f".{os.urandom(8).hex()}.part"
        descriptor = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode, dir_fd=inside)
        try:
            with os.fdopen(descriptor, "wb") as file:
                yield file
                file.flush()
                os.fsync(descriptor)
            os.replace(temporary, last, src_dir_fd=inside, dst_dir_fd=inside)
        except BaseException:
            with suppress(OSError):
                os.unlink(temporary, dir_fd=inside)
            raise
    finally:
        os.close(inside)


def _open_folder(name: str, above: int) -> int:
    try:
        return os.open(name, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW, dir_fd=above)
    except OSError as error:
        if error.errno in (errno.ELOOP, errno.ENOTDIR):
            raise UsageError(f"{name} is a symbolic link or a file where a folder has to be; remove it.") from error
        raise


def write(folder: Path, name: str, data: bytes, mode: int = 0o600) -> Path:
    """Write a file as `writing` does and return its path.

    Raises:
        UsageError: the name leaves the folder, or a folder on the way is a symbolic link.
        OSError: the file cannot be written.
    """
    with writing(folder, name, mode) as file:
        file.write(data)
    return folder / name
