"""The Zenoh side of `eia-sec watch`: subscribes to a worker's farm and checks the messages."""

import os
import time
from typing import Final

from eia_sec.common.config import FarmConfig
from eia_sec.common.config.files import read_saved
from eia_sec.common.errors import BusClosedError, BusError, ConfigError, ProtocolError, SchemaError, UsageError
from eia_sec.common.names import is_name
from eia_sec.common.process import denial
from eia_sec.common.protocol import keys
from eia_sec.common.protocol.messages import Envelope, ViewMessage, WatchRequest, WatchTerms
from eia_sec.common.protocol.view_checks import MAX_PARTS, check_view
from eia_sec.common.transport.bus import Bus, Sample, Subscription
from eia_sec.deploy.monitor.web import packets
from eia_sec.deploy.monitor.web.hub import Hub
from eia_sec.rollout.sim.layout import make_layout

MOST_WORKERS: Final = 4096
"""Most living workers that are remembered."""
CAPACITY: Final = 128
"""Most messages that wait; a worker sends about thirty per episode, all at once if it is fast."""
RENEWALS: Final = 4
"""Requests per lease."""
ANSWER_SECONDS: Final = 2.0
STATE_SECONDS: Final = 1.0
"""Seconds between two state packets."""


class Source:
    """Watches one worker for all browsers.

    Args:
        bus: the control lane.
        run: the run's name.
        worker: the worker's name, or None for the first that is alive.
        hub: receives the packets.

    Attributes:
        worker: name of the worker that is or would be watched, or None.
        lost: messages that did not arrive.
        malformed: messages that the protocol does not allow.
        skipped: steps that the worker reports as simulated but not shown.
    """

    def __init__(self, bus: Bus, run: str, worker: str | None, hub: Hub) -> None:
        self._bus, self._run, self._wanted, self._hub = bus, run, worker, hub
        self._name = f"watch-{os.getpid()}-{time.time_ns() % 10**9}"
        self._alive = bus.watch(keys.LIVE.pattern(run, role="rollout"), 256)
        self._living: set[str] = set()
        self._views: Subscription | None = None
        self._known: tuple[str, str] | None = None
        self._farm = FarmConfig()
        self._parts = 0
        self._lease = 0.0
        self._asked = self._reported = float("-inf")
        self._newest = (0, 0)
        self._sentence = ""
        self.worker: str | None = None
        self.lost = self.malformed = self.skipped = 0

    def tend(self, wanted: bool) -> None:
        """Choose a worker, renew the lease in time, and pass on the messages that have arrived.

        Args:
            wanted: whether a browser is connected; if not, the worker's lease is ended.
        """
        self._look_around()
        now = time.monotonic()
        if not wanted:
            self.leave()
            return
        self._choose()
        if self.worker is not None and now - self._asked >= max(self._lease, ANSWER_SECONDS) / RENEWALS:
            self._asked = now
            self._ask(self.worker)
        if self._views is not None:
            for sample in self._views.drain():
                self._take(sample)
        if now - self._reported >= STATE_SECONDS:
            self._report(now)

    def leave(self) -> None:
        """End the lease early, because no browser is connected."""
        if self.worker is not None and self._lease:
            self._lease = 0.0
            self._asked = float("-inf")
            try:
                key = keys.WATCH.key(self._run, worker=self.worker)
                self._bus.ask(key, WatchRequest(self._name, False).encode(), ANSWER_SECONDS)
            except BusError:
                return

    def _look_around(self) -> None:
        for sample in self._alive.drain():
            name = sample.key.rsplit("/", 1)[-1]
            if not is_name(name) or (sample.present and len(self._living) >= MOST_WORKERS):
                self.malformed += 1
                continue
            (self._living.add if sample.present else self._living.discard)(name)

    def _choose(self) -> None:
        """Keep a worker that is alive, else take the named one or the first."""
        if self.worker in self._living:
            return
        name = self._wanted or min(self._living, default=None)
        if name != self.worker and name is not None:
            self.worker, self._asked, self._lease = name, float("-inf"), 0.0
            self._views = self._bus.subscribe(keys.VIEW.key(self._run, worker=name), CAPACITY)
            self._newest = (0, 0)
        if name is None or name not in self._living:
            which = f"worker {name}" if name else "a worker"
            self._sentence = f"Waiting for {which} of run {self._run}."
            self._asked = float("-inf")

    def _ask(self, worker: str) -> None:
        if worker not in self._living:
            return
        key = keys.WATCH.key(self._run, worker=worker)
        try:
            answer = self._bus.ask(key, WatchRequest(self._name, True).encode(), ANSWER_SECONDS)
            if answer is None:
                self._sentence = denial(self._bus, self._run, key) or f"Worker {worker} does not answer."
                return
            self._agree(worker, WatchTerms.decode(answer))
            self._sentence = ""
        except BusClosedError:
            raise
        except (BusError, ProtocolError, UsageError, ArithmeticError, ValueError) as error:
            self._sentence = f"Worker {worker}: {error}"

    def _agree(self, worker: str, terms: WatchTerms) -> None:
        """Take the worker's answer; a new farm starts the picture over."""
        if not (0.5 <= terms.lease_seconds <= 3600.0 and 0.0 < terms.steps_per_second <= 1e4):
            raise SchemaError("the terms of watching are out of range.")
        if len(terms.part_names) > MAX_PARTS or any(len(name) > 32 for name in terms.part_names):
            raise SchemaError("the parts of the reward are too many or too long.")
        self._lease = terms.lease_seconds
        if self._known != (worker, terms.toml):
            self._farm = read_saved(terms.toml).farm
            self._parts = len(terms.part_names)
            self._hub.begin(packets.scene(self._run, worker, self._farm, terms))
            self._known = (worker, terms.toml)

    def _take(self, sample: Sample) -> None:
        if self._known is None or self._known[0] != self.worker:
            return
        try:
            envelope = Envelope.decode(sample.attachment)
            if (envelope.role, envelope.name) != ("rollout", self.worker):
                raise SchemaError("the envelope names another sender than the key.")
            message = ViewMessage.decode(sample.payload)
            check_view(message, self._farm, self._parts)
            layout = make_layout(self._farm, message.farm)
        except (ProtocolError, ConfigError):
            self.malformed += 1
            return
        start, sequence = self._newest
        if envelope.incarnation == start:
            self.lost += max(0, envelope.sequence - sequence - 1)
        self._newest = (envelope.incarnation, envelope.sequence)
        self.skipped = message.skipped
        self._hub.show(packets.frames(message, self._farm, layout, envelope.version))

    def _report(self, now: float) -> None:
        self._reported = now
        counts = {"lost": self.lost, "malformed": self.malformed, "skipped": self.skipped}
        self._hub.report(packets.state(self._sentence, counts))
