"""How a study's jobs are shared out among processes, and how far they are."""

import pytest

from deploy.studies.bench import Bench
from deploy.studies.jobs import Records
from deploy.studies.methods import EIA_SEC
from deploy.studies.runner import duration, packed, progress
from tests.deploy.tiny_study import TINY


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


@pytest.mark.parametrize(
    ("lines", "share"),
    [
        ("", 0.0),
        ("progress 0.25\nprogress 0.5", 0.5),
        ("progress x", 0.0),
        ("progress 7", 1.0),
        ("progress 0.1\nwarning", 0.1),
    ],
)
def test_progress_is_the_last_line_that_tells_it(lines, share):
    """Whatever else a process writes is passed over."""
    assert progress(lines) == share


def test_durations_are_said_as_people_say_them():
    """Seconds, minutes, hours."""
    assert [duration(seconds) for seconds in (5.0, 600.0, 7200.0)] == ["5 s", "10 min", "2.0 h"]
