"""The Zenoh side of `eia-sec watch`: subscribes to a worker's first environment, or to a flight, and checks it."""

import os
import time
from typing import Final

from eia_sec.common.errors import BusClosedError, BusError, ConfigError, ProtocolError, SchemaError, UsageError
from eia_sec.common.loops import Running
from eia_sec.common.names import is_name
from eia_sec.common.process import QUICK_SECONDS, denial
from eia_sec.common.protocol import keys
from eia_sec.common.protocol.messages import Envelope, WatchRequest, WatchTerms
from eia_sec.common.transport.bus import Bus, Sample, Subscription
from eia_sec.deploy.monitor.web import packets
from eia_sec.deploy.monitor.web.hub import Hub
from eia_sec.deploy.monitor.web.views import View, view_of

MOST_WORKERS: Final = 4096
"""Most living workers that are remembered."""
MOST_OFFERED: Final = 256
"""Most workers among which the page lets one choose."""
CAPACITY: Final = 128
"""Most messages that wait; a worker sends about thirty per episode, all at once if it is fast."""
RENEWALS: Final = 4
"""Requests per lease."""
ANSWER_SECONDS: Final = 2.0
"""Time without an answer after which a worker is busy."""
PATIENCE: Final = 60.0
"""Time after which it is asked again: a worker answers between two steps of its environments."""
STATE_SECONDS: Final = 1.0
"""Seconds between two state packets."""


class Source:
    """Watches one worker for all browsers.

    Args:
        bus: the control lane.
        run: the run's name.
        worker: the worker's name, or None for the first that is alive.
        hub: receives the packets, and says which worker a browser wants to see.

    Attributes:
        worker: name of the worker that is or would be watched, or None.
        lost: messages that did not arrive.
        malformed: messages that the protocol does not allow.
        skipped: steps that the worker reports as simulated but not shown.
    """

    def __init__(self, bus: Bus, run: str, worker: str | None, hub: Hub) -> None:
        self._bus, self._run, self._wanted, self._hub = bus, run, worker, hub
        self._name = f"watch-{os.getpid()}-{time.time_ns() % 10**9}"
        self._alive = bus.watch(keys.LIVE.pattern(run), 256)
        self._living: set[str] = set()
        self._flights: set[str] = set()
        self._learners: set[str] = set()
        self._met = False
        self._views: Subscription | None = None
        self._known: tuple[str, WatchTerms] | None = None
        self._view: View | None = None
        self._lease = 0.0
        self._asking: Running[bytes | None] | None = None
        self._asked = self._reported = float("-inf")
        self._shown: float | None = None
        self._newest = (0, 0)
        self._sentence, self._wrong = "", False
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
        if self.worker in self._shown_by:
            self._keep_asking(self.worker, now)
        if self._views is not None:
            for sample in self._views.drain():
                self._take(sample)
        if now - self._reported >= STATE_SECONDS:
            self._report(now)

    def leave(self) -> None:
        """End the lease early, because no browser is connected."""
        self._asking = None
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
            role, name = sample.key.split("/")[-2:]
            found = {"rollout": self._living, "flight": self._flights, "learner": self._learners}.get(role)
            if found is None:
                continue
            if not is_name(name) or (sample.present and len(found) >= MOST_WORKERS):
                self.malformed += 1
                continue
            (found.add if sample.present else found.discard)(name)
            self._met = True

    def _choose(self) -> None:
        """Take the worker that a browser wants to see; else keep one that is alive, or take the first."""
        name: str | None
        wanted, self._hub.wanted = self._hub.wanted, None
        if wanted is not None and wanted in self._shown_by:
            self._wanted, name = wanted, wanted
        elif self.worker in self._shown_by:
            return
        else:
            name = self._wanted or min(self._shown_by, key=_order, default=None)
        if name != self.worker and name is not None:
            self.leave()
            self.worker, self._known, self._shown = name, None, None
            self._views = self._bus.subscribe(keys.VIEW.key(self._run, worker=name), CAPACITY)
            self._newest = (0, 0)
        if name is None or name not in self._shown_by:
            self._asking, self._asked = None, float("-inf")
            self._say(self._absent())

    @property
    def _shown_by(self) -> set[str]:
        """Workers and flight nodes that are alive."""
        return self._living | self._flights

    def _called(self, name: str) -> str:
        return f"{'Flight node' if name in self._flights else 'Worker'} {name}"

    @property
    def ended(self) -> bool:
        """Whether the run was there, and nothing of it is now."""
        return self._met and self._nobody

    @property
    def _nobody(self) -> bool:
        return not (self._learners or self._shown_by)

    def _absent(self) -> str:
        """Return why there is nobody to watch."""
        if self._nobody:
            return f"Run {self._run} has ended." if self._met else f"Waiting for run {self._run}: none of it is there."
        return f"Waiting for {f'worker {self._wanted}' if self._wanted else 'a worker'} of run {self._run}."

    def _keep_asking(self, worker: str, now: float) -> None:
        """Take the next step of a request, or begin one when it is due."""
        if self._asking is None:
            if now - self._asked < self._lease / RENEWALS:
                return
            key = keys.WATCH.key(self._run, worker=worker)
            self._asking = Running(self._bus.asking(key, WatchRequest(self._name, True).encode(), PATIENCE))
            self._asked = now
        try:
            if self._asking.step():
                answer, self._asking = self._asking.result, None
                self._answered(worker, answer, now)
            elif now - self._asked > ANSWER_SECONDS:
                self._say(self._busy(worker, now))
        except BusClosedError:
            raise
        except (BusError, ProtocolError, UsageError, ArithmeticError, ValueError) as error:
            self._asking = None
            self._lease = max(self._lease, ANSWER_SECONDS)
            self._say(f"{self._called(worker)}: {error}", wrong=True)

    def _answered(self, worker: str, answer: bytes | None, now: float) -> None:
        if answer is not None:
            self._agree(worker, WatchTerms.decode(answer))
            self._say("")
            return
        self._lease = max(self._lease, ANSWER_SECONDS)
        quick = now - self._asked < QUICK_SECONDS
        refused = denial(self._bus, self._run, keys.WATCH.key(self._run, worker=worker)) if quick else None
        self._say(
            refused or (f"{self._called(worker)} is starting." if quick else self._busy(worker, now)),
            wrong=bool(refused),
        )

    def _say(self, sentence: str, wrong: bool = False) -> None:
        """Note what the next states say: why no frames come, and whether something is wrong."""
        self._sentence, self._wrong = sentence, wrong

    def _busy(self, worker: str, now: float) -> str:
        if self._shown is None:
            return f"{self._called(worker)} is busy; it has shown nothing yet."
        return f"{self._called(worker)} is busy; last frame {now - self._shown:.0f} s ago."

    def _agree(self, worker: str, terms: WatchTerms) -> None:
        """Take the worker's answer; another environment starts the picture over."""
        if self._known != (worker, terms):
            self._view = view_of(terms)
            self._hub.begin(self._view.scene(self._run, worker))
            self._known = (worker, terms)
        self._lease = terms.lease_seconds

    def _take(self, sample: Sample) -> None:
        if self._view is None or self._known is None or self._known[0] != self.worker:
            return
        try:
            envelope = Envelope.decode(sample.attachment)
            role = "flight" if self.worker in self._flights else "rollout"
            if (envelope.role, envelope.name) != (role, self.worker):
                raise SchemaError("the envelope names another sender than the key.")
            packet, self.skipped = self._view.frames(sample.payload, envelope.version)
        except (ProtocolError, ConfigError):
            self.malformed += 1
            return
        start, sequence = self._newest
        if envelope.incarnation == start:
            self.lost += max(0, envelope.sequence - sequence - 1)
        self._newest = (envelope.incarnation, envelope.sequence)
        self._shown = time.monotonic()
        self._hub.show(packet)

    def _report(self, now: float) -> None:
        self._reported = now
        fields = {
            "wrong": self._wrong,
            "lost": self.lost,
            "malformed": self.malformed,
            "skipped": self.skipped,
            "worker": self.worker,
            "workers": sorted(self._shown_by, key=_order)[:MOST_OFFERED],
        }
        self._hub.report(packets.state(self._sentence, fields))


def _order(name: str) -> tuple[int, str]:
    """Return by what workers are sorted, so that 2 comes before 10."""
    return len(name), name
