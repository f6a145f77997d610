"""Defects to plant, each in a few lines: the simulation must find every one of them."""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from types import SimpleNamespace
from typing import Any, Final
from unittest import mock

from eia_sec.common import incarnation
from eia_sec.common.history import summary
from eia_sec.common.history.history import End, Entry, History
from eia_sec.common.loops import Loop
from eia_sec.common.policy_store import PolicyStore
from eia_sec.elite.service import Coordinator
from eia_sec.learner.checkpoint import compaction, files, recovery
from eia_sec.learner.intake import receiver
from eia_sec.learner.intake.feed import ExperienceFeed
from eia_sec.learner.intake.iteration_room import IterationRoom
from eia_sec.learner.intake.ledger import Ledger
from eia_sec.learner.process import service
from eia_sec.learner.process.lease import Lease
from eia_sec.learner.process.service import Learner
from eia_sec.learner.trainer import Trainer
from eia_sec.rollout.worker import sender

roll_back, end = summary._Totals.roll_back, Learner._end
Plant = Callable[[], AbstractContextManager[Any]]


def _judged(wrong: str) -> Plant:
    """Return a ledger that accepts chunks of one wrong status."""
    judge = Ledger.judge

    def credulous(self: Ledger, chunk: Any, oldest: int) -> Any:
        status = judge(self, chunk, oldest)
        return "accepted" if status == wrong else status

    return lambda: mock.patch.object(Ledger, "judge", credulous)


@contextmanager
def _gap_accepted() -> Iterator[None]:
    """Look at the chunks behind one that has to come again, and take them."""
    with mock.patch.object(receiver, "SETTLED", (*receiver.SETTLED, "damaged")), _judged("gap")():
        yield


def _unfenced() -> AbstractContextManager[Any]:
    offer = PolicyStore.offer_parameters

    def unfenced(self: PolicyStore, message: Any) -> bool:
        self.epoch = min(self.epoch, message.epoch)
        return offer(self, message)

    return mock.patch.object(PolicyStore, "offer_parameters", unfenced)


def _told_first(self: Learner, state: str) -> Loop[None]:
    self._tell(state)
    return end(self, state)


def _applied_again() -> AbstractContextManager[Any]:
    once = Trainer.imitate

    def again(self: Trainer, event: Any) -> bool:
        self.events = min(self.events, event.event - 1)
        return once(self, event)

    return mock.patch.object(Trainer, "imitate", again)


def _announced_first() -> AbstractContextManager[Any]:
    deliver = Coordinator.deliver

    def announce(self: Coordinator, family: Any, payload: bytes, what: str, stop: Any) -> Any:
        self._announcer.put(payload)
        return (yield from deliver(self, family, payload, what, stop))

    return mock.patch.object(Coordinator, "deliver", announce)


def _emptied(self: ExperienceFeed) -> None:
    self._receiver.close()
    while not self._receiver.arrivals.empty():
        self._receiver.arrivals.get_nowait()


def _forgotten(records: Any, marks: Any) -> list[Any]:
    """Leave out the totals."""
    return [record for record in summary.summarised(records, marks) if not isinstance(record, summary.Summary)]


def _counted_twice(ledger: Ledger, entry: Entry) -> None:
    recovery._book_chunks(ledger, entry, entry.first, entry.last)


def _late_line() -> AbstractContextManager[Any]:
    """Write each line of a history only with the next one."""
    add = History.add

    def late(self: History, record: Any) -> None:
        held = self.__dict__.setdefault("held", [])
        held.append(record)
        while len(held) > 1 or (held and isinstance(held[0], End)):
            add(self, held.pop(0))

    return mock.patch.object(History, "add", late)


def _unflushed() -> AbstractContextManager[Any]:
    write = files._write_tensors

    def hasty(*arguments: Any) -> Any:
        with mock.patch.object(files, "os", SimpleNamespace(fsync=lambda handle: None)):
            return write(*arguments)

    return mock.patch.object(files, "_write_tensors", hasty)


@contextmanager
def _forgetful() -> Iterator[None]:
    """Let workers and learners take their numbers from the clock alone."""

    def clock_alone(known: int = 0) -> int:
        return incarnation.microseconds()

    with (
        mock.patch.object(incarnation, "new_incarnation", clock_alone),
        mock.patch.object(service, "new_incarnation", clock_alone),
    ):
        yield


def _patient(self: sender.Sender, waited: float) -> bool:
    """Resend only where the run or the worker ends, as it was before a seed found that."""
    if not self._resends_fast or waited < self._resend_after:
        return False
    self._resend_after *= 2.0
    return True


def _rolled_back_once(self: Any, resume: Any) -> None:
    """Forget after a resume what its checkpoint holds, as it was before a seed found that."""
    roll_back(self, resume)
    self._accepted.clear()


def _granted(self: Lease, name: str, start: int, now: float) -> bool:
    self.holder = name, start
    return True


DEFECTS: Final[dict[str, Plant]] = {
    "duplicates are accepted": _judged("duplicate"),
    "chunks behind a damaged one are accepted": _gap_accepted,
    "parameters of a lower epoch are applied": _unfenced,
    "the lead is granted to everybody": lambda: mock.patch.object(Lease, "claim", _granted),
    "events are applied whoever leads": lambda: mock.patch.object(Lease, "holds", return_value=True),
    "an event whose receipt was lost is applied again": _applied_again,
    "an event is announced before it is applied": _announced_first,
    "an iteration takes in chunks without end": lambda: mock.patch.object(IterationRoom, "is_open", return_value=True),
    "a learner that drains loses its queue": lambda: mock.patch.object(ExperienceFeed, "close", _emptied),
    "compaction forgets the totals": lambda: mock.patch.object(compaction, "summarised", _forgotten),
    "a resume counts losses that its checkpoint holds": lambda: mock.patch.object(recovery, "_book", _counted_twice),
    "a resume does not look for losses": lambda: mock.patch.object(recovery, "_book"),
    "a worker drops what a closing learner did not take": lambda: mock.patch.object(
        sender, "SETTLED", (*sender.SETTLED, "closed")
    ),
    "a verdict is sent before its line is written": _late_line,
    "a checkpoint is renamed before it is on disk": _unflushed,
    "in lockstep a lost answer is not asked for again": lambda: mock.patch.object(
        sender.Sender, "_resend_now", _patient
    ),
    "totals keep what a second resume rolls back": lambda: mock.patch.object(
        summary._Totals, "roll_back", _rolled_back_once
    ),
    "a new start ignores the numbers of earlier ones": _forgetful,
    "workers hear of the end before the last checkpoint is on disk": lambda: mock.patch.object(
        Learner, "_end", _told_first
    ),
}
"""Name of each defect, and how it is planted."""
