"""A learner whose epoch is lower than the one before, which neither its run directory nor its clock knows."""

import shutil

from tests.faults.tools.harness import run
from tests.faults.tools.shifted_clock import AHEAD
from tests.system.fleet import until

DAY = 86_400


def test_living_processes_follow_a_lower_epoch_after_an_alarm(tmp_path, monkeypatch):
    """Worker and coordinator ignore it with an alarm at first; later both work for it."""
    with run(tmp_path) as fleet:
        monkeypatch.setattr(fleet, "module", "tests.faults.tools.shifted_clock")
        monkeypatch.setenv(AHEAD, str(DAY))
        fleet.learner()
        monkeypatch.undo()
        fleet.worker()
        fleet.coordinator()
        until(lambda: fleet.records("imitation"), "an imitation event", 240.0)
        before = fleet.configuration().epoch
        fleet.kill("learner")
        directory = tmp_path / "run"
        # The first event may come before the first checkpoint.
        shutil.rmtree(directory / "checkpoints", ignore_errors=True)
        assert not (directory / "checkpoints").exists()
        (directory / "history" / "learner.jsonl").unlink()
        (directory / "metrics.jsonl").unlink()
        fleet.learner()
        with fleet.metrics("rollout", "0") as worker, fleet.metrics("elite", "coordinator") as coordinator:
            for reports in (worker, coordinator):
                until(lambda r=reports: any("lower epoch" in a for v in r() for a in v["alarms"]), "an alarm", 60.0)
            alarmed = [v["epoch"] for v in worker() if any("lower epoch" in text for text in v["alarms"])]
            assert set(alarmed) == {before}
            after = fleet.configuration().epoch
            assert after < before
            until(lambda: worker()[-1]["epoch"] == after, "a worker with the new actors", 60.0)
            until(
                lambda: not any(reports()[-1]["alarms"] for reports in (worker, coordinator)), "the alarms' end", 60.0
            )
        until(lambda: fleet.records("imitation"), "an imitation event of the new learner", 240.0)
        assert fleet.status()["updates"] > 0
        fleet.end()
