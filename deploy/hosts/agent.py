"""The remote end of `eia-sec up`, `down`, `status` and `logs`: their work in one host's folder, on that host."""

import hashlib
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

from eia_sec.common.config.files import differences, method_of, read_saved
from eia_sec.common.errors import ConfigError, EndpointError, HostError
from eia_sec.common.protocol import keys
from eia_sec.common.transport.bus import Bus
from eia_sec.common.transport.credentials import Identity
from eia_sec.common.transport.endpoint import Endpoint
from eia_sec.deploy.hosts import keeper
from eia_sec.deploy.hosts.keeper import LOG, LOGS, PLAN, STATE, read_json, write_json
from eia_sec.deploy.hosts.learner_move import RUN, holding, member_holdings
from eia_sec.deploy.hosts.plan import ORDER
from eia_sec.deploy.local import contained_files
from eia_sec.deploy.local.file_ends import last_lines
from eia_sec.deploy.local.run_directory import CONFIG, HISTORY, RunDirectory

START_SECONDS: Final = 30.0
"""Time that a keeper has to take up a plan."""
KILL_SECONDS: Final = 5.0
ORPHAN_SECONDS: Final = 25.0
"""Time that the processes of a killed keeper have to end by themselves."""
PROBE_SECONDS: Final = 2.0
"""Time that a listener has to answer when a host asks it for a process's token."""
PROCESSES: Final = Path("/proc")
"""Where Linux has a folder for each process."""
MAX_LINES: Final = 10_000
LINE_BYTES: Final = 400
"""Assumed bytes per line of a log; fewer lines are shown where they are longer."""


def up(
    folder: Path,
    processes: Mapping[str, dict[str, Any]],
    files: Mapping[str, str],
    start: str,
    *,
    again: Collection[str] | None = None,
) -> dict[str, Any]:
    """Write a plan and its files, start a keeper if there is none, and wait until it has taken up the plan.

    Args:
        folder: the host's folder; made if missing.
        processes: for each name, arguments and threads.
        files: texts by path in the folder; readable by the owner only.
        start: how to start the keeper, "detached" or "systemd".
        again: names of those to be started where they do not run; None for all. Those of a finished run are not.

    Returns:
        What `status` returns.

    Raises:
        HostError: a file cannot be written, or the keeper did not come up.
        UsageError: a file or a process has an impossible name.
    """
    keeper.checked_names(processes)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name, text in files.items():
            contained_files.write(folder, name, text.encode())
        (folder / RUN / HISTORY).mkdir(parents=True, exist_ok=True)
        plan = keeper.new_plan(processes, again=processes if again is None else again)
        write_json(folder / PLAN, plan)
    except OSError as error:
        raise HostError(f"{folder} cannot be written: {error.strerror}.") from error
    _await_orphans(folder)
    _ensure_keeper(folder, start, plan["issue"])
    deadline = time.monotonic() + START_SECONDS
    while not _taken_up(folder, plan["issue"]):
        if time.monotonic() > deadline:
            last = _tail(folder / LOG, 1)
            raise HostError(
                f"the keeper of {folder} did not start within {START_SECONDS:.0f} s{': ' if last else ''}{last}"
            )
        # It may have ended between two checks, because the previous plan was empty.
        _ensure_keeper(folder, start, plan["issue"])
        time.sleep(0.1)
    return status(folder)


def down(folder: Path, roles: Sequence[str], seconds: float, kill: bool) -> dict[str, Any]:
    """Remove processes from the plan, and wait until they have stopped.

    Args:
        folder: the host's folder.
        roles: their roles, or their names.
        seconds: how long to wait.
        kill: whether to kill those that are still running then.

    Returns:
        "ended" and "left": names of processes.
    """
    plan = read_json(folder / PLAN)
    named = [name for name in plan.get("processes", {}) if _is_one_of(name, roles)]
    before = _pids(folder, roles)
    if named:
        rest = {name: process for name, process in plan["processes"].items() if name not in named}
        fresh = keeper.new_plan(rest, again=())
        try:
            write_json(folder / PLAN, fresh)
        except OSError:  # a full disk
            keeper.shorten_json(folder / PLAN, fresh)
    left, deadline = before, time.monotonic() + seconds
    while left and time.monotonic() < deadline:
        time.sleep(0.1)
        # On a full disk the keeper's state stays what it was, so it is asked for each process whether it is there.
        left = {n: pid for n, pid in _pids(folder, roles).items() if before.get(n) == pid and _is_ours(pid, folder)}
    if left and kill:
        for pid in left.values():
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        deadline = time.monotonic() + KILL_SECONDS
        while left and time.monotonic() < deadline:
            time.sleep(0.1)
            left = {name: pid for name, pid in _pids(folder, roles).items() if _is_ours(pid, folder)}
    return {"ended": sorted(set(before) - set(left)), "left": sorted(left)}


def status(
    folder: Path,
    learners: Mapping[str, Mapping[str, str]] | None = None,
    probes: Mapping[str, Mapping[str, Any]] | None = None,
) -> dict[str, Any]:
    """Return the keeper's process id, the state of its processes, its alarms, and what it holds of runs.

    Args:
        folder: the host's folder.
        learners: by the learner's name, `run`, its run's folder in that folder, and `config`, its configuration; those
            that have finished are named as "over".
        probes: by the process's name, where to ask whether it lives, see `_living`; those that do are named as "alive".
    """
    if not folder.is_dir():
        nothing = {"keeper": 0, "processes": {}, "alarms": [], "holds": "nothing", "members": {}}
        return nothing | {"over": [], "alive": []}
    state = read_json(folder / STATE)
    alive = keeper.is_kept(folder)
    processes = state.get("processes", {}) if alive else {}
    return {
        "keeper": state.get("pid", 0) if alive else 0,
        "processes": processes,
        "alarms": state.get("alarms", []),
        "holds": holding(folder),
        "members": member_holdings(folder),
        "over": [name for name, one in (learners or {}).items() if _is_over(folder / one["run"], one["config"])],
        "alive": _living(folder, probes or {}),
    }


def _living(folder: Path, probes: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """Return which processes live: whose liveliness token their listener knows in one of their runs.

    A router has no token. It lives when it answers, a site's when a learner's token reaches it.

    Args:
        folder: the host's folder.
        probes: for each process `connect`, the listener's endpoint; `runs`, its runs; `name`, its name there; `tls`,
            the folder of its certificate, or nothing.
    """
    found, silent = [], set[str]()
    for label, where in probes.items():
        who = Identity.parse(label)
        if where["connect"] in silent:
            continue
        credentials = folder / where["tls"] if where["tls"] else None
        try:
            with Bus.connect(Endpoint.parse(where["connect"], credentials), "control", PROBE_SECONDS) as bus:
                role, name = ("learner", "learner") if who.role == "site" else (who.role, where["name"])
                tokens = (bus.living(keys.LIVE.key(run, role=role, name=name)) for run in where["runs"])
                if who.role == "router" or any(tokens):
                    found.append(label)
        except EndpointError:
            silent.add(where["connect"])
    return found


def logs(folder: Path, names: Sequence[str], lines: int) -> dict[str, str]:
    """Return the last lines of the logs of processes (of all if none is named) and the keeper."""
    return {name: _tail(path, max(1, min(lines, MAX_LINES))) for name, path in log_files(folder, names).items()}


def log_files(folder: Path, names: Sequence[str]) -> dict[str, Path]:
    """Return the log files of processes (of all if none is named) and the keeper, by name."""
    found = {path.stem: path for path in sorted((folder / LOGS).glob("*.log"))} | {"keeper": folder / LOG}
    return {name: path for name, path in found.items() if not names or name in names}


def _is_over(path: Path, wanted: str) -> bool:
    """Return whether the learner has finished the run in a folder, if that is the run that a configuration describes.

    With another configuration the learner is to start, and says what differs.
    """
    run = RunDirectory(path)
    if not (run.holds_run() and run.finished()):
        return False
    with suppress(OSError, UnicodeDecodeError):
        if (run.path / CONFIG).read_text(encoding="utf-8") == wanted:
            return True
    try:
        return not differences(method_of(run.configuration()), method_of(read_saved(wanted)))
    except ConfigError:
        return False  # a plug-in's options, which this process does not know


def _await_orphans(folder: Path) -> None:
    """Wait until the processes of a killed keeper have ended: they still hold the run directory and the ports.

    One that does not end in time is left alone; the new keeper's log then says what is in use.
    """
    if keeper.is_kept(folder):
        return
    kept: dict[str, Any] = {}
    with suppress(HostError):  # a torn state names nobody
        kept = read_json(folder / STATE).get("processes", {})
    pids = [int(process.get("pid", 0)) for process in kept.values()]
    deadline = time.monotonic() + ORPHAN_SECONDS
    while any(pid and _is_ours(pid, folder) for pid in pids) and time.monotonic() < deadline:
        time.sleep(0.1)


def _is_ours(pid: int, folder: Path) -> bool:
    """Return whether a process of that number exists and works in the folder, as all of a keeper's do."""
    try:
        if not PROCESSES.is_dir():  # not Linux: its place is not known
            os.kill(pid, 0)
            return True
        return (PROCESSES / str(pid) / "cwd").readlink() == folder.resolve()
    except OSError:
        return False


def _taken_up(folder: Path, issue: int) -> bool:
    """Return whether a keeper has taken up the plan of that number; one with nothing to keep ends right after it."""
    with suppress(HostError):  # a torn file of an earlier keeper is replaced by the next one
        return bool(read_json(folder / STATE).get("issue") == issue)
    return False


def _ensure_keeper(folder: Path, start: str, issue: int) -> None:
    """Start a keeper unless one holds the folder's lock; of two that start at once, one exits."""
    if keeper.is_kept(folder):
        return
    command = [sys.executable, "-P", "-m", "eia_sec.deploy.cli", "host", "keep", "--folder", str(folder.resolve())]
    if start == "systemd":
        _start_unit(folder, command)
        process = None
    else:
        with (folder / LOG).open("ab") as output:
            process = subprocess.Popen(
                command, stdin=subprocess.DEVNULL, stdout=output, stderr=output, start_new_session=True
            )
    deadline = time.monotonic() + START_SECONDS
    while not (keeper.is_kept(folder) or _taken_up(folder, issue)) and time.monotonic() < deadline:
        if process is not None and process.poll() is not None:
            return
        time.sleep(0.05)


def _start_unit(folder: Path, command: Sequence[str]) -> None:
    """Start the keeper as a transient unit of the user's systemd."""
    if shutil.which("systemd-run") is None:
        raise HostError('this host has no systemd-run; set start = "detached" for it.')
    unit = f"eia-sec-{hashlib.sha256(str(folder.resolve()).encode()).hexdigest()[:12]}"
    log = f"--property=StandardError=append:{folder.resolve() / LOG}"
    passed = [f"--setenv={name}={value}" for name, value in os.environ.items() if name.startswith("PYTHON")]
    # The keeper alone gets SIGTERM, and stops its processes one role after another; without it they end by themselves.
    ends = ["--property=KillMode=process", f"--property=TimeoutStopSec={keeper.FAREWELL_SECONDS * len(ORDER) + 30:.0f}"]
    words = ["systemd-run", "--user", "--quiet", "--collect", f"--unit={unit}", log, *ends, *passed, "--", *command]
    deadline = time.monotonic() + START_SECONDS
    while True:
        try:
            done = subprocess.run(words, capture_output=True, text=True, check=False, timeout=START_SECONDS)
        except subprocess.TimeoutExpired as error:
            raise HostError(f"systemd-run did not start the keeper within {START_SECONDS:.0f} s.") from error
        if not done.returncode:
            return
        if keeper.is_kept(folder):  # another `up` was faster
            return
        # The unit of a keeper that has just ended may still be there.
        if "already" not in done.stderr or time.monotonic() > deadline:
            raise HostError(f"systemd-run did not start the keeper: {done.stderr.strip()[-200:]}")
        time.sleep(0.5)


def _pids(folder: Path, roles: Sequence[str]) -> dict[str, int]:
    """Return the process ids of the running processes of some roles or names, by name."""
    found = status(folder)["processes"]
    return {name: int(p["pid"]) for name, p in found.items() if p["pid"] and _is_one_of(name, roles)}


def _is_one_of(name: str, roles: Sequence[str]) -> bool:
    """Return whether a process has one of these roles, or one of these names."""
    return name in roles or name.split(".", maxsplit=1)[0] in roles


def _tail(path: Path, lines: int) -> str:
    try:
        return "\n".join(last_lines(path, LINE_BYTES * lines)[-lines:])
    except OSError:
        return ""
