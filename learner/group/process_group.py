"""The processes of a group of learners, and what they exchange by torch.distributed (gloo).

Rank 0 leads: it has the connection to workers, the ledger and the checkpoints. The others follow its orders. All
exchanges are collective or between rank 0 and one other, and all processes make them in the order of rank 0's orders.
A member that dies closes its connections, so that the next exchange of every other one fails.
"""

import hashlib
import hmac
import secrets
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from datetime import timedelta
from enum import IntEnum
from pathlib import Path
from typing import Final, NamedTuple

import torch
import torch.distributed as dist
from torch import Tensor
from torch._C._distributed_c10d import FileStore, Store  # torch.distributed exports them without saying so
from torch.distributed.distributed_c10d import _set_pg_timeout

from eia_sec.common.clock import monotonic
from eia_sec.common.errors import GroupError
from eia_sec.common.log import log

SILENT_SECONDS: Final = 120.0
"""The leader's longest wait for another member, in an exchange; without another order it gives one each second."""
LEADER_SECONDS: Final = 86_400.0
"""A follower's longest wait for another member. A leader may load, save or call plug-ins that long between two orders;
one that dies closes its connections."""
JOIN_SECONDS: Final = 120.0
"""Longest wait until all members have joined."""
LOOK_SECONDS: Final = 0.05
SECRET: Final = "secret"
NUMBERS: Final = 2
"""Numbers that come with an order, besides one for each learner."""
SAID: Final = 240
"""Most characters of an error of torch's in the log."""
MOST_BYTES: Final = 2**24
"""Longest text, bytes; a configuration is far shorter."""


class Order(IntEnum):
    """What the leader asks of the others."""

    NOTHING = 0
    ITERATION = 1
    VALUES = 2
    NEWEST = 3
    LEARN = 4
    UPDATE = 5
    COMPARE = 6
    END = 7


class Ordered(NamedTuple):
    """An order and its numbers, which `eia_sec.learner.group.following` explains."""

    order: Order
    numbers: tuple[float, ...]


class ProcessGroup:
    """A member's view of its group; for one thread.

    Args:
        rank: number of this process, from 0.
        size: how many processes there are, N.
        store: file through which processes of one machine find each other, or None for torchrun's variables.
        lost: why members cannot come, or an empty string; asked while this process waits for them.

    Attributes:
        seconds: time spent in exchanges, waits for slower members included.

    Raises:
        GroupError: when they do not all join in time.
    """

    def __init__(self, rank: int, size: int, store: Path | None = None, lost: Callable[[], str] = lambda: "") -> None:
        self.rank, self.size, self.seconds = rank, size, 0.0
        timeout = timedelta(seconds=SILENT_SECONDS)
        with self._exchange("join its group"):
            if store is None:
                dist.init_process_group("gloo", init_method="env://", timeout=timeout)
            else:
                met = FileStore(str(store), size)
                if self.leads:
                    met.set(SECRET, secrets.token_hex(32))
                self._meet(met, lost)
                dist.init_process_group("gloo", store=met, rank=rank, world_size=size, timeout=timeout)
                try:
                    self._require_members(met.get(SECRET))
                except (GroupError, RuntimeError):
                    self.close()
                    raise
            if not self.leads:
                # The only way to set it after joining; the time to join is another.
                _set_pg_timeout(timedelta(seconds=LEADER_SECONDS))

    def _meet(self, store: Store, lost: Callable[[], str]) -> None:
        store.set(f"here/{self.rank}", "")
        until = monotonic() + JOIN_SECONDS
        while not store.check([f"here/{rank}" for rank in range(self.size)]):
            if reason := lost():
                raise GroupError(reason)
            if monotonic() > until:
                raise GroupError(f"the {self.size} learners of this group have not met within {JOIN_SECONDS:.0f} s.")
            time.sleep(LOOK_SECONDS)

    def _require_members(self, secret: bytes) -> None:
        """Raise GroupError unless the other end of each connection knows what the store holds.

        gloo takes whoever connects to its ports, and so could any user of this machine; the store is this user's alone.
        """
        others = [rank for rank in range(self.size) if rank != self.rank]
        sent = [_proof(secret, self.rank, other) for other in others]
        got = [torch.zeros_like(proof) for proof in sent]
        under_way = [dist.isend(proof, other) for proof, other in zip(sent, others, strict=True)]
        for proof, other in zip(got, others, strict=True):
            dist.recv(proof, other)
            if not hmac.compare_digest(proof.numpy().tobytes(), _proof(secret, other, self.rank).numpy().tobytes()):
                raise GroupError(f"what connected as learner {other} of {self.size} is not of this group.")
        for work in under_way:
            assert work is not None
            work.wait()

    @property
    def leads(self) -> bool:
        """Whether this process is rank 0."""
        return self.rank == 0

    def order(self, order: Order, *numbers: float) -> None:
        """Give all others an order (rank 0)."""
        head = torch.zeros(1 + NUMBERS + self.size, dtype=torch.float64)
        head[: 1 + len(numbers)] = torch.tensor([float(order), *numbers], dtype=torch.float64)
        self.broadcast([head])

    def next_order(self) -> Ordered:
        """Wait for rank 0's next order."""
        head = torch.zeros(1 + NUMBERS + self.size, dtype=torch.float64)
        self.broadcast([head])
        try:
            if not bool(torch.isfinite(head).all()):
                raise ValueError
            return Ordered(Order(int(head[0])), tuple(head[1:].tolist()))
        except ValueError as error:
            raise GroupError(f"learner {self.rank} of {self.size} got an order that it does not know.") from error

    def broadcast(self, tensors: Sequence[Tensor]) -> None:
        """Replace the tensors' contents by those of rank 0; all of one type travel as one."""
        with self._exchange("send or get parameters"), torch.no_grad():
            for dtype in dict.fromkeys(tensor.dtype for tensor in tensors):
                alike = [tensor for tensor in tensors if tensor.dtype == dtype]
                flat = torch.cat([tensor.reshape(-1) for tensor in alike])
                dist.broadcast(flat, 0)
                if not self.leads:
                    for tensor, part in zip(alike, torch.split(flat, [t.numel() for t in alike]), strict=True):
                        tensor.copy_(part.view_as(tensor))

    def broadcast_text(self, text: bytes = b"") -> bytes:
        """Return rank 0's text."""
        size = torch.tensor([len(text)])
        self.broadcast([size])
        if not 0 <= int(size) <= MOST_BYTES:
            raise GroupError(f"learner {self.rank} of {self.size} got a text of {int(size)} bytes.")
        content = torch.zeros(int(size), dtype=torch.uint8)
        if self.leads:
            content = torch.frombuffer(bytearray(text), dtype=torch.uint8)
        self.broadcast([content])
        return content.numpy().tobytes()

    def sum(self, tensor: Tensor) -> None:
        """Replace a tensor by the sum over all members, which is bit-equal in each of them."""
        with self._exchange("add gradients"):
            dist.all_reduce(tensor)

    def send(self, parts: Sequence[Sequence[Tensor]]) -> None:
        """Send each other rank, from 1, its contiguous tensors (rank 0)."""
        with self._exchange("send rows"):
            under_way = [
                dist.isend(tensor, rank) for rank, tensors in enumerate(parts, 1) for tensor in tensors if len(tensor)
            ]
            for work in under_way:
                assert work is not None
                work.wait()

    def receive(self, tensors: Sequence[Tensor], sender: int = 0) -> None:
        """Fill contiguous tensors with what a member has sent."""
        with self._exchange("get rows"):
            for tensor in tensors:
                if len(tensor):
                    dist.recv(tensor, sender)

    def answer(self, tensor: Tensor) -> None:
        """Send rank 0 a contiguous tensor."""
        with self._exchange("send results"):
            if len(tensor):
                dist.send(tensor, 0)

    def agree(self, number: int) -> bool:
        """Return whether all members have the same number, of 62 bits."""
        ends = torch.tensor([number, -number])
        with self._exchange("compare parameters"):
            dist.all_reduce(ends, dist.ReduceOp.MIN)
        return int(ends[0]) == -int(ends[1])

    def close(self) -> None:
        """Leave the group; to be called once, after the last exchange."""
        if dist.is_initialized():
            dist.destroy_process_group()

    @contextmanager
    def _exchange(self, what: str) -> Iterator[None]:
        started = monotonic()
        try:
            yield
        except RuntimeError as error:  # torch has no narrower one for a connection that is closed or silent
            log(f"torch could not {what}: {str(error).partition(' This is')[0][:SAID]}")
            raise GroupError(
                f"learner {self.rank} of {self.size} could not {what}: another one is gone or silent."
            ) from error
        finally:
            self.seconds += monotonic() - started


def _proof(secret: bytes, sender: int, receiver: int) -> Tensor:
    """Return what one member shows another, which serves nobody to show it to a third."""
    digest = hmac.new(secret, f"{sender} to {receiver}".encode(), hashlib.sha256).digest()
    return torch.frombuffer(bytearray(digest), dtype=torch.uint8)
