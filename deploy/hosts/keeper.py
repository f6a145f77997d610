"""The host supervisor: it keeps a host's processes running as the plan in the host's folder says.

A host's folder holds

    plan.json     the processes that should run, written by `eia-sec up` and `eia-sec down`
    state.json    the state of each process, written here
    keeper.lock   held while the keeper runs
    keeper.log    its log; logs/ holds one for each process
    config.toml   the learner's configuration
    keys/         a folder for each certificate
    run/          checkpoints, metrics and histories

When the keeper dies, its processes stop, as those of `eia-sec train` do.
"""

import fcntl
import json
import os
import time
from collections.abc import Collection, Mapping
from contextlib import suppress
from pathlib import Path
from typing import IO, Any, Final

from eia_sec.common.errors import HostError, UsageError
from eia_sec.common.log import log
from eia_sec.common.process import StopSignal
from eia_sec.common.transport.credentials import Identity
from eia_sec.deploy.hosts.plan import ORDER
from eia_sec.deploy.local.supervisor import Child, Supervisor

PLAN, STATE, LOCK, LOG, LOGS = "plan.json", "state.json", "keeper.lock", "keeper.log", "logs"
TICK_SECONDS: Final = 0.25
LOCK_SECONDS: Final = 2.0
FAREWELL_SECONDS: Final = 30.0
"""Time that the processes of one role have to stop when the keeper stops."""


def lock(folder: Path) -> IO[str] | None:
    """Take the folder's lock, or return None if a keeper holds it. Closing the file releases it."""
    held = (folder / LOCK).open("a", encoding="utf-8")
    try:
        fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        held.close()
        return None
    return held


def is_kept(folder: Path) -> bool:
    """Return whether a keeper holds the folder's lock. Any number of processes may ask at once."""
    with (folder / LOCK).open("a", encoding="utf-8") as held:
        try:
            fcntl.flock(held, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except OSError:
            return True
    return False


def write_json(path: Path, value: Any) -> None:
    """Write a JSON value to a file atomically."""
    temporary = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        temporary.write_text(json.dumps(value, indent=1) + "\n", encoding="utf-8")
        os.replace(temporary, path)
    except OSError:
        with suppress(OSError):
            temporary.unlink()
        raise


def shorten_json(path: Path, value: Any) -> None:
    """Overwrite a file with a JSON value that is no longer than its content, for which a full disk has room.

    Who reads it meanwhile may find a torn text; a keeper then keeps its plan and reads again.
    """
    with path.open("r+b") as file:
        file.write(json.dumps(value).encode())
        file.truncate()


def read_json(path: Path) -> dict[str, Any]:
    """Return the JSON object in a file, or an empty one if there is no file."""
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return {}
    except (OSError, ValueError) as error:
        raise HostError(f"{path} cannot be read: {error}") from error
    if not isinstance(found, dict):
        raise HostError(f"{path} does not hold a JSON object.")
    return found


def checked_names(processes: Mapping[str, dict[str, Any]]) -> dict[str, dict[str, Any]]:
    """Return the processes of a plan; raise UsageError unless each name is a role and a name: it becomes a file's."""
    return {str(Identity.parse(name)): process for name, process in dict(processes).items()}


class Keeper:
    """The loop that starts and stops processes until they match the plan.

    Args:
        folder: the host's folder, which is the working directory of every process.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._supervisor = Supervisor(folder / LOGS)
        self._wanted: dict[str, dict[str, Any]] = {}
        self._started: dict[str, dict[str, Any]] = {}
        self._since: dict[str, tuple[int, float]] = {}
        self._issue = 0
        self._read_at = (0, 0)
        self._written: dict[str, Any] = {}
        self._warned: dict[str, str] = {}

    def run(self, stop: StopSignal) -> None:
        """Keep the plan's processes running until the plan is empty or a signal arrives."""
        while not stop:
            self._read()
            self._supervisor.watch()
            self._apply()
            self._write_state()
            if not (self._wanted or self._running()):
                return
            stop.event.wait(TICK_SECONDS)
        for name in set(self._supervisor.children) - set(self._running()):
            self._supervisor.dismiss(name)
        for role in ORDER:
            named = [name for name in self._running() if name.startswith(f"{role}.")]
            self._supervisor.stop(named, FAREWELL_SECONDS)
        self._supervisor.watch()
        self._wanted = {}
        self._write_state()

    def _read(self) -> None:
        """Take up a new plan; keep the previous one while the file cannot be read."""
        try:
            held = (self._folder / PLAN).stat()
            changed = held.st_mtime_ns, held.st_ino  # two plans may have one time, where a file system's is coarse
            if changed == self._read_at:
                return
            plan = read_json(self._folder / PLAN)
            issue, wanted, again = int(plan["issue"]), checked_names(plan["processes"]), set(plan["again"])
        except (OSError, HostError, UsageError, KeyError, TypeError, ValueError) as error:
            if not self._issue:
                raise HostError(f"{PLAN} cannot be read: {error!r}.") from error
            self._warn(PLAN, f"{PLAN} cannot be read: {error!r}")
            return
        self._issue, self._wanted, self._read_at = issue, wanted, changed
        self._warned.pop(PLAN, None)
        for name in self._wanted:
            child = self._supervisor.children.get(name)
            if name not in again:  # what does not run by now has no work left
                self._started.setdefault(name, self._wanted[name])
            # A new plan may mean that the user has fixed a problem, so processes that were given up are tried again.
            elif child is None or (child.process is None and (child.given_up or child.done)):
                self._started.pop(name, None)

    def _warn(self, file: str, text: str) -> None:
        """Raise an alarm about a file unless it is the same as the last one."""
        if text != self._warned.get(file):
            self._warned[file] = text
            self._supervisor.alarm(text)

    def _apply(self) -> None:
        """Stop processes that differ from the plan, and start those that are missing."""
        running = self._running()
        for name, process in list(self._started.items()):
            if self._wanted.get(name) != process:
                log(f"keeper: stopping {name}.")
                self._supervisor.dismiss(name)
                del self._started[name]
        for name, process in self._wanted.items():
            if name not in self._started and name not in running:
                log(f"keeper: starting {name}.")
                self._supervisor.start(name, process["arguments"], int(process["threads"]))
                self._started[name] = process

    def _running(self) -> list[str]:
        return [name for name, child in self._supervisor.children.items() if _alive(child)]

    def _write_state(self) -> None:
        """Write the state if it has changed; a full disk raises an alarm, and the processes go on."""
        names = {**dict.fromkeys(self._started), **self._supervisor.children}
        children = {name: self._state(name, child) for name, child in names.items()}
        kept = {name: state for name, state in children.items() if name in self._wanted or state["pid"]}
        state = {
            "pid": os.getpid(),
            "issue": self._issue,
            "processes": kept,
            "alarms": self._supervisor.alarms[-10:],
        }
        if state == self._written:
            return
        try:
            write_json(self._folder / STATE, state)
        except OSError as error:
            self._warn(STATE, f"{STATE} cannot be written: {error.strerror}")
        else:
            self._written = state
            self._warned.pop(STATE, None)

    def _state(self, name: str, child: Child | None) -> dict[str, Any]:
        """Return the state of a process; one that a finished run did not start again has no child."""
        pid = child.process.pid if child is not None and child.process is not None and _alive(child) else 0
        if self._since.get(name, (-1, 0.0))[0] != pid:
            self._since[name] = (pid, time.time())
        if pid:
            word = "running" if name in self._started else "stopping"
        elif child is not None and child.given_up:
            word = "given up"
        else:
            word = "finished" if child is None or child.done else "restarting"
        deaths, code = (0, 0) if child is None else (child.deaths, child.code)
        return {"state": word, "pid": pid, "since": self._since[name][1], "deaths": deaths, "code": code}


def _alive(child: Child) -> bool:
    return child.process is not None and child.process.poll() is None


def keep(folder: Path) -> None:
    """Run the keeper of a folder until its plan is empty; raise HostError if another one runs."""
    deadline = time.monotonic() + LOCK_SECONDS
    # A status request holds the lock for a moment to see whether a keeper runs.
    while (held := lock(folder)) is None:
        if time.monotonic() > deadline:
            raise HostError(f"{folder} already has a keeper.")
        time.sleep(0.02)
    with held:
        os.chdir(folder)
        stop = StopSignal()
        stop.install()
        Keeper(Path()).run(stop)


def new_plan(processes: Mapping[str, dict[str, Any]], *, again: Collection[str]) -> dict[str, Any]:
    """Return a plan, with a number that its keeper repeats in the state once it has taken it up.

    Args:
        processes: what should run.
        again: those to be started where they do not run: processes that have finished or were given up, and new ones.
    """
    return {"issue": time.time_ns(), "processes": dict(processes), "again": list(again)}
