"""A fleet on hosts that are network namespaces, with mutual TLS and a delay on the way to the router."""

from pathlib import Path
from typing import Any

import pytest

from research.experiments.network.hosts import ROLES, Hosts, evaluated, finish, happen
from research.experiments.network.namespaces import laboratory
from tests.system.fleet import PRESET
from tests.system.hosts import LONG

DELAY = 0.02


def on_hosts(folder: Path, cut: float) -> dict[str, Any]:
    """Run the tiny farm on six hosts, one of which joins and one of which is cut off; return the results."""
    with laboratory(folder, len(ROLES), DELAY) as lab:
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
@pytest.mark.timeout(3600)
def test_they_learn(tmp_path):
    """The quick preset, trained on six hosts, ends far above who does not move or moves at random, on unseen farms."""
    with laboratory(tmp_path, len(ROLES), DELAY) as lab:
        if lab is None:
            pytest.skip("making network namespaces needs root and iproute2")
        fleet = Hosts(lab, "quick", "episodes = 1200")
        happen(fleet, cut=10.0)
        fleet.until(lambda: fleet.state("learner.learner") == "finished", "the end", 3000.0)
        check(finish(fleet))
        rewards = evaluated(fleet, "1000:1010")
    assert rewards["trained"] > 500.0 > max(rewards["static"], rewards["random"])
