"""The near end: calls of `eia-sec host` on a host, over the system's SSH client or directly."""

import json
import os
import select
import shlex
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, Final, TypeVar

from common.errors import HostError
from common.process import StopSignal
from deploy.hosts.fleet_file import LOCAL, FleetSpec, Host

CONNECT_SECONDS: Final = 10
CALL_SECONDS: Final = 90.0
"""Longest that a call may take besides what it waits for on purpose."""
MAX_ANSWER: Final = 256 * 1024**2
"""Longest answer to a call, bytes: the last lines of many logs."""
MAX_SAID: Final = 1024**2
"""Longest that a host writes about what went wrong, bytes."""
MAX_LINE: Final = 4 * 1024**2
"""Longest line of a host that tells line by line, bytes; a longer one ends it."""
LOOK_SECONDS: Final = 0.2
"""Longest until a stop is noticed."""
END_SECONDS: Final = 5.0
"""Time that a host has to notice that nobody listens any more."""
SSH_FAILED: Final = 255
"""What `ssh` itself exits with when there is no connection."""
NOT_FOUND: Final = 127
AT_ONCE: Final = 16
"""Hosts that are talked to at the same time."""

R = TypeVar("R")


@dataclass(frozen=True)
class Link:
    """A way to one host.

    Attributes:
        name: its name in the fleet file.
        host: what the fleet file says of it.
        base: folder to which a local host's folder is relative.
        sockets: folder for SSH's shared connections.
    """

    name: str
    host: Host
    base: Path
    sockets: Path

    def call(self, verb: str, request: dict[str, Any], seconds: float = 0.0) -> dict[str, Any]:
        """Have the host do something.

        Args:
            verb: what, see `deploy.commands.fleet.host`.
            request: the particulars.
            seconds: how long it may wait on purpose.

        Raises:
            HostError: the host cannot be reached, has no eia-sec, or could not do it.
        """
        with self.fetch(verb, json.dumps(request).encode(), seconds) as answered:
            output = answered.read()
        try:
            answer = json.loads(output)
        except ValueError as error:
            raise HostError(f"{self.name}: its answer is no JSON: {output[:80]!r}.") from error
        if not isinstance(answer, dict):
            raise HostError(f"{self.name}: its answer is no JSON object.")
        return answer

    def fetch(self, verb: str, request: bytes = b"", seconds: float = 0.0, most: int = MAX_ANSWER) -> IO[bytes]:
        """Have the host do something, and return a file with its answer, which is not held in memory.

        Args:
            verb: what, see `deploy.commands.fleet.host`.
            request: the particulars.
            seconds: how long it may wait on purpose.
            most: longest answer, bytes.

        Raises:
            HostError: the host cannot be reached, has no eia-sec, could not do it, or answers too much.
        """
        command = self._command(verb)
        with ExitStack() as files:
            asked, said = files.enter_context(tempfile.TemporaryFile()), files.enter_context(tempfile.TemporaryFile())
            answer = files.enter_context(tempfile.TemporaryFile())
            asked.write(request)
            asked.seek(0)
            try:
                process = subprocess.Popen(command, stdin=asked, stdout=answer, stderr=said)
            except OSError as error:
                raise HostError(f"{self.name}: {command[0]} cannot be started: {error.strerror}.") from error
            code = self._wait(process, CALL_SECONDS + seconds, ((answer, most), (said, MAX_SAID)))
            if code:
                said.seek(0)
                raise HostError(f"{self.name}: {self._reason(code, said.read())}")
            answer.seek(0)
            files.pop_all()
            asked.close()
            said.close()
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
                if time.monotonic() > deadline:
                    raise HostError(f"{self.name} did not answer within {seconds:.0f} s.")
        finally:
            if process.poll() is None:
                process.kill()
                process.wait()

    def stream(self, verb: str, request: dict[str, Any], take: Callable[[bytes], None], stop: StopSignal) -> None:
        """Have the host tell line by line until somebody stops it.

        Args:
            verb: what, see `deploy.commands.fleet.host`.
            request: the particulars.
            take: gets each line.
            stop: ends it.

        Raises:
            HostError: the host cannot be reached, or ended by itself.
        """
        command = self._command(verb)
        with tempfile.TemporaryFile() as said:
            try:
                # In a session of its own, so that Ctrl-C reaches this process alone, which then ends that one.
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
            return [sys.executable, "-P", "-m", "deploy.cli", *far]
        # SSH hands one text to the far shell, so that every word is quoted for it; the request goes through a pipe.
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
            return f"{self.host.command} is not there ({said}); say with command = ... how eia-sec is called."
        return said


def _listen(
    process: "subprocess.Popen[bytes]", request: bytes, take: Callable[[bytes], None], stop: StopSignal
) -> None:
    """Send a request and hand on each line of the answer until it ends or somebody stops it."""
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
    """Close both ends of a process, which it notices, and kill it when it does not; return its exit code."""
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
    """Give a link to each host; shared connections are closed afterwards."""
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
    """Do something with every host, with many of them at the same time.

    Returns:
        What came of it, and why it failed, each by the host's name.
    """
    done: dict[str, R] = {}
    failed: dict[str, str] = {}

    def attempt(link: Link) -> None:
        try:
            done[link.name] = do(link)
        except HostError as error:
            failed[link.name] = str(error)

    with ThreadPoolExecutor(at_once) as pool:
        list(pool.map(attempt, links.values()))
    return {name: done[name] for name in links if name in done}, {n: failed[n] for n in links if n in failed}
