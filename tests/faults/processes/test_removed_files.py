"""Files of the run directory that somebody removes while the learner uses them."""

from tests.faults.tools.harness import run
from tests.system.fleet import RUN, free_endpoint, until


def test_history_and_metrics_removed_under_a_learner(tmp_path):
    """Both are there again with an alarm each, and the new history is whole: the audit explains every step."""
    with run(tmp_path) as fleet:
        fleet.learner()
        fleet.worker()
        until(lambda: len(fleet.records("status")) > 1 and fleet.taken(), "chunks and a status", 240.0)
        taken = fleet.accepted("0")[0]
        files = [tmp_path / "run" / "history" / "learner.jsonl", tmp_path / "run" / "metrics.jsonl"]
        for file in files:
            file.unlink()
        with fleet.metrics("learner", "learner") as reports:
            for file in files:
                said = f"{file.name} was removed while in use"
                until(lambda s=said: any(s in a for v in reports() for a in v["alarms"]), said, 60.0)
        until(lambda: all(file.exists() for file in files), "both files", 60.0)
        until(lambda: fleet.records("status"), "a status in the new file", 60.0)
        fleet.until_more()
        assert fleet.accepted("0")[0].first == taken.first
        fleet.end()
        fleet.audit()


def test_a_second_learner_is_refused_although_the_lock_file_was_removed(tmp_path):
    """It ends with one sentence and code 2, and the first learner goes on."""
    with run(tmp_path) as fleet:
        fleet.learner()
        fleet.worker()
        until(fleet.taken, "chunks", 240.0)
        directory = tmp_path / "run"
        locks = list(directory.glob("*.lock"))
        assert locks
        for lock in locks:
            lock.unlink()
        where = ("--run", RUN, "--listen", str(free_endpoint()), "--run-dir", str(directory))
        fleet.start("second", "learner", *where, *fleet.wanted, "--resume")
        assert fleet.wait("second") == 2
        fleet.running.pop("second")
        assert f"{directory} is in use by another process." in fleet.log("second")
        fleet.until_more()
        fleet.end()
        fleet.audit()
