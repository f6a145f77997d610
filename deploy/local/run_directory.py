"""The run directory: one configuration, used by one process at a time."""

import errno
import fcntl
import json
import os
from contextlib import suppress
from pathlib import Path
from typing import IO

from eia_sec.common.config import RunConfig
from eia_sec.common.config.files import differences, method_of, read_saved, to_toml
from eia_sec.common.errors import EiaSecError, RunDirError
from eia_sec.common.policy_file import POLICY
from eia_sec.common.team import TeamSpec, described
from eia_sec.deploy.local.file_ends import last_lines

CONFIG = "config.toml"
TEAM = "team.json"
"""The layout of the team that the run trains."""
TRAIN_LOCK = "train.lock"
MOST_TEAM_BYTES = 2**24
METRICS = "metrics.jsonl"
LAST_LINE_BYTES = 2**16
"""Bytes at the end of metrics.jsonl that are read to find its last line; the final record is far shorter."""
HISTORY = "history"
"""Folder of the processes' histories, see `eia_sec.common.history.history`."""


def own_folder(run_dir: Path, name: str) -> Path:
    """Return a folder inside a run directory. The run directory may come from somebody else.

    Raises:
        RunDirError: it is a symbolic link, which may lead anywhere.
    """
    if (run_dir / name).is_symlink():
        raise RunDirError(f"{run_dir / name} is a symbolic link; name the output folder with --out.")
    return run_dir / name


def new_folder(parent: Path, name: str) -> Path:
    """Make a folder that nobody else has: `name`, or `name-2`, `name-3`, ... where runs begin in the same second.

    Raises:
        RunDirError: this user may not write here.
    """
    path, number = parent / name, 1
    try:
        parent.mkdir(parents=True, exist_ok=True)
        while True:
            try:
                path.mkdir()
            except FileExistsError:
                number += 1
                path = parent / f"{name}-{number}"
            else:
                return path
    except OSError as error:
        raise RunDirError(f"cannot write into {parent}: {error.strerror}.") from error


def require_no_links(run_dir: Path) -> None:
    """Refuse a run directory with symbolic links: a run writes into it, and it may come from somebody else.

    The run directory itself is the user's choice and may be a link.

    Raises:
        RunDirError: something in it is a symbolic link, which may lead anywhere.
    """
    for folder, folders, files in os.walk(run_dir):
        for name in sorted((*folders, *files)):
            if (path := Path(folder, name)).is_symlink():
                raise RunDirError(f"{path} is a symbolic link, and a run writes inside its directory only; remove it.")


def no_run(path: Path, name: str = CONFIG) -> str:
    """Return the sentence about a folder in which a run's file is missing, or which is missing itself."""
    return f"{path} is not a run directory: it has no {name}." if path.is_dir() else f"there is no directory {path}."


class RunDirectory:
    """A folder with config.toml, team.json, metrics.jsonl, policy.safetensors, checkpoints/, history/ and logs/."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._lock: IO[str] | None = None
        self._folder: int | None = None

    def prepare(self, config: RunConfig, *, resume: bool) -> None:
        """Create the folder with its configuration, or check that it has this configuration.

        A resumed run may change the settings of its processes, see `eia_sec.common.config.files.method_of`.

        Raises:
            RunDirError: the folder holds a symbolic link, or another configuration; `resume` is False and it holds a
                run; `resume` is True and it holds none; or this user cannot read and write it.
        """
        try:
            self._prepare(config, resume=resume)
        except OSError as error:
            raise RunDirError(f"cannot read and write {self.path}: {error.strerror}.") from error

    def _prepare(self, config: RunConfig, *, resume: bool) -> None:
        require_no_links(self.path)
        held = self.path / CONFIG
        if held.exists():
            if not resume and (self.path / METRICS).exists():
                raise RunDirError(f"{self.path} already holds a run; add --resume or choose another --run-dir.")
            self._compare(read_saved(held), config, resume=resume)
            return
        if resume:
            raise RunDirError(f"{self.path} holds no run to resume.")
        if self.path.exists() and (not self.path.is_dir() or any(self._foreign_files())):
            raise RunDirError(f"{self.path} exists and is not a run directory; choose another --run-dir.")
        self.path.mkdir(parents=True, exist_ok=True)
        self._store(CONFIG, to_toml(config))

    def lock(self, name: str, *, directory: bool = False) -> None:
        """Reserve the folder for this process. The lock ends with the process.

        Args:
            name: file in the folder that is locked; processes with different names do not exclude each other.
            directory: lock the folder itself as well. Unlike a file in it, nobody can remove the folder while it is in
                use and put a new one beside the lock. File systems that lock no folders, such as NFS, lack this.

        Raises:
            RunDirError: while another process holds the lock, when this user may not write here, or when a link here
                leads elsewhere.
        """
        try:
            require_no_links(self.path)
            self._lock = os.fdopen(_not_followed(self.path / name, os.O_WRONLY | os.O_APPEND | os.O_CREAT), "a")
            if directory:
                self._folder = os.open(self.path, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        except OSError as error:
            raise RunDirError(f"cannot write into {self.path}: {error.strerror}.") from error
        try:
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if self._folder is not None:
                _lock_folder(self._folder)
        except OSError as error:
            self.unlock()
            raise RunDirError(f"{self.path} is in use by another process.") from error
        with suppress(OSError):  # the number only helps whoever looks for the owner; a full disk may lack room for it
            self._lock.truncate(0)
            self._lock.write(str(os.getpid()))
            self._lock.flush()

    def unlock(self) -> None:
        """End what `lock` reserved before the process does."""
        if self._lock is not None:
            self._lock.close()
            self._lock = None
        if self._folder is not None:
            os.close(self._folder)
            self._folder = None

    def adopt(self, config: RunConfig, team: TeamSpec) -> None:
        """Store a configuration that `prepare` has accepted, and the team; the folder must be locked.

        Raises:
            RunDirError: the folder holds a run of another team, or this user may not write here.
        """
        held = self.team() if (self.path / METRICS).exists() else None
        if held is not None and held != team:
            raise RunDirError(
                f"the run in {self.path} is for {described(held)}, but this environment has {described(team)}."
            )
        try:
            if self.configuration() != config:
                self._store(CONFIG, to_toml(config))
            if held is None:
                self._store(TEAM, json.dumps(team.to_dict(), indent=2))
        except OSError as error:
            raise RunDirError(f"cannot write into {self.path}: {error.strerror}.") from error

    def team(self) -> TeamSpec | None:
        """Return the team of the run here, or None where none was stored; raise RunDirError if it is damaged."""
        try:
            with (self.path / TEAM).open("rb") as file:
                return TeamSpec.from_dict(json.loads(file.read(MOST_TEAM_BYTES)))
        except FileNotFoundError:
            return None
        except OSError as error:
            raise RunDirError(f"cannot read {self.path / TEAM}: {error.strerror}.") from error
        except (EiaSecError, ValueError, TypeError, LookupError, AttributeError, RecursionError) as error:
            raise RunDirError(f"{self.path / TEAM} is damaged: {error}") from error

    def _store(self, name: str, text: str) -> None:
        """Write a file; on a full disk none is left, rather than a part of it."""
        fresh = self.path / f"{name}.new"
        try:
            fresh.unlink(missing_ok=True)  # it may be somebody's link
            fresh.write_text(text, encoding="utf-8")
            fresh.replace(self.path / name)
        except OSError:
            with suppress(OSError):
                fresh.unlink()
            raise

    def configuration(self) -> RunConfig:
        """Return the configuration.

        Raises:
            RunDirError: the folder has no configuration.
        """
        held = self.path / CONFIG
        if not held.exists():
            raise RunDirError(no_run(self.path, CONFIG))
        return read_saved(held)

    def holds_run(self) -> bool:
        """Return whether the folder has a configuration."""
        return (self.path / CONFIG).exists()

    def finished(self) -> bool:
        """Return whether the newest start of the learner here finished its run."""
        try:
            lines = last_lines(self.path / METRICS, LAST_LINE_BYTES)
        except OSError:
            return False
        return bool(lines) and '"kind": "end"' in lines[-1] and '"state": "finished"' in lines[-1]

    def _compare(self, held: RunConfig, wanted: RunConfig, *, resume: bool) -> None:
        found = differences(method_of(held), method_of(wanted)) if resume else differences(held, wanted)
        if found:
            more = f" and {len(found) - 3} more" if len(found) > 3 else ""
            longer = resume and (held.episodes, held.steps) != (wanted.episodes, wanted.steps)
            hint = f" (a run cannot be lengthened; begin another one as its policy: {self._start})" if longer else ""
            raise RunDirError(f"{self.path} belongs to another configuration: {'; '.join(found[:3])}{more}{hint}.")

    @property
    def _start(self) -> str:
        return f"--algorithm.start-policy all={self.path / POLICY}"

    def _foreign_files(self) -> list[Path]:
        return [
            entry
            for entry in self.path.iterdir()
            if entry.name not in ("logs", HISTORY, f"{CONFIG}.new") and entry.suffix != ".lock"
        ]


def _not_followed(path: str | Path, flags: int) -> int:
    return os.open(path, flags | os.O_NOFOLLOW | os.O_CLOEXEC, 0o666)


def _lock_folder(descriptor: int) -> None:
    """Lock an open folder where the file system can; raise BlockingIOError while another process has it."""
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise
    except OSError as error:
        if error.errno not in (errno.EBADF, errno.EINVAL, errno.ENOTSUP, errno.ENOLCK):
            raise
