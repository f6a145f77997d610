"""A simulated network between processes, with the four kinds of delivery of a `Bus`.

Requests and answers may be lost, doubled, delayed and overtake one another. A state's newest value comes in the end,
as a publisher repeats it; a later value never comes before an earlier one of the same publisher. Lossy puts get lost.
A vanished process is noticed after a while. A partition cuts one machine off from all others.
"""

from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

from eia_sec.common.errors import BusClosedError, BusError
from eia_sec.common.loops import Loop
from eia_sec.common.transport.bus import Sample
from tests.simulation.world import Process, World

ASK_SECONDS = 0.05
"""Pause between two looks for an answer."""
REPEAT_SECONDS = 1.0
"""Time after which a lost state is sent again."""
LEASE_SECONDS = 3.0
"""Time after which a machine that is cut off counts as gone."""


@dataclass
class Weather:
    """How bad the network is: chances for each message, and the mean delay, s."""

    lost: float = 0.0
    doubled: float = 0.0
    delay: float = 0.005
    late: float = 0.0
    """Chance of a delay of seconds."""
    damaged: float = 0.0
    """Chance that a chunk's request arrives with a flipped bit."""


@dataclass(eq=False)
class Request:
    """A request on its way."""

    process: Process
    key: str
    payload: bytes
    attachment: bytes
    answered: bool = False
    answer: bytes | None = None
    refused: str | None = None
    asked: set[Process] = field(default_factory=set)


class Incoming:
    """A copy of a request at the process that serves it."""

    def __init__(self, network: "Network", request: Request, process: Process) -> None:
        self._network, self._request, self._process = network, request, process
        self.key, self.payload, self.attachment = request.key, request.payload, request.attachment

    def reply(self, payload: bytes) -> None:
        """Answer it."""
        for watcher in self._network.on_reply:
            watcher(self._process, self._request, payload)
        self._network.answer(self._process, self._request, payload, None)

    def refuse(self, reason: str) -> None:
        """Answer it with an error."""
        self._network.answer(self._process, self._request, None, reason)


class Server:
    """Requests that wait; iteration ends where none waits, instead of waiting for one."""

    def __init__(self) -> None:
        self.wild = 0
        self.queue: deque[Incoming] = deque()

    def waiting(self) -> Iterator[Incoming]:
        """Yield the requests that wait."""
        for _ in range(len(self.queue)):
            yield self.queue.popleft()

    def poll(self) -> Incoming | None:
        """Return the next one."""
        return self.queue.popleft() if self.queue else None

    def __iter__(self) -> Iterator[Incoming]:
        while self.queue:
            yield self.queue.popleft()


class Subscription:
    """Samples that have arrived; the oldest make way."""

    def __init__(self, process: Process, pattern: str, capacity: int) -> None:
        self.process, self.pattern = process, pattern
        self.missed = self.wild = 0
        self.queue: deque[Sample] = deque(maxlen=capacity)
        self.newest: dict[int, int] = {}

    def poll(self) -> Sample | None:
        """Return the next sample."""
        return self.queue.popleft() if self.queue else None

    def drain(self) -> Iterator[Sample]:
        """Yield all samples."""
        while self.queue:
            yield self.queue.popleft()


class Publisher:
    """Puts on one key, a state or lossy."""

    def __init__(self, network: "Network", process: Process, key: str, *, state: bool) -> None:
        self.network, self.process, self.key, self.state = network, process, key, state
        self.count, self.value = 0, Sample(key, b"", b"")

    def put(self, payload: bytes, attachment: bytes = b"") -> None:
        """Publish a value."""
        self.count += 1
        self.value = Sample(self.key, payload, attachment)
        for watcher in self.network.on_put:
            watcher(self.process, self.key, payload)
        for subscription in self.network.subscriptions:
            if matches(subscription.pattern, self.key):
                self.network.publish(self, subscription)


class Network:
    """All messages of a simulation.

    Attributes:
        weather: how bad it is.
        cut: machines that are cut off from the others.
        cut_pairs: pairs of machines between which no message passes.
        on_reply, on_put: called with each answer and each published value, as it is sent.
    """

    def __init__(self, world: World) -> None:
        self.world, self.weather = world, Weather()
        self.cut: set[str] = set()
        self.cut_pairs: set[frozenset[str]] = set()
        self.servers: list[tuple[Process, str, Server]] = []
        self.subscriptions: list[Subscription] = []
        self.publishers: list[Publisher] = []
        self.tokens: list[tuple[Process, str]] = []
        self.watches: list[Subscription] = []
        self.open: list[Request] = []
        self.on_reply: list[Callable[[Process, Request, bytes], None]] = []
        self.on_put: list[Callable[[Process, str, bytes], None]] = []
        world.on_death.append(self._died)

    def partition(self, node: str, seconds: float) -> None:
        """Cut a machine off for a while."""
        self.cut.add(node)
        self.world.note(f"{node} is cut off for {seconds:.1f} s")
        self.world.after(LEASE_SECONDS, lambda: self._show(node, present=node not in self.cut))
        self.world.after(seconds, lambda: self._heal(node))

    def separate(self, one: str, other: str, seconds: float) -> None:
        """Let no message pass between two machines for a while."""
        pair = frozenset((one, other))
        self.cut_pairs.add(pair)
        self.world.note(f"no message passes between {one} and {other} for {seconds:.1f} s")
        self.world.after(seconds, lambda: self.cut_pairs.discard(pair))

    def _heal(self, node: str) -> None:
        self.cut.discard(node)
        self._show(node, present=True)

    def _show(self, node: str, *, present: bool) -> None:
        for process, key in self.tokens:
            if process.node == node and process.alive:
                self._tell(key, present=present)

    def linked(self, one: Process, other: Process) -> bool:
        """Return whether messages pass between two processes now."""
        return one.alive and other.alive and not self.apart(one, other)

    def apart(self, one: Process, other: Process) -> bool:
        """Return whether the machines of two processes are cut off from each other now."""
        nodes = frozenset((one.node, other.node))
        return len(nodes) == 2 and (bool(nodes & self.cut) or nodes in self.cut_pairs)

    def delay(self) -> float:
        """Draw how long a message takes."""
        draw, weather = self.world.draw, self.weather
        return draw.expovariate(1.0 / weather.delay) + (draw.uniform(0.5, 8.0) if draw.random() < weather.late else 0.0)

    def carry(
        self, one: Process, other: Process, arrive: Callable[[], None], dropped: Callable[[], None] = lambda: None
    ) -> bool:
        """Send a message; return whether it gets anywhere. It must find both ends linked when it arrives, too.

        Args:
            one: who sends it.
            other: who gets it.
            arrive: what happens then.
            dropped: what happens where the machines were cut off from each other while it was under way.
        """
        draw, weather = self.world.draw, self.weather

        def arrived() -> None:
            if other.frozen_until > self.world.now:
                self.world.after(other.frozen_until - self.world.now + self.delay(), arrived)
            elif other.alive:
                (dropped if self.apart(one, other) else arrive)()

        if not self.linked(one, other) or draw.random() < weather.lost:
            return False
        for _ in range(1 + (draw.random() < weather.doubled)):
            self.world.after(self.delay(), arrived)
        return True

    def ask(self, request: Request) -> None:
        """Send a request to who serves its key; with nobody there, it ends."""
        serving = [(process, server) for process, key, server in self.servers if matches(key, request.key)]
        reachable = [(process, server) for process, server in serving if self.linked(request.process, process)]
        if not reachable:
            alive = any(process.alive for process, _ in serving) or request.process.node in self.cut
            if not alive or self.world.draw.random() < 0.5:
                self.world.after(self.delay(), lambda: self._give_up(request))
            return
        process, server = self.world.draw.choice(reachable)
        request.asked.add(process)
        self.open.append(request)
        self.carry(request.process, process, lambda: server.queue.append(self._arrived(request, process)))

    def _arrived(self, request: Request, process: Process) -> Incoming:
        """Return a request's copy at its server, damaged by chance if it holds chunks."""
        incoming, draw = Incoming(self, request, process), self.world.draw
        if "/transition/" in request.key and draw.random() < self.weather.damaged:
            spoilt = bytearray(incoming.payload)
            spoilt[draw.randrange(len(spoilt))] ^= 1 << draw.randrange(8)
            incoming.payload = bytes(spoilt)
        return incoming

    def answer(self, process: Process, request: Request, payload: bytes | None, refused: str | None) -> None:
        """Send an answer back."""
        self.carry(process, request.process, lambda: self._answered(request, payload, refused))

    def _answered(self, request: Request, payload: bytes | None, refused: str | None) -> None:
        if not request.answered:
            request.answered, request.answer, request.refused = True, payload, refused
            if request in self.open:
                self.open.remove(request)

    def _give_up(self, request: Request) -> None:
        self._answered(request, None, None)

    def publish(self, publisher: Publisher, subscription: Subscription) -> None:
        """Send a published value to one subscriber."""
        number, value = publisher.count, publisher.value

        def arrive() -> None:
            if number > subscription.newest.get(id(publisher), 0):
                subscription.newest[id(publisher)] = number
                subscription.queue.append(value)

        def repeat() -> None:
            if publisher.count == number and publisher.process.alive and subscription.process.alive:
                self.publish(publisher, subscription)

        def lost() -> None:
            if publisher.state:
                self.world.after(REPEAT_SECONDS, repeat)

        if not self.carry(publisher.process, subscription.process, arrive, lost):
            lost()

    def _tell(self, key: str, *, present: bool, to: Subscription | None = None) -> None:
        for watch in self.watches if to is None else [to]:
            if matches(watch.pattern, key):
                self.world.after(self.delay(), lambda watch=watch: watch.queue.append(Sample(key, b"", b"", present)))

    def _died(self, process: Process) -> None:
        """Forget a process; who waits for its answers hears that it is gone, or waits in vain."""
        self.servers = [entry for entry in self.servers if entry[0] is not process]
        self.publishers = [publisher for publisher in self.publishers if publisher.process is not process]
        self.subscriptions = [entry for entry in self.subscriptions if entry.process is not process]
        self.watches = [entry for entry in self.watches if entry.process is not process]
        gone = [key for owner, key in self.tokens if owner is process]
        self.tokens = [entry for entry in self.tokens if entry[0] is not process]
        for key in gone:
            still = any(other == key for _, other in self.tokens)
            if not still:
                self.world.after(self.world.draw.uniform(0.0, LEASE_SECONDS), lambda key=key: self._vanish(key))
        for request in list(self.open):
            if request.process is process:
                self.open.remove(request)
            elif request.asked <= {process} and self.world.draw.random() < 0.8:
                self.world.after(self.delay(), lambda request=request: self._give_up(request))

    def _vanish(self, key: str) -> None:
        if not any(other == key for _, other in self.tokens):
            self._tell(key, present=False)


class SimulatedBus:
    """What a process holds of the network; it has the methods of a `Bus`."""

    credentials = None

    def __init__(self, network: Network, process: Process) -> None:
        self._network, self._process, self._closed = network, process, False

    def serve(self, key: str, capacity: int, *, newest: bool = False) -> Server:
        """Receive requests; there is no limit to those that wait."""
        server = Server()
        self._network.servers.append((self._process, key, server))
        return server

    def asking(
        self,
        key: str,
        payload: bytes,
        timeout: float,
        attachment: bytes = b"",
        again: Callable[[float], bool] = lambda waited: False,
    ) -> Loop[bytes | None]:
        """Return the loop that sends a request and waits for its answer, as that of a `Bus` does."""
        world = self._network.world
        request = Request(self._process, key, payload, attachment)
        started = newest = world.now
        self._network.ask(request)
        while not request.answered and world.now - started < timeout:
            if self._closed:
                raise BusClosedError("the bus was closed before a request was answered.")
            if again(world.now - newest):
                newest = world.now
                self._network.ask(request)
            yield ASK_SECONDS
        request.answered = True
        if request.refused is not None:
            raise BusError(f"refused: {request.refused[:200]}")
        return request.answer

    def publish(self, key: str, encoding: str = "") -> Publisher:
        """Publish lossy puts."""
        return Publisher(self._network, self._process, key, state=False)

    def publish_state(self, key: str, encoding: str = "") -> Publisher:
        """Publish a state."""
        publisher = Publisher(self._network, self._process, key, state=True)
        self._network.publishers.append(publisher)
        return publisher

    def subscribe(self, key: str, capacity: int) -> Subscription:
        """Receive lossy puts."""
        subscription = Subscription(self._process, key, capacity)
        self._network.subscriptions.append(subscription)
        return subscription

    def subscribe_state(self, key: str, capacity: int = 1) -> Subscription:
        """Receive a state, beginning with the newest value that somebody still publishes."""
        subscription = self.subscribe(key, capacity)
        for publisher in self._network.publishers:
            if matches(key, publisher.key) and publisher.count:
                self._network.publish(publisher, subscription)
        return subscription

    def announce(self, key: str) -> Any:
        """Declare a liveliness token."""
        self._network.tokens.append((self._process, key))
        self._network._tell(key, present=True)
        return key

    def watch(self, key: str, capacity: int) -> Subscription:
        """Receive liveliness changes, beginning with the tokens that exist."""
        watch = Subscription(self._process, key, capacity)
        self._network.watches.append(watch)
        for _, token in self._network.tokens:
            self._network._tell(token, present=True, to=watch)
        return watch

    def living(self, key: str) -> list[str]:
        """Return the tokens that exist."""
        return [token for _, token in self._network.tokens if matches(key, token)]

    def close(self) -> None:
        """Send and receive nothing more."""
        self._closed = True


def matches(pattern: str, key: str) -> bool:
    """Return whether a key expression with `*` for single parts covers a key."""
    if pattern == key:
        return True
    ours, theirs = pattern.split("/"), key.split("/")
    return len(ours) == len(theirs) and all(one in ("*", other) for one, other in zip(ours, theirs, strict=True))
