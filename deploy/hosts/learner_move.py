"""The learner's files on a host, and their way to another host.

They move in three steps: `release` sets them aside on one host and sends them, `take_in` puts them in place on the
other, and `forget` renames the copy that was sent away. At no time do two hosts hold the run, and after an interruption
the same steps can be repeated.
"""

import os
import shutil
import time
from collections.abc import Iterator
from pathlib import Path, PurePosixPath
from typing import IO, Final, Literal

from eia_sec.common.errors import HostError
from eia_sec.deploy.hosts import archive
from eia_sec.deploy.local.members import FOLDER
from eia_sec.deploy.local.run_directory import CONFIG, HISTORY, RunDirectory

RUN, LEAVING, ARRIVING, MOVED = "run", "leaving", "arriving", "moved"
"""Folders in a host's folder: the run, the learner's files on their way out and in, and what has moved away."""
MAX_ARCHIVE: Final = 64 * 1024**3
"""Largest archive of a learner's files, bytes."""
MAX_UNPACKED: Final = 128 * 1024**3
"""Most bytes of a learner's files."""

Holding = Literal["run", "leaving", "histories", "nothing"]
"""What a host holds of a run: the learner's files; those on their way to another host; its workers' histories alone."""
HOLDINGS: Final = ("run", "leaving", "histories", "nothing")


def holding(folder: Path) -> Holding:
    """Return what the folder holds of a run."""
    if RunDirectory(folder / RUN).holds_run():
        return "run"
    if (folder / LEAVING / CONFIG).exists():
        return "leaving"
    histories = (folder / RUN / HISTORY).glob("rollout-*.jsonl")
    return "histories" if any(path.stat().st_size for path in histories) else "nothing"


def member_holdings(folder: Path) -> dict[str, Holding]:
    """Return what the folder holds of the runs of a population's members, by their names."""
    found: dict[str, Holding] = {}
    for path in sorted((folder / RUN / FOLDER).glob("*")):
        histories = (path / HISTORY).glob("rollout-*.jsonl")
        if RunDirectory(path).holds_run():
            found[path.name] = "run"
        elif any(one.stat().st_size for one in histories):
            found[path.name] = "histories"
    return found


def is_learners(name: str) -> bool:
    """Return whether a path inside the run directory is the learner's: not a worker's history, not a lock."""
    path = PurePosixPath(name)
    workers = path.parts[:1] == (HISTORY,) and path.name.startswith("rollout-")
    return bool(path.parts) and not (workers or path.suffix == ".lock" or path.parts[0].startswith("."))


def release(folder: Path, out: IO[bytes]) -> None:
    """Set the learner's files aside and write an archive of them.

    Raises:
        HostError: there are no files of a learner.
        RunDirError: a learner runs here.
    """
    held, leaving = holding(folder), folder / LEAVING
    if held not in ("run", "leaving"):
        raise HostError(f"{folder} holds no run that could leave it.")
    run = RunDirectory(folder / RUN)
    run.lock("learner.lock", directory=True)
    try:
        if held == "run":
            forget(folder)
            leaving.mkdir()
            # The configuration goes first: from here on no learner resumes with a part of the files.
            os.replace(folder / RUN / CONFIG, leaving / CONFIG)
        _move(folder / RUN, leaving)
    finally:
        run.unlock()
    archive.pack(leaving, _files(leaving), out)


def take_in(folder: Path, packed: IO[bytes]) -> None:
    """Put the files of an archive of `release` in place.

    Raises:
        HostError: the folder holds a run, or the archive is malformed, incomplete or cannot be written.
    """
    if holding(folder) == "run":
        raise HostError(f"{folder} already holds a run.")
    arriving = folder / ARRIVING
    try:
        shutil.rmtree(arriving, ignore_errors=True)
        arriving.mkdir(parents=True)
        _, left_out = archive.unpack(packed, arriving, is_learners, MAX_UNPACKED)
        if left_out or not (arriving / CONFIG).is_file():
            raise HostError(f"what came is not a run: {', '.join(left_out[:3]) or f'{CONFIG} is missing'}.")
        (folder / RUN).mkdir(exist_ok=True)
        _move(arriving, folder / RUN)
        # The configuration comes last: until then the folder holds no run.
        os.replace(arriving / CONFIG, folder / RUN / CONFIG)
        shutil.rmtree(arriving, ignore_errors=True)
    except OSError as error:
        raise HostError(f"{folder} cannot be written: {error.strerror}.") from error


def forget(folder: Path) -> str:
    """Rename the folder of files that have left; return its new name, empty if there is none."""
    leaving = folder / LEAVING
    if not leaving.exists():
        return ""
    name = f"{MOVED}-{time.strftime('%Y%m%d-%H%M%S')}-{os.urandom(2).hex()}"
    leaving.rename(folder / name)
    return name


def _files(folder: Path) -> Iterator[Path]:
    """Yield the learner's files below a folder; links are none."""
    for path in sorted(folder.rglob("*")):
        if path.is_file() and not path.is_symlink() and is_learners(path.relative_to(folder).as_posix()):
            yield path


def _move(source: Path, target: Path) -> None:
    """Move the learner's files but the configuration to another folder of the same file system."""
    for path in list(_files(source)):
        name = path.relative_to(source)
        if name.as_posix() != CONFIG:
            (target / name).parent.mkdir(parents=True, exist_ok=True)
            os.replace(path, target / name)
