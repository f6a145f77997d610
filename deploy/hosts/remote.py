"""The local end: calls `eia-sec host` on a host, over the system's SSH client or directly."""

import json
import os
import select
import shlex
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any, Final, TypeVar

from eia_sec.common.errors import HostError
from eia_sec.common.process import StopSignal
from eia_sec.deploy.hosts.fleet_file import LOCAL, FleetSpec, Host

CONNECT_SECONDS: Final = 10
CALL_SECONDS: Final = 90.0
"""Longest time for a call, besides the time that it is meant to wait."""
MAX_ANSWER: Final = 256 * 1024**2
"""Longest answer to a call, bytes: the last lines of many logs."""
MAX_SAID: Final = 1024**2
"""Longest error output of a host, bytes."""
MAX_LINE: Final = 4 * 1024**2
"""Longest line of a stream, bytes; a longer one ends the stream."""
LOOK_SECONDS: Final = 0.2
"""Longest time until a stop is noticed."""
END_SECONDS: Final = 5.0
"""Time that a host has to notice that the caller has gone."""
SSH_FAILED: Final = 255
"""Exit code of `ssh` without a connection."""
NOT_FOUND: Final = 127
AT_ONCE: Final = 16
"""Most hosts that are called at the same time."""

R = TypeVar("R")


@dataclass(frozen=True)
class Link:
    """A connection to one host.

    Attributes:
        name: its name in the fleet file.
        host: its table in the fleet file.
        base: folder that a local host's folder is relative to.
        sockets: folder for SSH's shared connections.
    """

    name: str
    host: Host
    base: Path
    sockets: Path
    _given_up: threading.Event = field(default_factory=threading.Event)

    def give_up(self) -> None:
        """End the calls that wait for this host; they raise HostError."""
        self._given_up.set()

    def call(self, verb: str, request: dict[str, Any], seconds: float = 0.0) -> dict[str, Any]:
        """Call a verb of `eia-sec host` and return its JSON answer.

        Args:
            verb: see `eia_sec.deploy.commands.fleet.host`.
            request: its arguments.
            seconds: how long the host is meant to wait.

        Raises:
            HostError: the host cannot be reached, has no eia-sec, or failed.
        """
        with self.fetch(verb, json.dumps(request).encode(), seconds) as answered:
            output = answered.read()
        try:
            answer = json.loads(output)
        except (ValueError, RecursionError) as error:
            raise HostError(f"{self.name}: its answer is not JSON: {output[:80]!r}.") from error
        if not isinstance(answer, dict):
            raise HostError(f"{self.name}: its answer is not a JSON object.")
        return answer

    def fetch(
        self, verb: str, request: bytes | IO[bytes] = b"", seconds: float = 0.0, most: int = MAX_ANSWER
    ) -> IO[bytes]:
        """Call a verb of `eia-sec host` and return a file with its answer, which may not fit into memory.

        Args:
            verb: see `eia_sec.deploy.commands.fleet.host`.
            request: its arguments, or an open file with what it is to read.
            seconds: how long the host is meant to wait.
            most: longest answer, bytes.

        Raises:
            HostError: the host cannot be reached, has no eia-sec, failed, or answers too much.
        """
        command = self._command(verb)
        with ExitStack() as files, ExitStack() as kept:
            said, answer = files.enter_context(tempfile.TemporaryFile()), kept.enter_context(tempfile.TemporaryFile())
            if isinstance(request, bytes):
                asked: IO[bytes] = files.enter_context(tempfile.TemporaryFile())
                asked.write(request)
                asked.seek(0)
            else:
                asked = request
            try:
                process = subprocess.Popen(command, stdin=asked, stdout=answer, stderr=said)
            except OSError as error:
                raise HostError(f"{self.name}: {command[0]} cannot be started: {error.strerror}.") from error
            code = self._wait(process, CALL_SECONDS + seconds, ((answer, most), (said, MAX_SAID)))
            if code:
                said.seek(0)
                raise HostError(f"{self.name}: {self._reason(code, said.read())}")
            answer.seek(0)
            kept.pop_all()
            return answer

    def _wait(self, process: "subprocess.Popen[bytes]", seconds: float, files: Sequence[tuple[IO[bytes], int]]) -> int:
        """Wait for a process and return its exit code; kill one that takes too long or writes too much."""
        deadline = time.monotonic() + seconds
        try:
            while True:
                with suppress(subprocess.TimeoutExpired):
                    process.wait(LOOK_SECONDS)
                for file, most in files:
                    if os.fstat(file.fileno()).st_size > most:
                        raise HostError(f"{self.name}: its answer is longer than {most} bytes.")
                if process.returncode is not None:
                    return process.returncode
                if self._given_up.is_set():
                    raise HostError(f"{self.name} was given up.")
                if time.monotonic() > deadline:
                    raise HostError(f"{self.name} did not answer within {seconds:.0f} s.")
        finally:
            if process.poll() is None:
                process.kill()
                process.wait()

    def stream(self, verb: str, request: dict[str, Any], take: Callable[[bytes], None], stop: StopSignal) -> None:
        """Call a verb that answers line by line until stopped.

        Args:
            verb: see `eia_sec.deploy.commands.fleet.host`.
            request: its arguments.
            take: called with each line.
            stop: ends it.

        Raises:
            HostError: the host cannot be reached, or the stream ended by itself.
        """
        command = self._command(verb)
        with tempfile.TemporaryFile() as said:
            try:
                # In a separate session, so that Ctrl-C reaches only this process, which then ends the other.
                process = subprocess.Popen(
                    command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=said, start_new_session=True
                )
            except OSError as error:
                raise HostError(f"{self.name}: {command[0]} cannot be started: {error.strerror}.") from error
            try:
                _listen(process, json.dumps(request).encode() + b"\n", take, stop)
            finally:
                code = _end(process)
            if not stop:
                said.seek(0)
                raise HostError(f"{self.name}: {self._reason(code, said.read(MAX_SAID))}")

    def _command(self, verb: str) -> list[str]:
        folder = str(self.base / self.host.folder) if self.host.host == LOCAL else self.host.folder
        far = ["host", verb, "--folder", folder]
        if self.host.host == LOCAL:
            return [sys.executable, "-P", "-m", "eia_sec.deploy.cli", *far]
        # SSH passes one text to the remote shell, so every word is quoted; the request goes through a pipe.
        return [*self._ssh(), self.host.host, shlex.join([*self.host.words, *far])]

    def close(self) -> None:
        """End the shared connection, if there is one."""
        if self.host.host != LOCAL:
            command = [*self._ssh(), "-O", "exit", self.host.host]
            with suppress(OSError, subprocess.TimeoutExpired):
                subprocess.run(
                    command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, timeout=END_SECONDS, check=False
                )

    def _ssh(self) -> list[str]:
        options = {
            "BatchMode": "yes",
            "ConnectTimeout": str(CONNECT_SECONDS),
            "ServerAliveInterval": "15",
            "ControlMaster": "auto",
            "ControlPath": str(self.sockets / "%C"),
            "ControlPersist": "60",
        }
        chosen = [word for name, value in options.items() for word in ("-o", f"{name}={value}")]
        return ["ssh", "-T", *self.host.ssh, *chosen]

    def _reason(self, code: int, errors: bytes) -> str:
        lines = [line for line in errors.decode(errors="replace").splitlines() if line.strip()]
        said = lines[-1].removeprefix("eia-sec: ") if lines else f"exit code {code}"
        if self.host.host == LOCAL:
            return said
        if code == SSH_FAILED:
            return f"no connection: {said}"
        if code == NOT_FOUND:
            return f"{self.host.command} was not found ({said}); set command = ... to the path of eia-sec on that host."
        return said


def _listen(
    process: "subprocess.Popen[bytes]", request: bytes, take: Callable[[bytes], None], stop: StopSignal
) -> None:
    """Send a request and pass on each line of the answer until it ends or is stopped."""
    assert process.stdin is not None
    assert process.stdout is not None
    rest = b""
    try:
        process.stdin.write(request)
        process.stdin.flush()
    except BrokenPipeError:
        return
    while not stop and len(rest) < MAX_LINE:
        if select.select([process.stdout], [], [], LOOK_SECONDS)[0]:
            data = os.read(process.stdout.fileno(), 65_536)
            if not data:
                return
            *lines, rest = (rest + data).split(b"\n")
            for line in lines:
                take(line)


def _end(process: "subprocess.Popen[bytes]") -> int:
    """Close a process's pipes, kill it if it does not exit, and return its exit code."""
    for end in (process.stdin, process.stdout):
        with suppress(OSError):
            if end is not None:
                end.close()
    try:
        return process.wait(END_SECONDS)
    except subprocess.TimeoutExpired:
        process.kill()
        return process.wait()


@contextmanager
def links(fleet: FleetSpec) -> Iterator[dict[str, Link]]:
    """Yield a link to each host; shared connections are closed afterwards."""
    with tempfile.TemporaryDirectory(prefix="eia-") as sockets:
        found = {name: Link(name, host, fleet.folder, Path(sockets)) for name, host in fleet.hosts.items()}
        try:
            yield found
        finally:
            with ThreadPoolExecutor(AT_ONCE) as pool:
                list(pool.map(Link.close, found.values()))


def everywhere(
    links: dict[str, Link], do: Callable[[Link], R], at_once: int = AT_ONCE
) -> tuple[dict[str, R], dict[str, str]]:
    """Call a function for every host, for many of them at the same time.

    Returns:
        The results and the failures, by host name.
    """
    done: dict[str, R] = {}
    failed: dict[str, str] = {}

    def attempt(link: Link) -> None:
        try:
            done[link.name] = do(link)
        except HostError as error:
            failed[link.name] = str(error)

    with ThreadPoolExecutor(at_once) as pool:
        try:
            list(pool.map(attempt, links.values()))
        except BaseException:
            for link in links.values():
                link.give_up()
            pool.shutdown(wait=True, cancel_futures=True)
            raise
    return {name: done[name] for name in links if name in done}, {n: failed[n] for n in links if n in failed}
