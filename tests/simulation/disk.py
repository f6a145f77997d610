"""The files of simulated processes: real ones in a temporary folder, where a kill may hit any single operation.

A write that is hit reaches the file in part. Where the power fails as well, what was written to a checkpoint and not
flushed is lost, and a rename that was not flushed may be undone. Histories survive: they promise no more than to
outlive their process (see `eia_sec.common.history.history`).
"""

import os
import shutil
from pathlib import Path, PosixPath
from types import TracebackType
from typing import Any, ClassVar

from tests.simulation.world import Killed, Process, World


class Disk:
    """Counts the operations of the current process, and ends it where its fuse says so.

    Args:
        world: whose current process it is.
    """

    def __init__(self, world: World) -> None:
        self._world = world
        self._flushed: dict[int, int] = {}
        self._renamed: list[tuple[Process, Path, Path]] = []
        self._opened: dict[int, tuple[Process, Path]] = {}

    def operate(self) -> bool:
        """Count an operation; return whether the process is killed in the middle of it."""
        process = self._world.current
        if process is None:
            return False
        if process.fuse is None:
            return False
        process.fuse -= 1
        if process.fuse < 0:
            raise Killed("in the middle of something")
        return process.fuse == 0

    def touch(self) -> None:
        """Count an operation that happens as a whole or not at all."""
        if self.operate():
            raise Killed("before an operation on its files")

    def opened(self, path: Path, inode: int) -> None:
        """Note that the current process writes a file."""
        if self._world.current is not None:
            self._opened[inode] = self._world.current, path
            self._flushed.setdefault(inode, 0)

    def flushed(self, handle: int) -> None:
        """Note that a file, or the names in a folder, are on disk."""
        found = os.fstat(handle)
        if found.st_ino in self._opened:
            self._flushed[found.st_ino] = found.st_size
        else:
            self._renamed = [entry for entry in self._renamed if entry[1].parent.stat().st_ino != found.st_ino]

    def renamed(self, source: Path, target: Path) -> None:
        """Note a rename."""
        if self._world.current is not None:
            self._renamed.append((self._world.current, target, source))

    def power_cut(self, process: Process) -> None:
        """Lose what the process has written under a folder of checkpoints and not flushed."""
        for owner, target, source in reversed(self._renamed):
            if owner is process and os.path.exists(target) and self._world.draw.random() < 0.5:
                self._world.note(f"the rename to {target.name} is undone")
                os.rename(target, source)
        self._renamed = [entry for entry in self._renamed if entry[0] is not process]
        for inode, (owner, path) in self._opened.items():
            if owner is process and "checkpoints" in path.parts:
                for found in Path(os.fspath(path)).parent.parent.glob("*/*"):
                    if found.stat().st_ino == inode and found.stat().st_size > self._flushed[inode]:
                        self._world.note(f"{found.parent.name}/{found.name} loses what was not flushed")
                        os.truncate(found, self._flushed[inode])


class SimulatedPath(PosixPath):
    """A path whose operations the disk counts."""

    disk: ClassVar[Disk]

    def open(self, mode: str = "r", *arguments: Any, **options: Any) -> Any:
        """Open a file, whose writes are counted if it is for writing."""
        if mode in ("r", "rb"):
            return super().open(mode, *arguments, **options)
        self.disk.touch()
        file = super().open(mode, *arguments, **options)
        self.disk.opened(self, os.fstat(file.fileno()).st_ino)
        return _Written(file, self.disk)

    def rename(self, target: Any) -> Any:
        """Rename a file."""
        self.disk.touch()
        found = super().rename(target)
        self.disk.renamed(self, Path(target))
        return found

    def mkdir(self, *arguments: Any, **options: Any) -> None:
        """Make a folder."""
        self.disk.touch()
        super().mkdir(*arguments, **options)


class _Written:
    def __init__(self, file: Any, disk: Disk) -> None:
        self._file, self._disk = file, disk

    def write(self, data: Any) -> int:
        if self._disk.operate():
            part = len(data) * self._disk._world.draw.randrange(100) // 100
            self._file.write(data[:part])
            self._file.flush()
            raise Killed(f"after {part} of {len(data)} bytes of a write")
        return int(self._file.write(data))

    def writelines(self, lines: Any) -> None:
        for line in lines:
            self.write(line)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._file, name)

    def __enter__(self) -> "_Written":
        return self

    def __exit__(self, kind: type[BaseException] | None, error: Any, trace: TracebackType | None) -> None:
        self._file.close()


class CountedOs:
    """The module `os` for those who write files."""

    def __init__(self, disk: Disk) -> None:
        self._disk = disk

    def replace(self, source: Any, target: Any) -> None:
        """Rename a file over another."""
        self._disk.touch()
        os.replace(source, target)

    def fsync(self, handle: int) -> None:
        """Flush a file or a folder."""
        self._disk.touch()
        self._disk.flushed(handle)

    def __getattr__(self, name: str) -> Any:
        return getattr(os, name)


class CountedShutil:
    """The module `shutil` for those who remove files."""

    def __init__(self, disk: Disk) -> None:
        self._disk = disk

    def rmtree(self, path: Any, ignore_errors: bool = False) -> None:
        """Remove a folder."""
        self._disk.touch()
        shutil.rmtree(path, ignore_errors)
