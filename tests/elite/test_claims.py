"""The coordinator's claim to the lead, at a learner that answers late or not at all."""

from eia_sec.common.imitation import LEASE_SECONDS
from eia_sec.common.protocol.messages import ReceiptMessage
from eia_sec.elite import service
from eia_sec.elite.service import Coordinator, CoordinatorOptions

GRANTED, REFUSED = (ReceiptMessage(granted, "").encode() for granted in (True, False))


class Learner:
    """A learner on a clock of its own, which answers the claims in turn, each after a time."""

    def __init__(self, answers):
        self.now, self._answers = 100.0, list(answers)

    def asking(self, key, payload, timeout, attachment):
        answer, late = self._answers.pop(0)
        end = self.now + min(late, timeout)
        while self.now < end:
            yield 0.02
        return answer if late <= timeout else None


def leads(monkeypatch, seconds, *answers):
    """Return for each second after the first claim whether the coordinator leads."""
    learner = Learner([*answers, *[(None, LEASE_SECONDS)] * seconds])
    monkeypatch.setattr(service, "monotonic", lambda: learner.now)
    coordinator = Coordinator.__new__(Coordinator)
    coordinator._options, coordinator._bus, coordinator._envelope = CoordinatorOptions("r", None, "c"), learner, b""
    coordinator._leads, coordinator._claimed, coordinator._granted = False, 0.0, -LEASE_SECONDS
    coordinator._claiming = None
    found = []
    for turn in range(50 * seconds):
        coordinator._claim()
        if turn % 50 == 49:
            found.append(coordinator._leads)
        learner.now += 0.02
    return found


def test_a_learner_that_answers_late_leaves_the_lead_where_it_is(monkeypatch):
    """Claims that are answered within the rest of the lease renew it: the lead does not flap."""
    assert leads(monkeypatch, 6, (GRANTED, 0.0), *[(GRANTED, 1.5)] * 4) == [True] * 6


def test_the_lead_is_held_for_a_lease_and_no_longer(monkeypatch):
    """Claims that nobody answers leave the lead until the lease has run out; a refusal ends it at once."""
    none = (None, LEASE_SECONDS)
    assert leads(monkeypatch, 4, (GRANTED, 0.0), none, none) == [True, True, True, False]
    assert leads(monkeypatch, 3, (GRANTED, 0.0), (REFUSED, 0.0), none) == [True, False, False]


def test_a_lead_that_was_granted_too_late_is_none(monkeypatch):
    """The lease counts from the claim: after an answer that took a whole lease another coordinator may lead already."""
    assert leads(monkeypatch, 3, (GRANTED, LEASE_SECONDS)) == [False] * 3
