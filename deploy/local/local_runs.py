"""The runs of this machine: each learner keeps a small file while it lives, by which monitors find it.

The files lie in `eia-sec/runs` of the user's state directory (`XDG_STATE_HOME`, else `~/.local/state`), readable by the
user alone. A learner holds a lock on its own. One whose lock is free was left by a process that was killed.
"""

import fcntl
import json
import os
import re
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from tempfile import mkstemp
from typing import IO, Final

from eia_sec.common.errors import EndpointError, UsageError
from eia_sec.common.log import log
from eia_sec.common.names import is_name
from eia_sec.common.text import printable
from eia_sec.common.transport.bus import Bus
from eia_sec.common.transport.endpoint import DEFAULT, Endpoint
from eia_sec.deploy.listener import connected
from eia_sec.deploy.local.run_directory import TRAIN_LOCK
from eia_sec.deploy.progress import Countdown

MOST_BYTES: Final = 16_384
"""Longest file that is read."""
MOST_RUNS: Final = 1024
"""Most files that are looked at."""
LOOK_SECONDS: Final = 0.2
RUN: Final = "farm"
"""Name of a run where none is given."""


@dataclass(frozen=True)
class LocalRun:
    """A run whose learner lives on this machine.

    Attributes:
        run: its name.
        endpoint: where its processes meet.
        run_dir: its directory, or empty.
        environment: name of its environment.
        tls: whether readers need a certificate.
    """

    run: str
    endpoint: str
    run_dir: str
    environment: str
    tls: bool

    @property
    def options(self) -> str:
        """The options of a command that reads it."""
        return f"--run {self.run} --connect {self.endpoint}{' --tls FOLDER' if self.tls else ''}"


def folder() -> Path:
    """Return where the files lie; raise RuntimeError where there is neither a variable nor a home directory."""
    state = os.environ.get("XDG_STATE_HOME", "")
    return (Path(state) if os.path.isabs(state) else Path.home() / ".local" / "state") / "eia-sec" / "runs"


@contextmanager
def listed(run: LocalRun) -> Iterator[None]:
    """List a run in this block. Where no file can be kept, a line of the log says so, and nothing else changes."""
    file: IO[str] | None = None
    path = Path()
    try:
        place = folder()
        place.mkdir(mode=0o700, parents=True, exist_ok=True)
        number, name = mkstemp(prefix=f"{run.run}-", suffix=_mark(), dir=place)
        path, file = Path(name), os.fdopen(number, "w", encoding="utf-8")
        fcntl.flock(file, fcntl.LOCK_EX)
        file.write(json.dumps(asdict(run)))
        file.flush()
        path = path.rename(f"{name}.json")  # from now on it is found, and its lock is held
    except (OSError, RuntimeError) as error:
        log(f"monitors of this machine find this run by --run and --connect alone: {error}.")
    try:
        yield
    finally:
        if file is not None:
            with suppress(OSError):
                path.unlink()
            file.close()


def _mark() -> str:
    """Return how names of files end that this machine has made: a home directory may be another's, too."""
    return f"@{re.sub('[^A-Za-z0-9.-]', '-', socket.gethostname())[:128]}"


def local_runs() -> list[LocalRun]:
    """Return the runs whose learners live, by name; files that killed learners have left are removed."""
    found = []
    with suppress(OSError, RuntimeError):
        for path in sorted(folder().glob(f"*{_mark()}.json"))[:MOST_RUNS]:
            with suppress(OSError, ValueError, TypeError):
                run = _read(path)
                if run is not None:
                    found.append(run)
    # A learner and its successor at a router are one run.
    return sorted({(run.run, run.endpoint): run for run in found}.values(), key=lambda run: (run.run, run.endpoint))


def _read(path: Path) -> LocalRun | None:
    """Return a living run; of one that does not live, remove the file.

    Raises:
        OSError, ValueError, TypeError: the file cannot be read, or holds no run.
    """
    with os.fdopen(os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)) as file:
        try:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            run = LocalRun(**json.loads(file.read(MOST_BYTES)))
            if not (is_name(run.run) and all(isinstance(v, str) for v in (run.endpoint, run.run_dir, run.environment))):
                raise ValueError("no run") from None
            return run
        path.unlink()
    return None


def chosen(
    run_dir: Path | None, run: str | None, connect: str | None, patience: float, waiting: Callable[[], bool]
) -> LocalRun:
    """Return which run a command reads.

    Args:
        run_dir: a directory of a run of this machine, or None.
        run: a run's name, or None.
        connect: an endpoint, or None.
        patience: how long to wait for the learner of a directory in which a run has begun, s.
        waiting: called meanwhile; False gives up.

    Raises:
        UsageError: the directory is that of no run here, or several runs fit.
    """
    if run_dir is not None:
        if run is not None or connect is not None:
            raise UsageError("give a run directory, or --run and --connect, not both.")
        return _in_directory(run_dir, patience, waiting)
    runs = local_runs()
    fitting = [one for one in runs if run in (None, one.run) and connect in (None, one.endpoint)]
    if len(fitting) > 1:
        raise UsageError(f"several runs are training; name one of them{_here(fitting)}")
    if fitting:
        return fitting[0]
    return LocalRun(run or RUN, connect or DEFAULT, "", "", tls=False)


def _in_directory(run_dir: Path, patience: float, waiting: Callable[[], bool]) -> LocalRun:
    """Return the run of a directory, once its learner lives; raise UsageError if none comes."""
    until = time.monotonic() + patience
    with Countdown(f"the learner of {printable(str(run_dir))}", patience, waiting) as waits:
        while True:
            runs = local_runs()
            for one in runs:
                if one.run_dir and os.path.realpath(run_dir) == os.path.realpath(one.run_dir):
                    return one
            if not (_supervised(run_dir) and waits() and time.monotonic() < until):
                raise UsageError(f"no run is training in {printable(str(run_dir))}{_here(runs)}")
            time.sleep(LOOK_SECONDS)


def _supervised(run_dir: Path) -> bool:
    """Return whether `eia-sec train` is at work in a directory: it is there before its learner is."""
    try:
        with os.fdopen(os.open(run_dir / TRAIN_LOCK, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)) as file:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:
        return False
    return False


def reached(run: LocalRun, tls: Path | None, patience: float, waiting: Callable[[], bool]) -> Bus:
    """Return a session with the control lane of a run.

    Args:
        run: the run.
        tls: folder of this process's certificate, or None.
        patience: how long to wait for a listener, s.
        waiting: called meanwhile; False gives up.

    Raises:
        EndpointError: nobody answers there; the sentence also names what does train on this machine.
    """
    endpoint = Endpoint.parse(run.endpoint, tls)
    try:
        return connected(endpoint, patience, waiting)
    except EndpointError as error:
        if type(error) is not EndpointError:
            raise
        raise EndpointError(f"{str(error).rstrip('.')}{_here(local_runs())}") from None


def _here(runs: list[LocalRun]) -> str:
    if not runs:
        return "; none is training on this machine."
    lines = [f"\n  {run.options}" + (f"   # {printable(run.run_dir)}" if run.run_dir else "") for run in runs]
    return "; on this machine there are:" + "".join(lines)
