"""The tests themselves: with a safeguard taken away, the test that is there for it fails."""

import numpy as np
import pytest

from eia_sec.common.actors import TeamActors
from eia_sec.common.history.history import Entry, History
from eia_sec.common.policy_store import PolicyStore
from eia_sec.common.protocol import frame
from eia_sec.common.protocol.messages import ParametersMessage
from eia_sec.learner.checkpoint import recovery
from eia_sec.learner.intake.ledger import Ledger
from eia_sec.learner.process.lease import Lease
from tests.faults.test_messages import bad_road
from tests.faults.tools.channel import TEAM
from tests.learner.checkpoint import test_recovery
from tests.learner.process import test_lease


def stale_parameters_are_refused() -> None:
    """Assert that a store takes nothing of a learner that has been replaced."""
    store = PolicyStore(TEAM)
    both_actors = [TeamActors.initial(TEAM, 4, seed, per_type=False) for seed in (0, 1)]
    for epoch, version, actors in ((2, 5, both_actors[0]), (1, 999, both_actors[1])):
        store.offer_parameters(
            ParametersMessage(epoch, version, 0, 1, 0.0, TEAM.digest, 4, "deterministic", actors.flat)
        )
    assert store.actors is not None
    assert np.array_equal(store.actors.flat[0], both_actors[0].flat[0])
    assert store.ignored == 1


def test_the_road_without_deduplication(monkeypatch):
    """Without deduplication the bad road delivers something twice, and its test fails."""
    judge = Ledger.judge

    def credulous(self, sender, oldest):
        status = judge(self, sender, oldest)
        return "accepted" if status == "duplicate" else status

    monkeypatch.setattr(Ledger, "judge", credulous)
    with pytest.raises(AssertionError):
        bad_road(2, 200)


def test_the_road_without_checksum(monkeypatch):
    """Without the checksum a flipped frame is taken, and the bad road's test fails."""
    monkeypatch.setattr(frame, "checksum", lambda *parts: 0)
    with pytest.raises(AssertionError, match="flipped frame was taken"):
        bad_road(2, 1_000)


def test_fencing(monkeypatch):
    """With the epoch left out of the comparison, parameters of a replaced learner are taken, and the test fails."""
    stale_parameters_are_refused()
    offer = PolicyStore.offer_parameters

    def unfenced(self, message):
        self.epoch = min(self.epoch, message.epoch)
        return offer(self, message)

    monkeypatch.setattr(PolicyStore, "offer_parameters", unfenced)
    with pytest.raises(AssertionError):
        stale_parameters_are_refused()


def test_the_lease(monkeypatch):
    """A learner that grants the lead to everybody fails the test of the lease."""
    monkeypatch.setattr(Lease, "claim", lambda self, name, incarnation, now: True)
    with pytest.raises(AssertionError):
        test_lease.test_the_first_claimant_leads_until_it_is_silent()


def test_the_history_of_losses(tmp_path, monkeypatch):
    """A resumed learner that does not look into its history fails the test of exact losses."""
    monkeypatch.setattr(recovery, "_book", lambda ledger, entry: None)
    with pytest.raises(AssertionError):
        test_recovery.test_what_was_acknowledged_after_the_checkpoint_is_lost_exactly(tmp_path, 2)


def test_acknowledgement_before_booking(tmp_path, monkeypatch):
    """A receiver that acknowledges what it does not write down fails the audit."""
    from tests.deploy.monitor.test_audit import write  # noqa: PLC0415  # only this test needs it

    kept = History.add

    def forgetful(self, record):
        if not (isinstance(record, Entry) and record.verdict == "accepted"):
            kept(self, record)

    entries = [("accepted", 1, 2, 10)], [("produced", 1, 2, 10), ("acknowledged", 1, 2, 10)]
    assert write(tmp_path / "whole", *entries).clean
    monkeypatch.setattr(History, "add", forgetful)
    (named,) = write(tmp_path / "forgetful", *entries).unexplained
    assert named.startswith("chunks a/1/1 to 2 were answered as accepted")
