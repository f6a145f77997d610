"""How a study's jobs are shared out among processes, and how far they are."""

import errno
import os
import threading
from pathlib import Path

import pytest

from eia_sec.common.actors import TeamActors
from eia_sec.common.errors import RunDirError
from eia_sec.common.farm import farm_team
from eia_sec.common.process import StopSignal
from research.studies import perform
from research.studies.bench import Bench
from research.studies.jobs import Records
from research.studies.methods import EIA_SEC
from research.studies.perform import kept
from research.studies.runner import Runner, packed
from research.studies.scales import FIRST_FARM
from tests.research.studies.tiny_study import TINY, trained


@pytest.fixture
def bench(tmp_path):
    return Bench(TINY, Records(tmp_path / "records"))


def test_short_jobs_share_a_process(bench):
    """Jobs keep their order, and a long one has a process of its own."""
    jobs = [*bench.references(), *bench.runs(EIA_SEC, 1)]
    seconds = {job.digest: 10.0 for job in jobs[:-1]} | {jobs[-1].digest: 500.0}
    loads = packed(jobs, seconds)
    assert [len(load.jobs) for load in loads] == [len(jobs) - 1, 1]
    assert [job for load in loads for job in load.jobs] == jobs
    assert str(loads[0]) == "random and 2 more"
    assert len(packed(jobs, {job.digest: 100.0 for job in jobs})) == len(jobs)


def full_disk(monkeypatch, times):
    """Let so many writes of files with an ending find the disk full."""
    replaced = os.replace

    def replace(source, target):
        ending = "".join(Path(target).suffixes)
        if times.get(ending, 0) > 0:
            times[ending] -= 1
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        replaced(source, target)

    monkeypatch.setattr(os, "replace", replace)
    monkeypatch.setattr(perform, "ROOM_SECONDS", 0.1)


def test_a_full_disk_costs_no_training(bench, monkeypatch, capfd):
    """The policy and the record of a run, and a study's jobs, wait for room; that is no part of the run's time."""
    full_disk(monkeypatch, {".safetensors": 2, ".json": 1, ".job.json": 1})
    job, shares = bench.runs(EIA_SEC, 1)[0], []
    result, actors = trained(FIRST_FARM, [1.0, 2.0, 3.0]), TeamActors.initial(farm_team(job.config.farm), 16, 0)
    monkeypatch.setattr(perform, "train", lambda config, options, report: (result, actors))
    kept(lambda: bench.records.hand_over(job), shares.append)
    perform.perform(job, bench.records, "python -m research.studies training", shares.append)
    assert shares == [1.0] * 4
    assert bench.records.missing([job], flown=True) == []
    assert bench.records.get(job)["seconds"] < 0.2
    names = {path.name for path in bench.records.folder.iterdir()}
    assert names == {job.digest + ending for ending in (".safetensors", ".json", ".job.json")}
    assert capfd.readouterr().err.count("It waits for room.") == 3


def test_who_waits_for_room_can_be_stopped(bench, monkeypatch):
    """A study that cannot even write its jobs ends when asked to, as one that was stopped."""
    full_disk(monkeypatch, {".job.json": 10**9})
    stop = StopSignal()
    threading.Timer(0.2, stop.event.set).start()
    job = bench.runs(EIA_SEC, 1)[0]
    assert not Runner(bench.records, 1, "python -m research.studies", print).run([job], {job.digest: 1.0}, stop)
    assert [path.name for path in bench.records.folder.iterdir()] == ["logs"]


def test_what_is_not_for_want_of_room_is_reported_at_once(bench):
    """A folder that has gone does not come back by waiting."""
    bench.records.folder.rmdir()
    with pytest.raises(RunDirError, match=r"cannot write .*No such file"):
        kept(lambda: bench.records.hand_over(bench.runs(EIA_SEC, 1)[0]), print)
