"""Faults at moments that chance rarely meets, and two at once."""

import pytest

from eia_sec.deploy.monitor.audit import audit
from tests.faults.tools.dying_learner import AFTER
from tests.faults.tools.harness import Routed, run
from tests.faults.tools.network import Relay
from tests.faults.tools.shifted_clock import AHEAD
from tests.system.fleet import free_endpoint, until

DAY = 86_400


@pytest.mark.parametrize("answers", [0, 7])
def test_a_learner_killed_between_its_history_and_its_answer(tmp_path, monkeypatch, answers):
    """The chunk is written down and not acknowledged: it comes again, counts once, and losses are exact."""
    with run(tmp_path) as fleet:
        monkeypatch.setattr(fleet, "module", "tests.faults.tools.dying_learner")
        monkeypatch.setenv(AFTER, str(answers))
        fleet.learner()
        monkeypatch.undo()
        fleet.worker()
        assert fleet.wait("learner", 240.0) == -9
        written = fleet.taken()
        assert written
        fleet.learner("--resume")
        fleet.until_more()
        until(lambda: fleet.status().get("ledger"), "a status")
        fleet.end()
        found, ledger = fleet.audit(), fleet.status()["ledger"]
        assert ledger["unexplained"] == 0
        assert ledger["lost"] == found.lost_with["learner"]


@pytest.mark.parametrize("ahead", [-DAY, DAY])
def test_a_learner_replaced_behind_a_partition_by_one_with_another_clock(tmp_path, monkeypatch, ahead):
    """Workers follow the learner that they find when the link is back, whatever its clock says."""
    with run(tmp_path) as fleet:
        fleet.learner()
        there, here = fleet.endpoint, free_endpoint()
        relay = Relay(here, there)
        try:
            fleet.endpoint = here
            fleet.worker()
            until(fleet.taken, "chunks", 120.0)
            relay.weather.stalled = True
            fleet.kill("learner")
            fleet.endpoint = there
            monkeypatch.setattr(fleet, "module", "tests.faults.tools.shifted_clock")
            monkeypatch.setenv(AHEAD, str(ahead))
            fleet.learner("--resume")
            monkeypatch.undo()
            until(lambda: fleet.log("learner").count("listening") > 0 or fleet.status(), "the next learner", 60.0)
            before = fleet.taken()
            relay.weather.stalled = False
            until(lambda: fleet.taken() > before, "chunks for the next learner", 90.0)
            until(lambda: fleet.status().get("ledger", {}).get("accepted"), "a status")
            fleet.end()
            found = fleet.audit()
            assert fleet.status()["ledger"]["unexplained"] == len(found.unexplained) == len(found.doubled) == 0
        finally:
            relay.close()


def test_workers_of_two_learners_with_one_name(tmp_path):
    """A learner that begins anew meets an old worker in the midst of its work, then a new one of the same name."""
    fleet = Routed(tmp_path)
    try:
        fleet.router()
        fleet.learner_at("one")
        fleet.worker()
        path = tmp_path / "one" / "history" / "learner.jsonl"
        until(lambda: path.exists() and '["accepted"' in path.read_text(), "chunks for the first learner", 240.0)
        fleet.kill("learner-one")
        fleet.learner_at("two")
        second = tmp_path / "two" / "history" / "learner.jsonl"
        until(lambda: second.exists() and '["accepted"' in second.read_text(), "chunks for the second", 120.0)
        fleet.running["rollout-old"] = fleet.running.pop("rollout-0")
        fleet.worker()
        assert fleet.wait("rollout-old", 60.0) == 2
        fleet.running.pop("rollout-old")
        starts = lambda: {line.split(",")[2] for line in second.read_text().splitlines() if '["accepted"' in line}  # noqa: E731  # one line, used once
        until(lambda: len(starts()) == 2, "chunks of the new worker", 60.0)
        fleet.end()
        assert audit(tmp_path / "two").clean
    finally:
        fleet.close()
