"""Fleets for tests: a fleet file in a folder, the commands on it, and ways to reach hosts that are this machine."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from eia_sec.common.transport.endpoint import free_endpoint
from eia_sec.deploy.monitor.audit import Audit, audit
from tests.system.fleet import PRESET, TINY, until

LONG = TINY.replace("episodes = 8", "episodes = 1000000")
EIA_SEC = f"env PYTHONPATH={os.environ.get('PYTHONPATH', '')} {sys.executable} -m eia_sec.deploy.cli"
"""How eia-sec is called on a host that is this machine."""

FAKE_SSH = """#!/bin/sh
# ssh, as far as it is used here: the last word is a text for a shell on the host, in the home directory there.
printf '%s\\n' "$*" >>{log}
case "$*" in *"-O exit"*) exit 0 ;; *unreachable*) echo "ssh: no route to host" >&2; exit 255 ;; esac
for last; do :; done
cd {home} && exec sh -c "$last"
"""


class OnHosts:
    """A fleet file and the commands on it, as processes of their own."""

    def __init__(self, folder: Path, hosts: str, toml: str = LONG, extra: str = "") -> None:
        self.folder = folder
        self.file = folder / "fleet.toml"
        self.endpoint = free_endpoint()
        self.environment = {**os.environ, "NUMBA_NUM_THREADS": "1", "EIA_SEC_SUPERVISOR": ""}
        self.prefix: tuple[str, ...] = ()
        (folder / "wanted.toml").write_text(toml)
        network = f'[network]\nendpoint = "{self.endpoint}"\n'
        self.write(f'run = "test"\n[training]\npreset = "{PRESET}"\nconfig = "wanted.toml"\n{extra or network}{hosts}')

    def write(self, text: str) -> None:
        """Replace the fleet file."""
        self.file.write_text(text)

    def edit(self, old: str, new: str) -> None:
        """Change one place of the fleet file."""
        text = self.file.read_text()
        assert old in text
        self.write(text.replace(old, new, 1))

    def eia_sec(self, *words: str, code: int | None = 0) -> str:
        """Run a command; return what it printed, after its exit code was checked."""
        command = [*self.prefix, sys.executable, "-m", "eia_sec.deploy.cli", *words]
        done = subprocess.run(command, capture_output=True, text=True, env=self.environment, timeout=300, check=False)
        assert code in (None, done.returncode), (words, done.returncode, done.stdout, done.stderr)
        return done.stdout + done.stderr

    def status(self) -> dict[str, dict[str, Any]]:
        """Return every process in a keeper's state, by name."""
        hosts = json.loads(self.eia_sec("status", str(self.file), "--json", code=None))["hosts"]
        return {name: state for host in hosts.values() for name, state in host["processes"].items()}

    def pids(self) -> dict[str, int]:
        """Return the process numbers of those that run."""
        return {name: state["pid"] for name, state in self.status().items() if state["pid"]}

    def collected(self) -> Audit:
        """Return the audit of everything that the hosts hold."""
        self.eia_sec("fleet", "collect", str(self.file), "--out", str(self.folder / "collected"))
        return audit(self.folder / "collected")

    def close(self, folders: list[Path]) -> None:
        """Kill whatever a keeper still keeps; its children end with it."""
        for folder in folders:
            path = folder / "state.json"
            state = json.loads(path.read_text()) if path.exists() else {}
            numbers = [state.get("pid", 0), *(child["pid"] for child in state.get("processes", {}).values())]
            for number in numbers:
                command = Path(f"/proc/{number}/cmdline")
                if number and command.exists() and b"eia_sec.deploy.cli" in command.read_bytes():
                    os.kill(number, signal.SIGKILL)


def taken(history: Path) -> Callable[[], int]:
    """Return a function that counts the chunks in a learner's history."""
    return lambda: history.read_text().count('["accepted"') if history.exists() else 0


def gone(number: int) -> bool:
    """Return whether a process has ended; one that nobody has waited for counts."""
    try:
        return Path(f"/proc/{number}/stat").read_text().rpartition(")")[2].split()[0] == "Z"
    except OSError:
        return True


def until_more(history: Path, chunks: int = 3) -> None:
    """Wait until the learner has taken more chunks."""
    count = taken(history)
    before = count()
    until(lambda: count() >= before + chunks, "more chunks", 120.0)


def fake_ssh(folder: Path) -> tuple[Path, Path]:
    """Write an `ssh` that runs everything here; return its folder, for PATH, and its log."""
    home, programs = folder / "home", folder / "programs"
    home.mkdir()
    programs.mkdir()
    program = programs / "ssh"
    program.write_text(FAKE_SSH.format(log=folder / "ssh.log", home=home))
    program.chmod(0o755)
    return programs, folder / "ssh.log"


@contextmanager
def sshd(folder: Path) -> Iterator[list[str] | None]:
    """Give the options with which `ssh` reaches a real server on loopback, or None where there is none."""
    program = shutil.which("sshd") or "/usr/sbin/sshd"
    if os.geteuid() != 0 or not Path(program).exists() or shutil.which("ssh-keygen") is None:
        yield None
        return
    folder.mkdir()
    for name in ("host", "user"):
        subprocess.run(["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f", str(folder / name)], check=True)
    shutil.copy(folder / "user.pub", folder / "authorized")
    (folder / "known").write_text(f"* {(folder / 'host.pub').read_text()}")
    Path("/run/sshd").mkdir(exist_ok=True)
    port = free_endpoint().port
    settings = {
        "ListenAddress": f"127.0.0.1:{port}",
        "HostKey": folder / "host",
        "AuthorizedKeysFile": folder / "authorized",
        "PidFile": "none",
        "StrictModes": "no",
        "UsePAM": "no",
        "PasswordAuthentication": "no",
    }
    (folder / "config").write_text("".join(f"{name} {value}\n" for name, value in settings.items()))
    server = subprocess.Popen([program, "-D", "-e", "-f", str(folder / "config")], stderr=subprocess.DEVNULL)
    try:
        time.sleep(0.2)
        known = ("-o", f"UserKnownHostsFile={folder / 'known'}", "-o", "IdentitiesOnly=yes", "-F", "none")
        yield ["-p", str(port), "-i", str(folder / "user"), *known] if server.poll() is None else None
    finally:
        server.terminate()
        server.wait(10.0)
