"""What every process of a run shares: finding the learner, presence, metric messages, and stopping."""

import datetime
import os
import queue
import signal
import socket
import threading
from collections.abc import Callable
from types import FrameType
from typing import Any, Final

from eia_sec.common.clock import monotonic
from eia_sec.common.errors import BusError
from eia_sec.common.log import log, name_process
from eia_sec.common.loops import Loop
from eia_sec.common.protocol import keys
from eia_sec.common.protocol.messages import CommandMessage, ConfigurationMessage, Envelope, MetricMessage
from eia_sec.common.transport.bus import Bus, Publisher
from eia_sec.common.transport.endpoint import Endpoint

LARGEST: Final = 2**63 - 1
"""Largest whole number that a metric message holds; larger sums are clamped to it."""
SUPERVISOR: Final = "EIA_SEC_SUPERVISOR"
"""Environment variable with the supervisor's process id; a process stops when its supervisor dies."""
ORPHAN_SECONDS: Final = 0.5
QUICK_SECONDS: Final = 1.0
"""A request that ends unanswered within this time reached nobody, s."""


class StopSignal:
    """A flag that SIGINT, SIGTERM or the supervisor's death sets; loops check it where they can end cleanly."""

    def __init__(self) -> None:
        self.event = threading.Event()
        self._caught: queue.SimpleQueue[bool] = queue.SimpleQueue()
        self._before: dict[int, Any] = {}

    def install(self) -> None:
        """Handle SIGINT and SIGTERM; only the main thread may call this."""
        for number in (signal.SIGINT, signal.SIGTERM):
            self._before[number] = signal.signal(number, self._on_signal)
        threading.Thread(target=self._pass_on, name="signals", daemon=True).start()
        supervisor = os.environ.get(SUPERVISOR, "")
        if supervisor.isdecimal():
            threading.Thread(target=self._watch, args=(int(supervisor),), name="orphan-watch", daemon=True).start()

    def _watch(self, supervisor: int) -> None:
        while os.getppid() == supervisor:
            if self.event.wait(ORPHAN_SECONDS):
                return
        log("the supervisor is gone; stopping.")
        self.event.set()

    def uninstall(self) -> None:
        """Restore the handlers that SIGINT and SIGTERM had before."""
        for number, handler in self._before.items():
            signal.signal(number, handler)
        self._before.clear()
        self._caught.put(False)

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        # Setting the event would wait for ever for the lock of a wait that the signal interrupts in this thread.
        self._caught.put(True)

    def _pass_on(self) -> None:
        if self._caught.get():
            self.event.set()

    def __bool__(self) -> bool:
        return self.event.is_set()


class Presence:
    """A process's liveliness token and its stream of lossy metrics.

    Args:
        bus: the control lane.
        run: the run's name.
        role: rollout, learner, elite or flight.
        name: the process's name inside its role.
        incarnation: number of this start.
    """

    def __init__(self, bus: Bus, run: str, role: str, name: str, incarnation: int) -> None:
        self._token = bus.announce(keys.LIVE.key(run, role=role, name=name))
        self._publisher: Publisher = bus.publish(keys.METRIC.key(run, role=role, name=name), keys.METRIC.encoding)
        self._sender = (role, name, incarnation)
        name_process(role, name)
        self._credentials, self._logged = bus.credentials, ""
        self._counter = 0
        self._started = monotonic()

    def report(self, values: dict[str, Any], version: int = 0) -> None:
        """Publish one metric message; whole numbers beyond LARGEST are clamped to it."""
        alarm = self._credentials.expiry_alarm() if self._credentials is not None else ""
        if alarm:
            values = {**values, "alarms": [*values.get("alarms", ()), alarm]}
        if alarm != self._logged:
            self._logged = alarm
            log(alarm)
        self._counter += 1
        uptime = monotonic() - self._started
        message = MetricMessage(self._counter, socket.gethostname(), os.getpid(), uptime, _clamped(values))
        envelope = Envelope(*self._sender, sequence=self._counter, version=version)
        self._publisher.put(message.encode(), envelope.encode())


def _clamped(value: Any) -> Any:
    """Return a metric, or a list or map of metrics, with whole numbers clamped to what a frame can hold."""
    if isinstance(value, dict):
        return {name: _clamped(part) for name, part in value.items()}
    if isinstance(value, list | tuple):
        return [_clamped(part) for part in value]
    return max(-LARGEST, min(LARGEST, value)) if type(value) is int else value


def fetch_configuration(
    bus: Bus, run: str, sender: str, keep_waiting: Callable[[], bool], patience: float
) -> Loop[ConfigurationMessage | None]:
    """Return the loop that asks the learner for the run's configuration until it answers.

    Args:
        bus: the control lane.
        run: the run's name.
        sender: name of this process, which the learner logs.
        keep_waiting: called between attempts; False gives up.
        patience: seconds between log lines that report the wait.

    Returns:
        The answer, or None when `keep_waiting` returned False.

    Raises:
        ProtocolError: when the answer is malformed.
    """
    key = keys.COMMAND.key(run, verb="configuration")
    logged = monotonic()
    while keep_waiting():
        asked = monotonic()
        try:
            answer = yield from bus.asking(key, CommandMessage(sender).encode(), 5.0)
        except BusError as error:
            log(f"the learner of run {run} refused: {error}")
            answer = None
        if answer is not None:
            return ConfigurationMessage.decode(answer)
        if monotonic() - logged > patience:
            # With a busy learner the request times out; with none, or none that we may reach, it ends at once.
            quick = monotonic() - asked < QUICK_SECONDS
            log((denial(bus, run, key) if quick else None) or f"waiting for a learner of run {run}.")
            logged = monotonic()
        yield 0.2
    return None


def denial(bus: Bus, run: str, key: str) -> str | None:
    """Return why this process gets no answer on a key: its certificate has expired, or the access list denies the key.

    Every process with a certificate sees whether a learner is alive. A denied request looks as if nobody served the
    key, so a live learner that does not answer means a denial.

    Returns:
        A sentence, or None if neither is the case.
    """
    if bus.credentials is not None and bus.credentials.expires <= datetime.datetime.now(datetime.UTC):
        return bus.credentials.expiry_alarm()
    if bus.credentials is None or not bus.living(keys.LIVE.pattern(run, role="learner")):
        return None
    return (
        f"denied: the learner of run {run} is alive, but the listener's access list denies {key} to {bus.credentials}. "
        "Copy the authority's members.txt to the listener and restart it."
    )


def connect(endpoint: Endpoint, lane: Any, stop: StopSignal, patience: float) -> Bus:
    """Connect a lane, waiting `patience` seconds for a listener; after the first, the log says so.

    Raises:
        EndpointError: when there is none.
        CancelledError: when a stop signal comes first.
    """
    end = monotonic() + patience
    silent = True

    def waiting() -> bool:
        nonlocal silent
        left = end - monotonic()
        if silent and 0.0 < left < patience - 1.0:
            silent = False
            log(f"waiting for a listener at {endpoint}, for {left:.0f} s more.")
        return not stop

    return Bus.connect(endpoint, lane, wait=patience, waiting=waiting)
