"""The coordinator's claim to the lead, at a learner that answers late or not at all."""

import time
from types import SimpleNamespace

from eia_sec.common.imitation import LEASE_SECONDS
from eia_sec.common.protocol.messages import ReceiptMessage
from eia_sec.elite import service
from eia_sec.elite.service import Coordinator, CoordinatorOptions

GRANTED, REFUSED = (ReceiptMessage(granted, "").encode() for granted in (True, False))


class Learner:
    """A learner on a clock of its own, which answers the claims in turn, each after a time."""

    def __init__(self, answers):
        self.now, self._answers = 100.0, list(answers)

    def ask(self, key, payload, timeout, attachment):
        answer, late = self._answers.pop(0)
        self.now += min(late, timeout)
        return answer if late <= timeout else None


def leads(monkeypatch, *answers):
    """Return after each answer whether the coordinator leads."""
    learner = Learner(answers)
    monkeypatch.setattr(service, "time", SimpleNamespace(monotonic=lambda: learner.now, sleep=time.sleep))
    coordinator = Coordinator.__new__(Coordinator)
    coordinator._options, coordinator._bus, coordinator._envelope = CoordinatorOptions("r", None, "c"), learner, b""
    coordinator._leads, coordinator._claimed, coordinator._granted = False, 0.0, -LEASE_SECONDS
    found = []
    for _ in answers:
        coordinator._claim()
        found.append(coordinator._leads)
        learner.now += service.CLAIM_SECONDS
    return found


def test_a_learner_that_answers_late_leaves_the_lead_where_it_is(monkeypatch):
    """Answers that take up to a lease grant it all the same: the lead does not flap."""
    late = 0.9 * LEASE_SECONDS
    assert leads(monkeypatch, (GRANTED, 0.0), (GRANTED, 1.5), (GRANTED, late), (GRANTED, 0.0)) == [True] * 4


def test_the_lead_is_held_for_a_lease_and_no_longer(monkeypatch):
    """Claims that nobody answers leave the lead until the lease has run out; a refusal ends it at once."""
    none = (None, 0.0)
    assert leads(monkeypatch, (GRANTED, 0.0), none, none, none, none) == [True, True, True, False, False]
    assert leads(monkeypatch, (GRANTED, 0.0), (REFUSED, 0.0), none) == [True, False, False]
