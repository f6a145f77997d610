"""The only module that touches Zenoh.

A `Bus` is one session on one lane. It offers the four kinds of delivery that `eia_sec.common.protocol.keys` declares:
acknowledged requests, latest-wins states, lossy puts, and liveliness tokens. Data arrives through channels, never
through callbacks, so closing the bus ends every waiting thread.
"""

import json
import os
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from types import TracebackType
from typing import TYPE_CHECKING, Any, Final, Self

import zenoh
from zenoh import ext

from eia_sec.common.clock import monotonic
from eia_sec.common.errors import BusClosedError, BusError, CancelledError, EndpointError, ForkedProcessError
from eia_sec.common.loops import Loop, run
from eia_sec.common.text import printable
from eia_sec.common.transport.admission import raise_limit
from eia_sec.common.transport.endpoint import Endpoint, Lane
from eia_sec.common.transport.handshake import complaint, silence
from eia_sec.common.transport.zenoh_config import Values, admitting_px4, connecting, listening, relaying, routing

if TYPE_CHECKING:
    from eia_sec.common.transport.credentials import (
        Credentials,
    )  # loads cryptography, which links without TLS do without

LIVING_SECONDS: Final = 1.0
"""Longest wait for a list of the live tokens."""
POLL_SECONDS: Final = 0.002
"""Longest pause between two polls of a channel."""


@dataclass(frozen=True)
class Sample:
    """One received message.

    Attributes:
        key: the concrete key it arrived on.
        payload: the frame.
        attachment: the envelope's frame, or empty.
        present: False when a liveliness token vanished.
    """

    key: str
    payload: bytes
    attachment: bytes
    present: bool = True


class Incoming:
    """A received request that has not been answered."""

    def __init__(self, query: zenoh.Query) -> None:
        self._query = query
        self.key = str(query.key_expr)
        self.payload = query.payload.to_bytes() if query.payload is not None else b""
        self.attachment = query.attachment.to_bytes() if query.attachment is not None else b""

    def reply(self, payload: bytes) -> None:
        """Answer the request, which ends it. It is no error if the requester is gone."""
        with self._query as query:
            query.reply(self.key, payload)

    def refuse(self, reason: str) -> None:
        """Answer with an error text, which ends the request."""
        with self._query as query:
            query.reply_err(reason.encode())


class Server:
    """Requests on one key expression, in order of arrival; at most `capacity` of them wait.

    Attributes:
        wild: requests refused because their key held a wildcard.
    """

    def __init__(self, queryable: Any, capacity: int) -> None:
        self._queryable, self._capacity = queryable, capacity
        self.wild = 0

    def poll(self) -> Incoming | None:
        """Return the next request, or None if none waits."""
        return next(self.waiting(), None)

    def waiting(self) -> Iterator[Incoming]:
        """Yield waiting requests, at most `capacity`, so that a flood of requests cannot hold the caller here."""
        for _ in range(self._capacity):
            if (query := self._queryable.handler.try_recv()) is None:
                return
            if (incoming := self._concrete(query)) is not None:
                yield incoming

    def __iter__(self) -> Iterator[Incoming]:
        """Yield requests until the bus is closed."""
        while True:
            try:
                query = self._queryable.handler.recv()
            except zenoh.ZError:
                return
            if (incoming := self._concrete(query)) is not None:
                yield incoming

    def _concrete(self, query: zenoh.Query) -> Incoming | None:
        incoming = Incoming(query)
        if "*" not in incoming.key:
            return incoming
        self.wild += 1
        incoming.refuse("the key of a request must not hold wildcards.")
        return None


class Subscription:
    """Samples on one key expression.

    Attributes:
        missed: samples of a state that were lost on the way; 0 for other subscriptions, which cannot see that.
        wild: samples dropped because their key held a wildcard.
    """

    def __init__(self, subscriber: Any, capacity: int, misses: Any = None) -> None:
        self._subscriber, self._capacity = subscriber, capacity
        self._misses = misses
        self.missed = self.wild = 0

    def poll(self) -> Sample | None:
        """Return the next sample, or None if none waits."""
        if self._misses is not None:
            while (miss := self._misses.try_recv()) is not None:
                self.missed += miss.nb
        while (sample := self._subscriber.handler.try_recv()) is not None and "*" in str(sample.key_expr):
            self.wild += 1
        if sample is None:
            return None
        attachment = sample.attachment.to_bytes() if sample.attachment is not None else b""
        present = sample.kind == zenoh.SampleKind.PUT
        return Sample(str(sample.key_expr), sample.payload.to_bytes(), attachment, present)

    def drain(self) -> Iterator[Sample]:
        """Yield the samples that have arrived, at most as many as may wait: more may come faster than they are read."""
        for _ in range(self._capacity):
            if (sample := self.poll()) is None:
                return
            yield sample


class Request:
    """A sent request."""

    def __init__(self, replies: Any) -> None:
        self._replies = replies

    def answer(self) -> bytes | None:
        """Wait for the answer without polling, which takes half the time of `Bus.ask` where it comes at once.

        Returns:
            The answer, or None when nobody serves the key, the time ran out, or the bus was closed.

        Raises:
            BusError: when the server refused; the message holds its reason.
        """
        try:
            return _answered(self._replies.recv())
        except zenoh.ZError:
            return None


class Publisher:
    """Puts on one key, each with the time of this process's clock, for whoever subscribes to it."""

    def __init__(self, session: zenoh.Session, publisher: Any) -> None:
        self._session, self._publisher = session, publisher

    def put(self, payload: bytes, attachment: bytes = b"") -> None:
        """Publish one sample; raise BusClosedError when the bus is closed."""
        try:
            self._publisher.put(payload, attachment=attachment or None, timestamp=self._session.new_timestamp())
        except zenoh.ZError as error:
            raise BusClosedError(f"the bus is closed: {error}") from error


class Bus:
    """One Zenoh session on one lane; use it as a context manager.

    Attributes:
        credentials: this process's certificate, or None without TLS.

    Raises (every method but `close`):
        ForkedProcessError: in a process other than the one that opened it.
        BusClosedError: after `close`.
    """

    def __init__(self, session: zenoh.Session, credentials: "Credentials | None" = None) -> None:
        self.credentials = credentials
        self._session = session
        self._pid = os.getpid()
        self._closed = threading.Event()

    @classmethod
    def listen(cls, endpoint: Endpoint, lane: Lane) -> "Bus":
        """Open a session that others connect to; raise EndpointError when this machine cannot listen there."""
        return cls._listening(listening(endpoint, lane), endpoint, endpoint.locator(lane))

    @classmethod
    def admit_px4(cls, endpoint: Endpoint) -> "Bus":
        """Open a session to which one vehicle's PX4 connects; raise EndpointError when this machine cannot listen."""
        return cls._listening(admitting_px4(endpoint), endpoint, endpoint.locator("control"))

    @classmethod
    def route(cls, endpoint: Endpoint) -> "Bus":
        """Open a router for both lanes; raise EndpointError when this machine cannot listen there.

        Open no other session in the same process: a router starves beside its own clients.
        """
        return cls._listening(routing(endpoint), endpoint, f"{endpoint} and the port after it")

    @classmethod
    def relay(cls, endpoint: Endpoint, lane: Lane, upper: Endpoint) -> "Bus":
        """Open a router for one lane that is linked to the one at `upper`, whether that is there or not.

        Raises:
            EndpointError: this machine cannot listen at `endpoint`.
        """
        return cls._listening(relaying(endpoint, lane, upper), endpoint, endpoint.locator(lane))

    @classmethod
    def _listening(cls, values: Values, endpoint: Endpoint, where: str) -> "Bus":
        raise_limit()
        try:
            return cls(_open(values), endpoint.credentials)
        except zenoh.ZError as error:
            raise EndpointError(f"cannot listen on {where}: {_reason(error)}.") from error

    @classmethod
    def connect(
        cls, endpoint: Endpoint, lane: Lane, wait: float = 0.0, waiting: Callable[[], bool] = lambda: True
    ) -> "Bus":
        """Open a session to a listener or a router.

        Args:
            endpoint: where it listens.
            lane: which of its two ports.
            wait: how long to keep trying, s.
            waiting: called between attempts; False gives up at once.

        Raises:
            CancelledError: when `waiting` returned False.
            EndpointError: when nobody answers there in time, or, at once, when one side rejects the other's
                certificate.
        """
        deadline = time.monotonic() + wait
        while True:
            try:
                return cls(_open(connecting(endpoint, lane)), endpoint.credentials)
            except zenoh.ZError as error:
                if _lacks_memory(error):
                    raise EndpointError(f"cannot connect to {endpoint}: {_reason(error)}.") from error
                if (reason := complaint(endpoint, lane)) is not None:
                    raise EndpointError(reason) from error
                if not waiting():
                    raise CancelledError(
                        f"nothing has answered at {endpoint} before this process was ended."
                    ) from error
                if time.monotonic() >= deadline:
                    raise EndpointError(silence(endpoint, lane)) from error
                time.sleep(0.2)

    def serve(self, key: str, capacity: int, *, newest: bool = False) -> Server:
        """Receive requests on a key expression.

        Args:
            key: the key expression.
            capacity: how many may wait.
            newest: whether a request beyond them ends the oldest unanswered; else the link waits, with all that is
                on it.
        """
        channel: Any = zenoh.handlers.RingChannel(capacity) if newest else zenoh.handlers.FifoChannel(capacity)
        return Server(self._open().declare_queryable(key, channel, complete=True), capacity)

    def ask(
        self,
        key: str,
        payload: bytes,
        timeout: float,
        attachment: bytes = b"",
        again: Callable[[float], bool] = lambda waited: False,
    ) -> bytes | None:
        """Send a request and wait for its answer, see `asking`."""
        return run(self.asking(key, payload, timeout, attachment, again))

    def asking(
        self,
        key: str,
        payload: bytes,
        timeout: float,
        attachment: bytes = b"",
        again: Callable[[float], bool] = lambda waited: False,
    ) -> Loop[bytes | None]:
        """Return the loop that sends a request and waits for its answer.

        Args:
            key: a concrete key.
            payload: the request's frame.
            timeout: time limit for the answer, s.
            attachment: the envelope's frame.
            again: called while waiting, with the seconds since the request was last sent; True sends it again. The
                first answer counts, and the server may receive every copy.

        Returns:
            The answer's frame, or None when nobody serves the key or the time ran out.

        Raises:
            BusError: when the server refused; the message holds its reason.
        """
        asked = [self._request(key, payload, timeout, attachment)]
        started = newest = monotonic()
        pause = 0.0002
        while asked and (now := monotonic()) - started < timeout + 1.0:
            if again(now - newest):
                asked.append(self._request(key, payload, timeout, attachment))
                newest = now
            for one in list(asked):
                try:
                    reply = one.try_recv()
                except zenoh.ZError:
                    asked.remove(one)
                    continue
                if reply is not None:
                    return _answered(reply)
            if self._closed.is_set():
                raise BusClosedError("the bus was closed before a request was answered.")
            if asked:
                yield pause
                pause = min(pause * 1.5, POLL_SECONDS)
        return None

    def _request(self, key: str, payload: bytes, timeout: float, attachment: bytes) -> Any:
        session = self._open()
        try:
            return session.get(
                key,
                zenoh.handlers.FifoChannel(4),
                payload=payload,
                attachment=attachment or None,
                timeout=timeout,
                congestion_control=zenoh.CongestionControl.BLOCK,
                consolidation=zenoh.ConsolidationMode.NONE,
            )
        except zenoh.ZError as error:
            raise BusClosedError(f"the bus is closed: {error}") from error

    def request(self, key: str, payload: bytes, timeout: float) -> "Request":
        """Send a request whose answer is waited for later; `ask` does both at once, for less haste."""
        return Request(self._request(key, payload, timeout, b""))

    def publish(self, key: str, encoding: str = "") -> Publisher:
        """Publish lossy puts on a key; the encoding tells other programs what they are."""
        session, drop = self._open(), zenoh.CongestionControl.DROP
        made = session.declare_publisher(key, encoding=zenoh.Encoding(encoding), congestion_control=drop)
        return Publisher(session, made)

    def subscribe(self, key: str, capacity: int) -> Subscription:
        """Receive lossy puts; at most `capacity` wait, and a new one replaces the oldest."""
        return Subscription(self._open().declare_subscriber(key, zenoh.handlers.RingChannel(capacity)), capacity)

    def publish_state(self, key: str, encoding: str = "") -> Publisher:
        """Publish a state: late joiners get the latest value, and receivers notice gaps."""
        session = self._open()
        made = ext.declare_advanced_publisher(
            session,
            key,
            encoding=zenoh.Encoding(encoding),
            cache=ext.CacheConfig(1),
            sample_miss_detection=ext.MissDetectionConfig(heartbeat=None, sporadic_heartbeat=1.0),
            publisher_detection=True,
            congestion_control=zenoh.CongestionControl.DROP,
        )
        return Publisher(session, made)

    def subscribe_state(self, key: str, capacity: int = 1) -> Subscription:
        """Receive a state: only the latest values wait; `missed` counts values that were lost on the way.

        Args:
            key: the key expression.
            capacity: how many may wait; more than one where several may send, and all of them must be heard.
        """
        subscriber = ext.declare_advanced_subscriber(
            self._open(),
            key,
            zenoh.handlers.RingChannel(capacity),
            history=ext.HistoryConfig(detect_late_publishers=True, max_samples=1),
            recovery=ext.RecoveryConfig(periodic_queries=None, heartbeat=True),
        )
        return Subscription(subscriber, capacity, subscriber.sample_miss_listener(zenoh.handlers.RingChannel(64)))

    def announce(self, key: str) -> Any:
        """Declare a liveliness token and return it; it lasts until the object or the session ends."""
        return self._open().liveliness().declare_token(key)

    def watch(self, key: str, capacity: int) -> Subscription:
        """Receive liveliness changes, beginning with the tokens that already exist."""
        return Subscription(
            self._open().liveliness().declare_subscriber(key, zenoh.handlers.FifoChannel(capacity), history=True),
            capacity,
        )

    def is_linked_to(self, endpoint: Endpoint, lane: Lane) -> bool:
        """Return whether this session has the link to a listener now."""
        port = endpoint.locator(lane).rpartition(":")[2]  # who has come here has one that its system chose
        return any(str(link.dst).rpartition(":")[2] == port for link in self._open().info.links())

    def living(self, key: str) -> list[str]:
        """Return the keys of the liveliness tokens that exist now."""
        replies = self._open().liveliness().get(key, zenoh.handlers.FifoChannel(64), timeout=LIVING_SECONDS)
        return [str(reply.ok.key_expr) for reply in replies if reply.ok is not None]

    def close(self) -> None:
        """Close the session, which ends every waiting thread. Closing twice is no error."""
        if not self._closed.is_set():
            self._closed.set()
            # With a frozen peer, Zenoh's close times out; there is nothing else to release.
            with suppress(zenoh.ZError):
                if self._pid == os.getpid():
                    self._session.close()  # type: ignore[no-untyped-call]  # zenoh's stub leaves close() without types

    def _open(self) -> zenoh.Session:
        if self._pid != os.getpid():
            raise ForkedProcessError("a bus works only in the process that opened it.")
        if self._closed.is_set():
            raise BusClosedError("the bus is closed.")
        return self._session

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def _answered(reply: Any) -> bytes | None:
    """Return the answer's frame, or None for a timeout; raise BusError for a refusal."""
    if reply.ok is not None:
        return bytes(reply.ok.payload.to_bytes())
    text = reply.err.payload.to_bytes().decode(errors="replace")
    if text.strip().lower() == "timeout":
        return None
    raise BusError(f"refused: {text[:200]}")


def _lacks_memory(error: zenoh.ZError) -> bool:
    return "shm" in str(error).split(" at /", maxsplit=1)[0]


def _reason(error: zenoh.ZError) -> str:
    """Return why a session could not be opened on this machine."""
    text = str(error)
    if _lacks_memory(error):
        return "/dev/shm has no room for shared memory; free some, or leave out --shared-memory"
    if "os error 98" in text or "os error 99" in text:
        return "the address is in use or does not belong to this machine"
    return printable(text.split(" at /", maxsplit=1)[0])


def _open(values: Values) -> zenoh.Session:
    config = zenoh.Config()
    for key, value in values.items():
        config.insert_json5(key, json.dumps(value))
    return zenoh.open(config)
