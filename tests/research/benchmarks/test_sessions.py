"""What many workers cost a router."""

import pytest

from research.benchmarks.sessions import measured
from research.pages.sessions_table import page


@pytest.mark.timeout(300)
@pytest.mark.parametrize("sites", [0, 1])
def test_ghost_workers_join_report_and_receive(monkeypatch, sites):
    """All join, the watcher hears their reports, and parameters reach them, also over a site's router."""
    monkeypatch.setattr("research.benchmarks.sessions.STEADY_SECONDS", 5.0)
    found = measured(3, sites, ())
    assert len(found["site_cores"]) == sites
    assert found["join_seconds"] < 60.0
    assert 0.5 < found["metrics_rate"] < 2.0
    assert found["metrics_lost"] == 0.0
    assert 0.0 < found["parameters_seconds"]["median"] < 5.0
    assert (found["router_descriptors"] > 2 * 3) or sites


def test_what_was_left_out_is_in_no_table():
    """The table has whole measurements; a part's cost is for whoever looks at the file."""
    whole = {
        "workers": 1000,
        "sites": 2,
        "without": [],
        "join_seconds": 12.34,
        "router_join_cpu_seconds": 9.0,
        "router_cores": 0.5,
        "site_cores": [0.25, 0.75],
        "metrics_rate": 1.0,
        "metrics_lost": 0.125,
        "router_descriptors": 2022,
        "router_megabytes": 300,
        "parameters_seconds": {"median": 0.1, "p99": 0.25},
    }
    data = {"command": "python -m x", "commit": "abc", "cores": 2, "results": [whole, {**whole, "without": ["bulk"]}]}
    text = page(data)
    assert text.count("| 1,000 | 2 | 12.3 | 9.0 | 0.50 | 0.75 | 1.00 | 12.5% | 2,022 | 300 | 100, 250 |") == 1
    assert "`python -m x`, commit abc, 2 cores" in text
