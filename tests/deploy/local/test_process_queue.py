"""Work in processes of their own: how it is shared out, what fails, and what is said of it."""

import os
import threading

import pytest

from eia_sec.common.errors import EiaSecError
from eia_sec.common.process import StopSignal
from eia_sec.deploy.local.process_queue import ProcessQueue, Work, _Clock, progress
from eia_sec.deploy.local.supervisor import Supervisor

PROGRAM = """
import pathlib, sys, time
print("progress 0.5", flush=True)
task, folder = sys.argv[1], pathlib.Path(sys.argv[2])
(folder / f"{task}.running").touch()
if task == "bad":
    print("no luck")
elif task == "long":
    time.sleep(60)
else:
    time.sleep(0.2)
    (folder / f"{task}.most").write_text(str(len(list(folder.glob("*.running")))))
(folder / f"{task}.running").unlink()
"""


class File(Work):
    """Writes a file with how many ran at the time."""

    def __init__(self, name, folder):
        super().__init__(name, f"work {name}", [name, str(folder)], 1.0)
        self.folder, self.cleaned = folder, False

    def begin(self, stop):
        return not stop

    def is_done(self):
        return (self.folder / f"{self.name}.most").is_file()

    def clean(self):
        self.cleaned = True


@pytest.fixture
def queue(tmp_path):
    """A queue of two processes at a time, its folder and what it has said."""
    (tmp_path / "toy_work.py").write_text(PROGRAM)
    (tmp_path / "results").mkdir()
    said = []
    supervisor = Supervisor(tmp_path / "logs", {"PYTHONPATH": str(tmp_path)}, "toy_work")
    return ProcessQueue(supervisor, tmp_path / "logs", 2, said.append), tmp_path, said


def test_all_work_is_done(queue):
    """Never more than two run at a time, each is said once, and no log stays."""
    own, folder, said = queue
    work = [File(name, folder / "results") for name in "abcd"]
    assert own.run(work, StopSignal())
    counts = [int((folder / "results" / f"{one.name}.most").read_text()) for one in work]
    assert set(counts) <= {1, 2}
    assert all(one.cleaned for one in work)
    assert sorted(line.split(":")[0].split(" ", 1)[1] for line in said) == [f"work {name}" for name in "abcd"]
    assert os.listdir(folder / "logs") == []


def test_work_without_a_result_has_failed(queue):
    """The rest is done all the same, and the last lines of the one that failed are in the sentence."""
    own, folder, _ = queue
    work = [File(name, folder / "results") for name in ("bad", "a")]
    with pytest.raises(EiaSecError, match=r"1 of 2 processes failed; the last lines of work bad:\n[^$]*no luck"):
        own.run(work, StopSignal())
    assert [one.is_done() for one in work] == [False, True]
    assert not work[0].cleaned


def test_a_stop_ends_what_runs(queue):
    """Nothing new begins, and what runs is ended."""
    own, folder, _ = queue
    stop = StopSignal()
    work = [File(name, folder / "results") for name in ("long", "a")]
    threading.Timer(2.0, stop.event.set).start()
    assert not own.run(work, stop)
    assert not work[0].is_done()


def test_the_time_to_go_follows_from_what_is_done():
    """Nothing is said before anything is done; then what is left is as slow as what is finished and what runs."""
    clock = _Clock(2)
    one, two, three = (File(name, None) for name in "abc")
    assert clock.left([two, three], {one: (0.0, 5.0)}) is None
    assert clock.left([], {one: (0.25, 10.0)}) == pytest.approx(30.0)
    clock.finished(one, 40.0)
    assert clock.left([three], {two: (0.5, 20.0)}) == pytest.approx(40.0 * 1.5 / 2)


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
def test_progress_is_the_last_line_that_reports_it(lines, share):
    """Whatever else a process writes is passed over."""
    assert progress(lines) == share
