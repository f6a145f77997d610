"""Messages that are doubled, overtaken, cut and flipped: the accepted set is exact, and so are the counters."""

import time
from typing import Any

import pytest

from eia_sec.common.history.history import History
from tests.faults.tools.channel import Road, front_door, shut, travel
from tests.faults.tools.harness import record_result


def bad_road(workers: int, chunks: int, path: Any = None) -> dict[str, Any]:
    """Send chunks over a bad road; return the results, checked for exactness."""
    road, started = Road(), time.process_time()
    receiver, door = front_door(history=History(path))
    out = travel(road, workers, chunks, receiver, door)
    shut(receiver, door)
    totals, answers = receiver.ledger.totals(), out["answers"]
    wanted = {(str(worker), number) for worker in range(workers) for number in range(1, chunks + 1)}
    assert set(out["accepted"]) == wanted
    assert set(out["accepted"].values()) == {1}
    assert totals["accepted"] == totals["produced"] == workers * chunks
    assert (totals["lost"], totals["rejected"], totals["refused"], totals["in_flight"]) == (0, 0, 0, 0)
    assert totals["damaged"] == road.done["cut"] + road.done["flipped"] - road.done["unseen"]
    assert totals["duplicates"] >= road.done["duplicated"] // 2
    # What came damaged and had been taken before is answered as a duplicate, and counted as damaged alone.
    assert totals["duplicates"] + totals["damaged"] == answers["duplicate"] + answers["damaged"]
    measured = {kind: road.done[kind] for kind in ("several", "duplicated", "reordered", "cut", "flipped", "unseen")}
    measured |= {"counted_damaged": totals["damaged"], "counted_duplicates": totals["duplicates"]}
    return {
        "chunks": workers * chunks,
        "sendings": answers["sendings"],
        **measured,
        "accepted": totals["accepted"],
        "accepted_twice": sum(count - 1 for count in out["accepted"].values()),
        "processor_seconds": round(time.process_time() - started, 1),
    }


def test_a_bad_road(tmp_path):
    """The accepted set is exact, and damaged frames are counted exactly, on a road that does everything wrong."""
    measured = bad_road(4, 600, tmp_path / "learner.jsonl")
    assert min(measured[kind] for kind in ("several", "duplicated", "reordered", "cut", "flipped")) > 10


@pytest.mark.nightly
@pytest.mark.timeout(3600)
def test_a_bad_road_at_full_dose():
    """A hundred thousand chunks, a tenth doubled, a tenth overtaken, a hundredth cut and flipped: the set is exact."""
    measured = bad_road(8, 12_500)
    record_result("bad_road", **measured)
    assert measured["accepted"] == 100_000
    assert min(measured["duplicated"], measured["reordered"]) >= 10_000
    assert min(measured["cut"], measured["flipped"]) >= 1_000
