"""A fleet on hosts that are network namespaces, with mutual TLS and a delay on the way to the router."""

import os
import signal
import time
from pathlib import Path
from typing import Any

import pytest

from research.experiments.network.hosts import HOSTS, Hosts, evaluated, finish, happen
from research.experiments.network.namespaces import NETWORK, PORT, laboratory
from tests.system.fleet import PRESET, on_policy
from tests.system.hosts import LONG

DELAY = 0.02
AT_SITE = 'site = "barn"\nworkers = {}\n'
SITE = {"router": "workers = 2\n", "learner": "", "barn": AT_SITE.format(3), "field": AT_SITE.format(3)}
"""Hosts with a main router, and with one of a site; on these are six of eight workers."""
COUNTS = (("router", 2), ("barn", 3), ("field", 3))
RESTARTED = (("router", 3), ("learner", 2), ("barn", 4), ("field", 3))
"""Processes of each host."""
TABLES = f"""learners = 2
[sites.barn]
host = "barn"
endpoint = "tls/{NETWORK}.{list(SITE).index("barn") + 1}:{PORT}"
"""


def on_hosts(folder: Path, cut: float) -> dict[str, Any]:
    """Run the tiny farm on six hosts, one of which joins and one of which is cut off; return the results."""
    with laboratory(folder, len(HOSTS), DELAY) as lab:
        if lab is None:
            pytest.skip("making network namespaces needs root and iproute2")
        fleet = Hosts(lab, PRESET, LONG)
        return happen(fleet, cut) | finish(fleet)


def check(results: dict[str, Any]) -> None:
    """Nothing is unexplained, and every worker delivered."""
    assert results["ledger"]["unexplained"] == results["ledger"]["counted_twice"] == 0, results
    assert set(results["accepted_by_worker"]) == {"first-0", "second-0", "late-0"}
    assert min(results["accepted_by_worker"].values()) > 0


@pytest.mark.nightly
@pytest.mark.timeout(600)
def test_six_hosts_train_while_one_joins_and_one_is_cut_off(tmp_path):
    """A host that joins delivers, one that is cut off for a moment comes back, and every chunk is explained."""
    check(on_hosts(tmp_path, cut=2.0))


@pytest.mark.nightly
@pytest.mark.timeout(1200)
def test_a_long_cut_is_caught_up(tmp_path):
    """A host that is cut off for fifteen leases delivers nothing meanwhile, and is back within 30 seconds."""
    results = on_hosts(tmp_path, cut=60.0)
    check(results)
    assert results["chunks_while_cut_off"] == 0
    assert results["seconds_to_recover"] <= 30.0


@pytest.mark.nightly
@pytest.mark.timeout(1200)
def test_two_routers_two_learners_and_eight_workers(tmp_path):
    """A router is killed, a worker drained, all hosts are restarted in turn, the fleet ended and resumed: none lost."""
    toml = on_policy("eia-ppo").replace("episodes = 8", "episodes = 1000000").replace("cycle = 2", "cycle = 200")
    with laboratory(tmp_path, len(SITE), DELAY) as lab:
        if lab is None:
            pytest.skip("making network namespaces needs root and iproute2")
        fleet = Hosts(lab, PRESET, toml, SITE, TABLES)
        file, workers = str(fleet.file), [f"{host}-{n}" for host, count in COUNTS for n in range(count)]

        def all_deliver():
            before = {worker: fleet.taken(worker) for worker in workers}
            fleet.until(lambda: all(fleet.taken(worker) > count for worker, count in before.items()), "chunks of all")

        fleet.eia_sec("up", file)
        all_deliver()
        for router in ("site.barn", "router.main"):
            before = fleet.processes()[router]["pid"]
            os.kill(before, signal.SIGKILL)
            fleet.until(lambda r=router, b=before: fleet.processes()[r]["pid"] not in (0, b), f"another {router}")
            all_deliver()
        fleet.eia_sec("down", file, "--process", "rollout.field-0")
        assert fleet.state("rollout.field-0") == "down"
        fleet.eia_sec("up", file)
        said = fleet.eia_sec("restart", file, "--rolling").splitlines()
        assert said == [f"{host}: {count} processes restarted." for host, count in RESTARTED]
        all_deliver()
        fleet.eia_sec("down", file)
        fleet.eia_sec("up", file)
        all_deliver()
        results = finish(fleet)
    assert results["ledger"]["unexplained"] == results["ledger"]["counted_twice"] == 0, results
    assert results["ledger"]["lost"] == 0, results
    assert set(results["accepted_by_worker"]) == set(workers)


@pytest.mark.nightly
@pytest.mark.timeout(3600)
def test_they_learn(tmp_path):
    """The quick preset, trained on six hosts, ends far above who does not move or moves at random, on unseen farms."""
    with laboratory(tmp_path, len(HOSTS), DELAY) as lab:
        if lab is None:
            pytest.skip("making network namespaces needs root and iproute2")
        fleet = Hosts(lab, "quick", "episodes = 1200")
        happen(fleet, cut=10.0)
        fleet.until(lambda: time.sleep(5.0) or fleet.state("learner.learner") == "finished", "the end", 3000.0)
        check(finish(fleet))
        rewards = evaluated(fleet, "1000:1010")
    assert rewards["trained"] > 500.0 > max(rewards["static"], rewards["random"])
