"""When a worker collects its next chunk on policy: its window, the version that it needs, and another learner."""

from types import SimpleNamespace

import pytest

from eia_sec.common.config import RolloutConfig
from eia_sec.common.protocol.codec import NO_LIMIT
from eia_sec.rollout.worker.collection_gate import FOREIGN_SECONDS, CollectionGate


def worker(**changed):
    """Return the gate of a worker that may collect, with what it looks at."""
    store = SimpleNamespace(actors="actors", version=5, epoch=1)
    learner = SimpleNamespace(
        store=store, state="training", epoch=1, window=NO_LIMIT, heard_at=1.0, newest_version=5, silence=0.0
    )
    sender = SimpleNamespace(window=NO_LIMIT, answered_at=2.0, in_flight=0, full=False, required_version=0, spooled=0)
    for name, value in changed.items():
        part, _, field = name.partition("_")
        setattr({"store": store, "learner": learner, "sender": sender}[part], field, value)
    gate = CollectionGate(RolloutConfig(), learner, sender, lockstep=False)  # type: ignore[arg-type]  # plain values
    gate._epoch = 1
    return gate, learner, sender


@pytest.mark.parametrize(("window", "under_way", "free"), [(1, 0, True), (1, 25, False), (50, 25, True), (0, 0, False)])
def test_a_worker_keeps_to_its_window(window, under_way, free):
    """With as many steps under way as the newest answer allows it waits."""
    gate, _, _ = worker(sender_window=window, sender_in_flight=under_way)
    assert (gate.actors() is not None) == free


@pytest.mark.parametrize("changed", [("learner_state", "finished"), ("store_actors", None)])
def test_a_reason_to_pause_ends_with_the_run(changed):
    """Why it paused is no longer said by a worker that waits for something else."""
    gate, learner, _ = worker(learner_silence=1e6)
    gate._config = RolloutConfig(max_silence_seconds=30.0)
    assert gate.actors() is None
    assert "silent" in gate.pause_reason
    part, _, field = changed[0].partition("_")
    setattr(learner if part == "learner" else learner.store, field, changed[1])
    assert gate.actors() is None
    assert gate.pause_reason == ""


def test_the_newest_word_counts():
    """A window that was published after the last answer replaces the answer's."""
    gate, learner, _ = worker(sender_window=0, learner_window=1)
    assert gate.actors() is None
    learner.heard_at = 3.0
    assert gate.actors() == "actors"


def test_a_worker_waits_for_the_version_that_the_answer_asks_for():
    """It collects as soon as these parameters have come."""
    gate, learner, _ = worker(sender_required_version=6)
    assert gate.actors() is None
    learner.store.version = 6
    assert gate.actors() == "actors"


def test_another_learner_may_have_lower_versions():
    """What the learner before it asked for no longer counts."""
    gate, learner, sender = worker(sender_required_version=900)
    assert gate.actors() is None
    learner.epoch = 2
    assert gate.actors() == "actors"
    sender.required_version = 7
    assert gate.actors() is None


def test_what_a_new_learner_asks_for_is_kept():
    """Its first answer may come while the spool is full; the version in it counts all the same."""
    gate, learner, sender = worker(sender_full=True)
    learner.epoch = 2
    assert gate.actors() is None
    sender.full, sender.required_version = False, 6
    assert gate.actors() is None
    learner.store.version = 6
    assert gate.actors() == "actors"


def test_what_an_earlier_learner_asked_for_too_late_does_not_hold_a_worker():
    """An answer may arrive after its learner's successor was followed, whose versions may stay below for ever."""
    gate, learner, _ = worker(sender_required_version=900)
    learner.heard_at = 2.0 + FOREIGN_SECONDS
    assert gate.actors() is None
    learner.heard_at += 0.1
    assert gate.actors() == "actors"
