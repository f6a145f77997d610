"""Partitions between network namespaces, and slow, narrow and stalled links."""

import subprocess
import time
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from eia_sec.common.transport.endpoint import Endpoint, free_endpoint
from tests.faults.tools.harness import FaultRun, memory, record_result, run
from tests.faults.tools.network import LEARNER, Pair, Relay, namespaces
from tests.system.fleet import until

WAYS = ("link", "both", "to_learner", "to_worker")


class Apart(FaultRun):
    """A learner in one namespace and workers in another."""

    def __init__(self, directory: Path, pair: Pair) -> None:
        super().__init__(directory)
        self.pair = pair
        self.endpoint = Endpoint.parse(f"tcp/{LEARNER}:7447")

    def start(self, name: str, *arguments: str) -> subprocess.Popen[bytes]:
        """Start one command inside the namespace of its side."""
        where = self.pair.learner if name == "learner" else self.pair.worker
        self.prefix = ("ip", "netns", "exec", where)
        return super().start(name, *arguments)


def partitions(directory: Path, doses: list[tuple[str, float]]) -> dict[str, Any] | None:
    """Part learner and worker in each way for so many seconds; return how they fared, or None without namespaces."""
    with namespaces() as pair:
        if pair is None:
            return None
        fleet = Apart(directory, pair)
        try:
            fleet.learner("--insecure")
            worker = fleet.worker()
            fleet.coordinator()
            until(fleet.taken, "chunks", 120.0)
            # Parted before it has joined, it would give up, as it should.
            fleet.until_led("")
            rows = []
            for way, seconds in doses:
                before = memory(worker)
                with pair.parted(way):
                    time.sleep(seconds)
                    grown = memory(worker) - before
                recovery = fleet.until_answered("0", seconds=120.0)
                rows.append(
                    {
                        "way": way,
                        "seconds": seconds,
                        "worker_grew_mib": round(grown, 1),
                        "seconds_to_recover": round(recovery, 2),
                    }
                )
            fleet.end()
            found = fleet.audit()
            return {
                "partitions": rows,
                "lost_chunks": found.chunks["lost"],
                "duplicates": found.duplicates,
                "unexplained": len(found.unexplained),
                "doubled": len(found.doubled),
            }
        finally:
            fleet.close()


def check_partitions(measured: dict[str, Any] | None, recovery: float) -> None:
    if measured is None:
        pytest.skip("making network namespaces needs more rights")
    wrong = {name: measured[name] for name in ("unexplained", "doubled", "lost_chunks") if measured[name]}
    assert not wrong, measured
    assert all(row["worker_grew_mib"] <= 64 for row in measured["partitions"])
    assert max(row["seconds_to_recover"] for row in measured["partitions"]) <= recovery


def test_partitions(tmp_path):
    """A link that is down and one that swallows everything for a moment lose nothing, and the worker goes on."""
    check_partitions(partitions(tmp_path, [("link", 0.5), ("both", 0.5)]), 60.0)


@pytest.mark.nightly
@pytest.mark.timeout(2400)
def test_partitions_at_full_dose(tmp_path):
    """Parted for 1, 6, 15 and 120 seconds in each way: nothing is lost, recovery within 15 seconds of healing."""
    doses = [(way, seconds) for seconds in (1.0, 6.0, 15.0) for way in WAYS] + [("link", 120.0), ("to_worker", 120.0)]
    measured = partitions(tmp_path, doses)
    if measured is not None:
        record_result("partitions", **measured)
    check_partitions(measured, 15.0)


def test_a_link_that_loses_packets(tmp_path):
    """Where the kernel emulates networks: one packet in twenty lost, doubled or late costs time and no chunk."""
    with namespaces() as pair:
        if pair is None:
            pytest.skip("making network namespaces needs more rights")
        if not pair.emulate("delay", "10ms", "5ms", "loss", "5%", "duplicate", "5%"):
            pytest.skip("this kernel has no network emulation (netem)")
        with closing(Apart(tmp_path, pair)) as fleet:
            fleet.learner("--insecure")
            fleet.worker()
            until(lambda: fleet.taken() > 50, "chunks over a bad link", 240.0)
            fleet.end()
            assert fleet.audit().chunks["lost"] == 0


def bad_links(directory: Path, stall: float) -> dict[str, Any]:
    """Run over a relay that is slow, then narrow, then stalled; return the results."""
    with run(directory) as fleet:
        fleet.learner()
        there, here = fleet.endpoint, free_endpoint()
        relay = Relay(here, there)
        try:
            fleet.endpoint = here
            worker = fleet.worker()
            until(fleet.taken, "chunks", 120.0)
            rates: dict[str, float] = {}
            for name, delay, width in (("clear", 0.0, 0.0), ("50 ms each way", 0.05, 0.0), ("64 KB/s", 0.0, 65_536.0)):
                relay.weather.delay, relay.weather.bytes_per_second = delay, width
                before, started = fleet.taken(), time.monotonic()
                time.sleep(2.0)
                rates[name] = round((fleet.taken() - before) / (time.monotonic() - started), 1)
            relay.weather.bytes_per_second = 0.0
            before = memory(worker)
            relay.weather.stalled = True
            time.sleep(stall)
            grown = memory(worker) - before
            relay.weather.stalled = False
            recovery = fleet.until_more(seconds=60.0)
            fleet.endpoint = there
            fleet.end()
            found = fleet.audit()
            return {
                "chunks_per_second": rates,
                "stall_seconds": stall,
                "worker_grew_mib": round(grown, 1),
                "seconds_to_recover": round(recovery, 2),
                "lost_chunks": found.chunks["lost"],
                "duplicates": found.duplicates,
                "unexplained": len(found.unexplained),
            }
        finally:
            fleet.close()
            relay.close()


def check_links(measured: dict[str, Any]) -> None:
    assert measured["lost_chunks"] == measured["unexplained"] == 0
    assert measured["worker_grew_mib"] <= 64
    assert min(measured["chunks_per_second"].values()) > 0


def test_bad_links(tmp_path):
    """Over a slow, a narrow and a stalled link chunks still come, and none is lost."""
    check_links(bad_links(tmp_path, stall=2.0))


@pytest.mark.nightly
@pytest.mark.timeout(900)
def test_bad_links_at_full_dose(tmp_path):
    """The same with a stall of 30 seconds, longer than a lease."""
    measured = bad_links(tmp_path, stall=30.0)
    record_result("bad_links", **measured)
    check_links(measured)
