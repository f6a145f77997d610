"""A worker whose environment ended it while it drew pictures draws none at its next starts."""

from types import SimpleNamespace
from unittest.mock import MagicMock

import pytest

from eia_sec.common.config import EnvConfig, RunConfig
from eia_sec.common.config.files import to_toml
from eia_sec.common.config.run import RolloutConfig
from eia_sec.common.history.history import Drawing, End, Start, read
from eia_sec.common.process import StopSignal
from eia_sec.rollout.worker import service
from eia_sec.rollout.worker.collector import Collector
from eia_sec.rollout.worker.service import Worker, WorkerOptions

STARTED = Start("rollout", "w", 1)
ENDED = "an earlier start of this worker ended without a word while it drew pictures"


@pytest.mark.parametrize(
    ("before", "silent"),
    [
        ([], False),
        ([STARTED], False),
        ([STARTED, Drawing(True), End()], False),
        ([STARTED, Drawing(True), Drawing(False)], False),
        ([STARTED, Drawing(True)], True),
        ([STARTED, Drawing(True), STARTED], True),
        ([STARTED, Drawing(True), STARTED, End(), STARTED, End()], True),
        ([STARTED, Drawing(True), End(), STARTED, Drawing(True)], True),
    ],
)
def test_what_drew_when_it_ended_draws_no_more(before, silent):
    """An orderly end, and pictures that had ceased, allow new ones; anything else forbids them for good."""
    assert service._silence(before) == (ENDED if silent else "")


def a_start(path, number):
    """Return a start of a worker whose environment draws, and its collector."""
    config = RunConfig(
        env=EnvConfig("tests.rollout.envs.toy_pictures:Drawn", "{}"),
        rollout=RolloutConfig(environments=1),
    )
    collector = Collector(config, "w", number)
    answer = SimpleNamespace(
        newest_incarnation=0, epoch=0, lockstep=False, team=collector.team.to_dict(), toml=to_toml(config)
    )
    options = WorkerOptions("run", "w", None, history=path)
    worker = Worker(
        options, config, answer, MagicMock(), MagicMock(), StopSignal(), MagicMock(), collector, number, MagicMock()
    )
    return worker, collector


def test_a_start_that_was_drawing_silences_the_next(tmp_path):
    """The record is there at once; the next start says why it draws nothing, unless the end was orderly."""
    path = tmp_path / "h.jsonl"
    worker, collector = a_start(path, 1)
    assert worker._view_service.silence == ""
    worker._view_service._probe.open(at_once=True)
    collector.environments.reset(0, 3, 7)
    assert read(path)[0][-1] == Drawing(True)
    crashed, _ = a_start(path, 2)
    assert crashed._view_service.silence == ENDED
    path.unlink()
    orderly, collector = a_start(path, 3)
    orderly._view_service._probe.open(at_once=True)
    collector.environments.reset(0, 3, 7)
    orderly.history.close()
    assert a_start(path, 4)[0]._view_service.silence == ""


def test_nothing_draws_any_more_once_nobody_watches(tmp_path):
    """The probe of the last watcher makes the environment a plain one, and the history says so."""
    path = tmp_path / "h.jsonl"
    worker, collector = a_start(path, 1)
    probe = worker._view_service._probe
    probe.open(at_once=True)
    collector.environments.reset(0, 3, 7)
    probe.close()
    collector.environments.reset(0, 3, 8)
    assert read(path)[0][-2:] == [Drawing(True), Drawing(False)]
    assert collector.environments.picture(0) is None
