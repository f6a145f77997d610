"""Networks to break: two namespaces joined by a veth pair, and a TCP relay that delays, narrows and stalls."""

import asyncio
import os
import shutil
import subprocess
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

from eia_sec.common.transport.endpoint import Endpoint

LEARNER, WORKER = "10.77.0.1", "10.77.0.2"


@dataclass
class Pair:
    """Two network namespaces, the learner's and the workers', and ways to part them."""

    learner: str
    worker: str

    def ip(self, *words: str) -> None:
        subprocess.run(["ip", *words], check=True, capture_output=True)

    def emulate(self, *words: str) -> bool:
        """Have the kernel emulate a worse link, as in `loss 5%`; return whether it can (netem)."""
        if shutil.which("tc") is None:
            return False
        command = ["ip", "netns", "exec", self.worker, "tc", "qdisc", "replace", "dev", "worker0", "root", "netem"]
        return subprocess.run([*command, *words], check=False, capture_output=True).returncode == 0

    @contextmanager
    def parted(self, way: str) -> Iterator[None]:
        """Part them: link (down), both, to_learner or to_worker (blackhole routes); heal afterwards."""
        if way == "link":
            self.ip("-n", self.worker, "link", "set", "worker0", "down")
        if way in ("both", "to_learner"):
            self.ip("-n", self.worker, "route", "add", "blackhole", f"{LEARNER}/32")
        if way in ("both", "to_worker"):
            self.ip("-n", self.learner, "route", "add", "blackhole", f"{WORKER}/32")
        yield
        if way == "link":
            self.ip("-n", self.worker, "link", "set", "worker0", "up")
        if way in ("both", "to_learner"):
            self.ip("-n", self.worker, "route", "del", "blackhole", f"{LEARNER}/32")
        if way in ("both", "to_worker"):
            self.ip("-n", self.learner, "route", "del", "blackhole", f"{WORKER}/32")


@contextmanager
def namespaces() -> Iterator[Pair | None]:
    """Give two joined namespaces, or None where they may not be made."""
    pair = Pair(f"eia-l-{os.getpid()}", f"eia-w-{os.getpid()}")
    if shutil.which("ip") is None or os.geteuid() != 0:
        yield None
        return
    try:
        for name in (pair.learner, pair.worker):
            pair.ip("netns", "add", name)
        ends = ("link", "add", "learner0", "netns", pair.learner, "type", "veth", "peer", "name", "worker0")
        pair.ip(*ends, "netns", pair.worker)
        for name, link, address in ((pair.learner, "learner0", LEARNER), (pair.worker, "worker0", WORKER)):
            pair.ip("-n", name, "addr", "add", f"{address}/24", "dev", link)
            pair.ip("-n", name, "link", "set", link, "up")
    except subprocess.CalledProcessError:
        _remove(pair)
        yield None
        return
    try:
        yield pair
    finally:
        _remove(pair)


def _remove(pair: Pair) -> None:
    for name in (pair.learner, pair.worker):
        subprocess.run(["ip", "netns", "del", name], check=False, capture_output=True)


@dataclass
class Weather:
    """What a relay does to the bytes that pass.

    Attributes:
        delay: seconds for which every piece is held.
        bytes_per_second: width, 0 for any.
        stalled: whether nothing passes at all.
        passed: bytes so far.
    """

    delay: float = 0.0
    bytes_per_second: float = 0.0
    stalled: bool = False
    passed: int = 0
    _free_at: float = field(default=0.0)

    def due(self, size: int) -> float:
        """Return the time at which a piece of so many bytes may go on."""
        now = time.monotonic()
        begin = max(now, self._free_at)
        self._free_at = begin + (size / self.bytes_per_second if self.bytes_per_second else 0.0)
        return self._free_at + self.delay


class Relay:
    """Passes lanes on to a listener, both or the control lane (0) alone, in a thread of its own."""

    def __init__(self, here: Endpoint, there: Endpoint, lanes: tuple[int, ...] = (0, 1)) -> None:
        self.weather, self._lanes = Weather(), lanes
        self._here, self._there = here, there
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End the thread and with it every connection."""
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()

    def _run(self) -> None:
        for lane in self._lanes:
            meet = self._meet(lane)
            self._loop.run_until_complete(asyncio.start_server(meet, self._here.host, self._here.port + lane))
        self._loop.run_forever()
        for task in asyncio.all_tasks(self._loop):
            task.cancel()
        self._loop.run_until_complete(asyncio.sleep(0.05))

    def _meet(self, lane: int):
        async def meet(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            try:
                onward = await asyncio.open_connection(self._there.host, self._there.port + lane)
            except OSError:
                writer.close()
                return
            await asyncio.gather(self._pass(reader, onward[1]), self._pass(onward[0], writer))

        return meet

    async def _pass(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        pieces: asyncio.Queue[tuple[float, bytes]] = asyncio.Queue(64)
        sender = asyncio.ensure_future(self._send(pieces, writer))
        try:
            while data := await reader.read(65_536):
                await pieces.put((self.weather.due(len(data)), data))
        except OSError:
            pass
        await pieces.put((0.0, b""))
        await sender

    async def _send(self, pieces: "asyncio.Queue[tuple[float, bytes]]", writer: asyncio.StreamWriter) -> None:
        while True:
            due, data = await pieces.get()
            while self.weather.stalled or time.monotonic() < due:
                await asyncio.sleep(0.002)
            if not data:
                writer.close()
                return
            try:
                writer.write(data)
                await writer.drain()
                self.weather.passed += len(data)
            except OSError:
                continue
