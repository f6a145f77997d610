"""A later start of the learner has a higher epoch, whatever the clock shows."""

from types import SimpleNamespace

import pytest

from eia_sec.common.history.history import History, Start
from eia_sec.common.incarnation import STRIDE, new_incarnation
from eia_sec.common.protocol.messages import ProgressMessage
from eia_sec.learner.checkpoint.recovery import last_epoch
from eia_sec.learner.checkpoint.storage import RunStorage
from eia_sec.learner.intake.ledger import Ledger
from eia_sec.learner.off_policy.trainer import OffPolicyTrainer
from eia_sec.learner.process.epoch import SuccessorWatch
from eia_sec.learner.process.service import HISTORY, Learner
from tests.learner.checkpoint.test_resume import CONFIG, TEAM

DAY = 86_400 * 10**6


def start(directory, trainer, clock, monkeypatch):
    """Resume a learner's state in a directory under a faked clock; return its epoch and the ledger's losses."""
    monkeypatch.setattr("eia_sec.common.clock.time.time_ns", lambda: clock * 1000)
    learner = Learner.__new__(Learner)
    learner._options, learner.trainer = SimpleNamespace(run_dir=directory, resume=True, start=tuple), trainer
    learner._storage = RunStorage(directory, CONFIG)
    learner._restore()
    learner._history.close()
    return learner._epoch


@pytest.mark.parametrize("checkpoint", [False, True])
def test_the_epoch_grows_although_the_clock_was_set_back(tmp_path, monkeypatch, checkpoint):
    """The first start's clock is a day ahead; later starts get higher epochs from the checkpoint or the history."""
    now = 1_800_000_000 * 10**6
    trainer = OffPolicyTrainer(CONFIG, TEAM)
    epochs = [start(tmp_path, trainer, now + DAY, monkeypatch)]
    assert epochs == [now + DAY]
    if checkpoint:
        RunStorage(tmp_path, CONFIG).save(trainer, Ledger(), 0.0, epochs[0], wait=True)
        (tmp_path / HISTORY).unlink()
    epochs += [start(tmp_path, trainer, clock, monkeypatch) for clock in (now, now + 1, now - DAY)]
    assert sorted(set(epochs)) == epochs
    assert epochs[-1] <= now + DAY + 3 * STRIDE
    assert start(tmp_path, trainer, now + 2 * DAY, monkeypatch) == now + 2 * DAY


def test_two_copies_of_a_run_directory_get_different_epochs():
    """Both know the same last epoch, which is ahead of both clocks; one of the two learners has to be the newer one."""
    last = 2**61
    assert len({new_incarnation(last) for _ in range(20)}) > 1
    assert all(last < new_incarnation(last) <= last + STRIDE for _ in range(20))


def test_only_starts_of_the_learner_count(tmp_path):
    """A history may hold other records; what no clock shows is no record."""
    history = History(tmp_path / "h.jsonl")
    for role, number in (("learner", 5), ("rollout", 99), ("learner", 3)):
        history.add(Start(role, "x", number))
    history.close()
    path = tmp_path / "h.jsonl"
    path.write_text(path.read_text() + f'["start","learner","learner",{2**70}]\n')
    assert last_epoch(History(path).before) == 5
    assert last_epoch([]) == 0


def test_a_learner_gives_way_to_a_higher_epoch_only():
    """Progress of its own epoch, of a lower one, or a message that is none does not replace it."""
    waiting = []
    bus = SimpleNamespace(subscribe_state=lambda key: SimpleNamespace(poll=lambda: waiting.pop() if waiting else None))
    watch = SuccessorWatch(bus, "farm", 7)
    found = []
    for number in (6, 7, 8):
        waiting.append(SimpleNamespace(payload=ProgressMessage(number, 0, 0, 0, 0, 0, "training").encode()))
        found.append(watch.replaced())
    waiting.append(SimpleNamespace(payload=b"none"))
    assert [*found, watch.replaced(), watch.replaced()] == [False, False, True, False, False]
