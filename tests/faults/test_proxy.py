"""Real workers and a real learner with a proxy between that doubles, delays, cuts and flips their messages."""

from typing import Any

import pytest

from eia_sec.common.transport.endpoint import free_endpoint
from tests.faults.tools.channel import Road
from tests.faults.tools.harness import record_result, run
from tests.faults.tools.proxy import Proxy
from tests.system.fleet import until

KINDS = ("duplicated", "reordered", "cut", "flipped")


def through_a_proxy(directory, road: Road, least: int) -> dict[str, Any]:
    """Train through a proxy until each thing was done `least` times; return the results."""
    with run(directory) as fleet:
        fleet.learner()
        there = fleet.endpoint
        fleet.configuration()
        with Proxy(free_endpoint(), there, road) as proxy:
            fleet.endpoint = proxy.here
            fleet.worker("0")
            fleet.worker("1")
            until(lambda: min(road.done[kind] for kind in KINDS) >= least, "all that may befall a message", 600.0)
            workers = [fleet.running.pop(f"rollout-{name}") for name in "01"]
            for worker in workers:
                worker.terminate()
            assert [worker.wait(60.0) for worker in workers] == [0, 0]
        fleet.endpoint = there
        fleet.end()
        ledger = fleet.records("status")[-1]["ledger"]
        found = fleet.audit()
        return {
            **{kind: road.done[kind] for kind in (*KINDS, "unseen")},
            "answers": dict(proxy.verdicts),
            **{f"counted_{name}": ledger[name] for name in ("damaged", "duplicates", "accepted", "unexplained")},
            "lost_chunks": found.chunks["lost"],
            "accepted_chunks": found.chunks["accepted"],
            "unexplained": len(found.unexplained),
            "doubled": len(found.doubled),
        }


def check(measured: dict[str, Any]) -> None:
    assert measured["unexplained"] == measured["doubled"] == measured["counted_unexplained"] == 0
    assert measured["accepted_chunks"] == measured["answers"]["accepted"]
    assert measured["counted_damaged"] == measured["cut"] + measured["flipped"] - measured["unseen"]
    answers = measured["answers"]
    assert measured["counted_duplicates"] + measured["counted_damaged"] == answers["duplicate"] + answers["damaged"]
    assert measured["counted_duplicates"] > 0


def test_through_a_bad_proxy(tmp_path):
    """What real workers made is taken exactly once, and what was damaged on the way is counted exactly."""
    check(through_a_proxy(tmp_path, Road(cut=0.1, flipped=0.1), least=3))


@pytest.mark.nightly
@pytest.mark.timeout(1800)
def test_through_a_bad_proxy_at_full_dose(tmp_path):
    """The same with a tenth doubled and late and a hundredth damaged, until each damage was done fifty times."""
    measured = through_a_proxy(tmp_path, Road(), least=50)
    record_result("bad_proxy", **measured)
    check(measured)
