"""A worker's hold on one served environment: orders in, what became of them out, whatever the network does between.

Each request has a number and is sent again until it is answered. The environment carries out each number once, so a
lost or repeated message changes nothing. An outage is over for this lease when the environment has been away for
SILENT_SECONDS, was started anew, or belongs to somebody else.
"""

import threading
import time
from collections.abc import Callable, Collection
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Final, Protocol

from eia_sec.common.errors import BusError, EnvironmentOutageError, SchemaError
from eia_sec.common.protocol import keys
from eia_sec.common.protocol.environment_messages import (
    DONE,
    OUTAGE,
    ClaimAnswer,
    LeaseRequest,
    StepAnswer,
    StepRequest,
)
from eia_sec.common.protocol.environment_values import PART_BYTES, Form
from eia_sec.common.text import printable

SILENT_SECONDS: Final = 10.0
"""Time for which an environment may neither answer nor be seen before its episode is given up."""
FIRST_SECONDS: Final = 1.0
LONGEST_SECONDS: Final = 30.0
"""Time after which an unanswered request is sent again, at first and at most; each is twice the one before."""
AGAIN_SECONDS: Final = 0.1
"""Pause before a request is sent again that reached nobody."""
RENEWALS: Final = 5
"""Renewals of an idle lease within the time that it lasts."""
RELEASE_SECONDS: Final = 1.0
MOST_TOLD: Final = 64 * 1024
"""Bytes of infos that one agent may tell with a step."""


class Pending(Protocol):
    """A sent request; `eia_sec.common.transport.bus.Request` is one."""

    def answer(self) -> bytes | None:
        """Wait for the answer; None if there is none."""


class Link(Protocol):
    """What a lease needs of a bus."""

    def request(self, key: str, payload: bytes, timeout: float) -> Pending:
        """Send a request."""

    def living(self, key: str) -> list[str]:
        """Return the keys of the liveliness tokens that exist now."""


@dataclass
class Counts:
    """What this process has met with served environments.

    Attributes:
        resent: requests that were sent again.
        refused: answers that were none or said that nothing was done.
    """

    resent: int = 0
    refused: int = 0


COUNTS: Final = Counts()


@dataclass(frozen=True)
class Agents:
    """The agents of a served environment.

    Attributes:
        names: of all that may take part.
        seen: how the observations of each travel.
        acts: how its actions travel.
    """

    names: tuple[str, ...]
    seen: dict[str, Form]
    acts: dict[str, Form]

    @property
    def most_answer(self) -> int:
        """Most bytes that one copy's part of a step's answer may have."""
        return 4096 + sum(form.most + 40 * len(name) + MOST_TOLD + PART_BYTES for name, form in self.seen.items())


class Lease:
    """One claimed environment and its copies.

    Args:
        link: the bus.
        name: the environment's name.
        granted: the answer to the claim.
        agents: its agents.
        clock: seconds that never go back.

    Attributes:
        name: the environment's name.
        free: copies that nobody uses.
        lost: why the lease is over, or empty.
    """

    def __init__(
        self, link: Link, name: str, granted: ClaimAnswer, agents: Agents, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self.name, self.lost = name, ""
        self.copies = granted.copies
        self.free = list(range(granted.copies))
        self._link, self._agents, self._clock = link, agents, clock
        self._whose = LeaseRequest(granted.incarnation, granted.lease)
        self._key, self._token = _key(name, "step"), keys.ENVIRONMENT_LIVE.key(environment=name)
        self._number, self._payload = 0, b""
        self._orders: dict[int, Any] = {}
        self._moving: dict[int, Any] = {}
        self._results: dict[int, dict[str, Any] | str] = {}
        self._pending: Pending | None = None
        self._sent = clock()
        self._ended = threading.Event()
        pause = max(0.1, granted.lease_seconds / RENEWALS)
        threading.Thread(target=self._renew, args=(pause,), name=f"renew {name}", daemon=True).start()

    def order(self, copy: int, order: Any) -> None:
        """Note what a copy is to do in the next request: begin an episode with a seed, or an action for each agent."""
        if isinstance(order, dict):
            order = {name: self._agents.acts[name].pack(value) for name, value in order.items()}
        self._orders[copy] = order

    def send(self) -> None:
        """Send what has been ordered, if anything; do not wait for the answer."""
        if not self._orders or self.lost:
            return
        self._number += 1
        copies = [self._orders.get(copy) for copy in range(self.copies)]
        request = StepRequest(self._whose.incarnation, self._whose.lease, self._number, copies)
        self._payload = request.encode()
        self._moving, self._orders = self._orders, {}
        self._sent = self._clock()
        self._pending = self._link.request(self._key, self._payload, FIRST_SECONDS)

    def take(self, copy: int) -> dict[str, Any]:
        """Wait, and return what became of a copy's order.

        Raises:
            EnvironmentOutageError: nothing, because the environment is away; `lost` says whether the lease is over.
        """
        if copy not in self._results and self._pending is not None:
            self._finish(self._pending)
        found = self._results.pop(copy, self.lost)
        if isinstance(found, str):
            self._orders.pop(copy, None)
            raise EnvironmentOutageError(found)
        return found

    def release(self) -> None:
        """Give the environment back."""
        self._ended.set()
        if not self.lost:
            self.lost = f"{self.name} was given back"
            with suppress(BusError):
                self._link.request(_key(self.name, "release"), self._whose.encode(), RELEASE_SECONDS).answer()

    def _finish(self, pending: Pending) -> None:
        """Take the answer to what was sent, and note what it says of each copy that was to move."""
        said: str | None = None
        try:
            answer = self._awaited(pending)
            if answer.status == OUTAGE:
                said = answer.reason
            elif answer.status == DONE:
                self._note(answer)
            else:
                COUNTS.refused += 1
                self.lost = f"{self.name}: {answer.status}: {answer.reason}"
        except SchemaError as error:
            COUNTS.refused += 1
            self.lost = f"{self.name} answers what cannot be used: {error}"
        except (EnvironmentOutageError, BusError) as error:
            self.lost = str(error)
        self._pending = None
        if self.lost:
            self._ended.set()
        if self.lost or said is not None:
            self._results.update(dict.fromkeys(self._moving, printable(self.lost or f"{self.name}: {said}")))

    def _awaited(self, pending: Pending) -> StepAnswer:
        """Return the answer to what was sent; ask again until it comes.

        Raises:
            SchemaError: it cannot be read, or has another request's number.
            EnvironmentOutageError: the environment is away.
        """
        most = self.copies * self._agents.most_answer
        pause, silent = FIRST_SECONDS, 0.0
        while True:
            data = pending.answer()
            if data is not None:
                answer = StepAnswer.decode(data, most)
                if answer.sequence not in (self._number, 0):
                    raise SchemaError("it has another request's number.")
                return answer
            now = self._clock()
            if not self._link.living(self._token):
                silent = silent or now
                if now - silent >= SILENT_SECONDS:
                    raise EnvironmentOutageError(f"{self.name} has not been seen for {SILENT_SECONDS:.0f} s")
                time.sleep(AGAIN_SECONDS)
            else:
                silent = 0.0
                pause = min(LONGEST_SECONDS, 2.0 * pause)
            COUNTS.resent += 1
            pending = self._link.request(self._key, self._payload, pause)

    def _note(self, answer: StepAnswer) -> None:
        if len(answer.copies) != self.copies:
            raise SchemaError("it has another number of copies.")
        for copy, order in self._moving.items():
            acted = order.keys() if isinstance(order, dict) else ()
            self._results[copy] = read_copy(answer.copies[copy], self._agents, acted)

    def _renew(self, pause: float) -> None:
        """Keep an idle lease; a step that is under way keeps it by itself."""
        while not self._ended.wait(pause):
            if self._pending is not None or self._clock() - self._sent < pause:
                continue
            with suppress(BusError, SchemaError):
                self._link.request(_key(self.name, "renew"), self._whose.encode(), pause).answer()


def read_copy(raw: Any, agents: Agents, acted: Collection[str]) -> dict[str, Any]:
    """Return a copy's part of a step's answer with Gymnasium's values.

    Args:
        raw: what msgpack has read.
        agents: the environment's agents.
        acted: the names of those that acted in this step; nobody where an episode begins.

    Raises:
        SchemaError: it has other fields, agents, types or sizes than docs/reference/remote_protocol.md says.
    """
    if not isinstance(raw, dict):
        raise SchemaError("a copy that was to move has no map.")
    living = raw.get("agents")
    if not isinstance(living, list) or not all(isinstance(name, str) and name in agents.seen for name in living):
        raise SchemaError("agents is no list of names of agents.")
    seen = {name: agents.seen[name].unpack(value) for name, value in _by_agent(raw, "observations", agents).items()}
    infos = {name: _info(value) for name, value in _by_agent(raw, "infos", agents).items()}
    rewards = {name: _of(float, value) for name, value in _by_agent(raw, "rewards", agents).items()}
    terminations = {name: _of(bool, value) for name, value in _by_agent(raw, "terminations", agents).items()}
    truncations = {name: _of(bool, value) for name, value in _by_agent(raw, "truncations", agents).items()}
    for name in set(acted).intersection(living):
        if not (name in rewards and name in terminations and name in truncations):
            raise SchemaError("an agent that acted and still lives has no reward, termination or truncation.")
    return {
        "agents": list(living),
        "observations": seen,
        "rewards": rewards,
        "terminations": terminations,
        "truncations": truncations,
        "infos": infos,
    }


def _by_agent(raw: dict[str, Any], name: str, agents: Agents) -> dict[str, Any]:
    found = raw.get(name, {})
    if not isinstance(found, dict) or not found.keys() <= agents.seen.keys():
        raise SchemaError(f"{name} is no map by agent.")
    return found


def _of(kind: type[Any], value: Any) -> Any:
    if type(value) is not kind and not (kind is float and type(value) is int):
        raise SchemaError(f"a value is no {kind.__name__}.")
    return kind(value)


def _info(value: Any) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise SchemaError("an info is no map.")
    return {key: list(part) if isinstance(part, bytes) else _of(float, part) for key, part in value.items()}


def _key(name: str, verb: str) -> str:
    return keys.ENVIRONMENT.key(environment=name, verb=verb)
