"""What a served environment answers to whom: leases, sequence numbers, and answers that are given again.

One worker holds the environment at a time, by a lease. Each of its steps has a number. The newest answer is kept, so a
step that is asked for again is answered again and not made again. Nothing here knows Zenoh.
"""

from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any, Final

from eia_sec.common.errors import EnvironmentOutageError, SchemaError
from eia_sec.common.protocol.environment_messages import (
    DONE,
    FAULT,
    GAP,
    LATE,
    LOST,
    MALFORMED,
    OUTAGE,
    TAKEN,
    ClaimAnswer,
    ClaimRequest,
    LeaseAnswer,
    LeaseRequest,
    StepAnswer,
    StepRequest,
)
from eia_sec.common.text import printable
from eia_sec.rollout.remote.copies import Copies

LEASE_SECONDS: Final = 15.0
"""Time after a worker's last request from which on another worker may claim the environment."""
REPEATED: Final = "repeated"
"""The count of requests that were answered again."""


class Desk:
    """Answers requests for one environment.

    Args:
        copies: the environment.
        incarnation: number of this start.
        clock: seconds that never go back.

    Attributes:
        counts: requests that were not carried out, by the status of their answer, and those that were repeated.
        holder: who holds the lease, or empty.
        failure: what the environment's own code raised; its process should end.
    """

    def __init__(self, copies: Copies, incarnation: int, clock: Callable[[], float]) -> None:
        self._copies, self._incarnation, self._clock = copies, incarnation, clock
        self._limit = copies.most_request
        self._lease, self._nonce, self._until = 0, -1, 0.0
        self._newest, self._answer = 0, b""
        self.holder = ""
        self.counts: Counter[str] = Counter()
        self.failure: Exception | None = None

    def answer(self, verb: str, payload: bytes) -> bytes:
        """Return the answer to a request.

        Args:
            verb: the end of its key.
            payload: its bytes, whatever they are.
        """
        try:
            if verb == "claim":
                return self._claim(ClaimRequest.decode(payload))
            if verb == "step":
                return self._step(StepRequest.decode(payload, self._limit))
            if verb in ("renew", "release"):
                return self._keep(verb, LeaseRequest.decode(payload))
            raise SchemaError("there is no such request.")
        except SchemaError as error:
            return self._refuse(verb, MALFORMED, str(error))

    def _claim(self, request: ClaimRequest) -> bytes:
        now = self._clock()
        if request.nonce == self._nonce and not self._newest:
            if not self.holder:
                return self._refuse("claim", LOST, "this claim's lease has been released.")
            self.counts[REPEATED] += 1
        elif self.holder and now < self._until:
            return self._refuse("claim", TAKEN, f"it is taken by {self.holder}.")
        elif request.nonce == self._nonce:
            return self._refuse("claim", LOST, "this claim's lease is over.")
        else:
            self._lease += 1
            self._nonce, self._newest, self._answer = request.nonce, 0, b""
            self.holder = printable(request.worker[:80]) or "a nameless worker"
        self._until = now + LEASE_SECONDS
        return ClaimAnswer(DONE, "", self._incarnation, self._lease, LEASE_SECONDS, **self._copies.description).encode()

    def _keep(self, verb: str, request: LeaseRequest) -> bytes:
        if not self._holds(request):
            return self._refuse(verb, LOST, self._whose(request))
        self._until = self._clock() + LEASE_SECONDS
        if verb == "release":
            self.holder, self._answer = "", b""
        return LeaseAnswer(DONE).encode()

    def _step(self, request: StepRequest) -> bytes:
        number = request.sequence
        if not self._holds(request):
            return self._refuse("step", LOST, self._whose(request), number)
        self._until = self._clock() + LEASE_SECONDS
        if number == self._newest and self._answer:
            self.counts[REPEATED] += 1
            return self._answer
        if number <= self._newest:
            return self._refuse("step", LATE, f"step {self._newest} has been made.", number)
        if number > self._newest + 1:
            return self._refuse("step", GAP, f"step {self._newest + 1} comes next.", number)
        orders = self._copies.read(request.copies)
        self._newest, self._answer = number, self._carry_out(orders, number)
        self._until = self._clock() + LEASE_SECONDS
        return self._answer

    def _carry_out(self, orders: Sequence[Any], number: int) -> bytes:
        try:
            return StepAnswer(DONE, "", number, self._copies.move(orders)).encode()
        except EnvironmentOutageError as error:
            return self._refuse("step", OUTAGE, str(error), number)
        except Exception as error:  # a user's code may raise anything
            self.failure = error
            return self._refuse("step", FAULT, f"{type(error).__name__}: {error}", number)

    def _holds(self, request: LeaseRequest | StepRequest) -> bool:
        return bool(self.holder) and (request.incarnation, request.lease) == (self._incarnation, self._lease)

    def _whose(self, request: LeaseRequest | StepRequest) -> str:
        if request.incarnation != self._incarnation:
            return "the environment has been started anew."
        return f"the lease went to {self.holder}." if self.holder else "the lease has been released."

    def _refuse(self, verb: str, status: str, reason: str, sequence: int = 0) -> bytes:
        self.counts[status] += 1
        reason = reason[:400]
        if verb == "claim":
            return ClaimAnswer(status, reason).encode()
        return StepAnswer(status, reason, sequence).encode() if verb == "step" else LeaseAnswer(status, reason).encode()
