"""The near end: calls of `eia-sec host` on a host, over the system's SSH client or directly."""

import json
import shlex
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, TypeVar

from common.errors import HostError
from deploy.hosts.description import LOCAL, Fleet, Host

CONNECT_SECONDS: Final = 10
CALL_SECONDS: Final = 90.0
"""Longest that a call may take besides what it waits for on purpose."""
MAX_ANSWER: Final = 2 * 1024**3
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
            verb: what, see `deploy.commands.host`.
            request: the particulars.
            seconds: how long it may wait on purpose.

        Raises:
            HostError: the host cannot be reached, has no eia-sec, or could not do it.
        """
        output = self.fetch(verb, json.dumps(request).encode(), seconds)
        try:
            answer = json.loads(output)
        except ValueError as error:
            raise HostError(f"{self.name}: its answer is no JSON: {output[:80]!r}.") from error
        if not isinstance(answer, dict):
            raise HostError(f"{self.name}: its answer is no JSON object.")
        return answer

    def fetch(self, verb: str, request: bytes = b"", seconds: float = 0.0) -> bytes:
        """Have the host do something whose answer is bytes."""
        folder = str(self.base / self.host.folder) if self.host.host == LOCAL else self.host.folder
        far = ["host", verb, "--folder", folder]
        if self.host.host == LOCAL:
            command = [sys.executable, "-P", "-m", "deploy.cli", *far]
        else:
            # SSH hands one text to the far shell, so that every word is quoted for it; the request goes through a pipe.
            command = [*self._ssh(), self.host.host, shlex.join([*shlex.split(self.host.command), *far])]
        try:
            done = subprocess.run(
                command, input=request, capture_output=True, timeout=CALL_SECONDS + seconds, check=False
            )
        except subprocess.TimeoutExpired as error:
            raise HostError(f"{self.name} did not answer within {CALL_SECONDS + seconds:.0f} s.") from error
        except OSError as error:
            raise HostError(f"{self.name}: {command[0]} cannot be started: {error.strerror}.") from error
        if done.returncode:
            raise HostError(f"{self.name}: {self._reason(done)}")
        if len(done.stdout) > MAX_ANSWER:
            raise HostError(f"{self.name}: its answer is longer than {MAX_ANSWER} bytes.")
        return done.stdout

    def close(self) -> None:
        """End the shared connection."""
        if self.host.host != LOCAL:
            subprocess.run([*self._ssh(), "-O", "exit", self.host.host], capture_output=True, check=False)

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

    def _reason(self, done: subprocess.CompletedProcess[bytes]) -> str:
        lines = [line for line in done.stderr.decode(errors="replace").splitlines() if line.strip()]
        said = lines[-1].removeprefix("eia-sec: ") if lines else f"exit code {done.returncode}"
        if self.host.host == LOCAL:
            return said
        if done.returncode == SSH_FAILED:
            return f"no connection: {said}"
        if done.returncode == NOT_FOUND:
            return f"{self.host.command} is not there ({said}); say with command = ... how eia-sec is called."
        return said


@contextmanager
def links(fleet: Fleet) -> Iterator[dict[str, Link]]:
    """Give a link to each host; shared connections are closed afterwards."""
    with tempfile.TemporaryDirectory(prefix="eia-") as sockets:
        found = {name: Link(name, host, fleet.folder, Path(sockets)) for name, host in fleet.hosts.items()}
        try:
            yield found
        finally:
            with ThreadPoolExecutor(AT_ONCE) as pool:
                list(pool.map(Link.close, found.values()))


def everywhere(links: dict[str, Link], do: Callable[[Link], R]) -> tuple[dict[str, R], dict[str, str]]:
    """Do something with every host at the same time.

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

    with ThreadPoolExecutor(AT_ONCE) as pool:
        list(pool.map(attempt, links.values()))
    return {name: done[name] for name in links if name in done}, {n: failed[n] for n in links if n in failed}
