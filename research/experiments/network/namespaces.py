"""Hosts that are network namespaces: a bridge between them, a relay with a delay on the way, and an `ssh` into each."""

import contextlib
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Final

NETWORK: Final = "10.77.9"
RELAY: Final = f"{NETWORK}.254"
"""Address at which everybody meets; the relay passes on to the first host, where the router is."""
PORT: Final = 7447

SSH: Final = """#!/bin/sh
# ssh for hosts that are network namespaces: HOST is the namespace, and has a home directory of its own.
case "$*" in *"-O exit"*) exit 0 ;; esac
for last; do before=$host; host=$last; done
mkdir -p {home}/$before && cd {home}/$before && exec ip netns exec $before sh -c "$last"
"""


@dataclass(frozen=True)
class Laboratory:
    """Namespaces that are joined by a bridge in one more namespace.

    Attributes:
        folder: what the hosts keep is in folder/home/NAMESPACE.
        names: the namespaces, one for each host.
        hub: the namespace of the bridge and the relay.
    """

    folder: Path
    names: tuple[str, ...]
    hub: str

    def environment(self) -> dict[str, str]:
        """Return the environment in which `ssh` leads into the namespaces."""
        return {**os.environ, "PATH": f"{self.folder / 'programs'}:{os.environ['PATH']}", "EIA_SEC_SUPERVISOR": ""}

    def home(self, index: int) -> Path:
        """Return the home directory of a host."""
        return self.folder / "home" / self.names[index]

    def cut(self, index: int, down: bool) -> None:
        """Take a host's link down, or up again."""
        _ip("-n", self.names[index], "link", "set", "up0", "down" if down else "up")


def _ip(*words: str) -> None:
    subprocess.run(["ip", *words], check=True, capture_output=True)


@contextmanager
def laboratory(folder: Path, hosts: int, delay: float) -> Iterator[Laboratory | None]:
    """Give a laboratory, or None where namespaces may not be made.

    Args:
        folder: an empty folder.
        hosts: how many hosts.
        delay: seconds for which the relay holds every piece, in each direction.
    """
    mark = os.getpid()
    lab = Laboratory(folder, tuple(f"eia-{mark}-{index}" for index in range(hosts)), f"eia-{mark}-hub")
    if shutil.which("ip") is None or os.geteuid() != 0 or not _made(lab):
        _remove(lab)
        yield None
        return
    programs = folder / "programs"
    programs.mkdir(parents=True)
    (programs / "ssh").write_text(SSH.format(home=folder / "home"))
    (programs / "ssh").chmod(0o755)
    command = [
        "ip",
        "netns",
        "exec",
        lab.hub,
        sys.executable,
        "-m",
        "research.experiments.network.namespaces",
        str(delay),
    ]
    relay = subprocess.Popen(command)
    try:
        yield lab
    finally:
        relay.terminate()
        relay.wait(10.0)
        _remove(lab)


def _made(lab: Laboratory) -> bool:
    """Make the namespaces; return whether that was possible."""
    try:
        _ip("netns", "add", lab.hub)
        _ip("-n", lab.hub, "link", "add", "bridge0", "type", "bridge")
        _ip("-n", lab.hub, "addr", "add", f"{RELAY}/24", "dev", "bridge0")
        _ip("-n", lab.hub, "link", "set", "bridge0", "up")
        for index, name in enumerate(lab.names):
            _ip("netns", "add", name)
            ends = ("link", "add", "up0", "netns", name, "type", "veth", "peer", "name", f"host{index}")
            _ip(*ends, "netns", lab.hub)
            _ip("-n", lab.hub, "link", "set", f"host{index}", "master", "bridge0")
            _ip("-n", lab.hub, "link", "set", f"host{index}", "up")
            _ip("-n", name, "addr", "add", f"{NETWORK}.{index + 1}/24", "dev", "up0")
            _ip("-n", name, "link", "set", "up0", "up")
            _ip("-n", name, "link", "set", "lo", "up")
    except subprocess.CalledProcessError:
        return False
    return True


def _remove(lab: Laboratory) -> None:
    """End what still runs in the namespaces, and remove them."""
    for name in (*lab.names, lab.hub):
        running = subprocess.run(["ip", "netns", "pids", name], check=False, capture_output=True, text=True)
        for number in running.stdout.split():
            with contextlib.suppress(ProcessLookupError):
                os.kill(int(number), signal.SIGKILL)
        subprocess.run(["ip", "netns", "del", name], check=False, capture_output=True)


def main(arguments: Sequence[str]) -> None:
    """Relay both lanes to the first host until it is stopped."""
    from eia_sec.common.transport.endpoint import Endpoint  # noqa: PLC0415  # only the relay's process needs them
    from tests.faults.tools.network import Relay  # noqa: PLC0415  # only the relay's process needs them

    relay = Relay(Endpoint("tcp", RELAY, PORT), Endpoint("tcp", f"{NETWORK}.1", PORT))
    relay.weather.delay = float(arguments[0])
    while True:
        time.sleep(1.0)


if __name__ == "__main__":
    main(sys.argv[1:])
