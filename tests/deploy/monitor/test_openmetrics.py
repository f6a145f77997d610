"""Figures as OpenMetrics: what a scrape reads is what the live view shows."""

import dataclasses
import socket
import sys
import urllib.error
import urllib.request

import pytest
from prometheus_client.openmetrics.exposition import generate_latest
from prometheus_client.openmetrics.parser import text_string_to_metric_families
from prometheus_client.registry import CollectorRegistry

from eia_sec.common.errors import EndpointError, UsageError
from eia_sec.deploy.commands.monitoring import monitor
from eia_sec.deploy.monitor.openmetrics import MOST_REQUESTS, STATES, OpenMetricsServer, RunCollector
from eia_sec.deploy.monitor.snapshot import Membership, RoundRow, Series, Snapshot
from tests.deploy.monitor.test_live_view import SNAPSHOT, worker
from tests.system.fleet import until


def scraped(text: str) -> dict[tuple[str, ...], float]:
    """Return each sample by its name and its labels' values, in the order of their names, without the run."""
    found = {}
    for family in text_string_to_metric_families(text):
        assert family.documentation, family.name
        assert family.name.startswith("eia_sec_")
        assert not family.unit or family.name.endswith(f"_{family.unit}")
        for sample in family.samples:
            labels = dict(sample.labels)
            assert labels.pop("run") == "farm-7"
            found[sample.name, *(labels[name] for name in sorted(labels))] = sample.value
    return found


def text_of(snapshot: Snapshot) -> str:
    collector, registry = RunCollector(snapshot.run), CollectorRegistry()
    collector.show(snapshot)
    registry.register(collector)
    return generate_latest(registry).decode()


def test_every_figure_of_a_snapshot_is_a_sample():
    """The parser of prometheus_client reads them, with units, and each has the snapshot's value."""
    found = scraped(text_of(SNAPSHOT))
    assert {state: found["eia_sec_run_state", state] for state in STATES} == {s: float(s == "training") for s in STATES}
    for name, value in (
        ("run_elapsed_seconds", 1512.0),
        ("run_remaining_seconds", 2133.0),
        ("run_progress_ratio", 812 / 2000),
        ("episodes", 812),
        ("updates", 203_000),
        ("alarms", 1),
        ("produced_steps", 406_480),
        ("accepted_steps", 406_000),
        ("rejected_steps", 120),
        ("lost_steps", 140),
        ("in_flight_steps", 220),
        ("unexplained_steps", 0),
        ("duplicate_chunks", 3),
        ("imitation_events", 6),
        ("imitation_rate_ratio", 0.003125),
        ("lag_versions", 1.7),
        ("learner_wait_ratio", 0.02),
        ("worker_wait_ratio", 0.41),
        ("environment_outages", 0),
        ("step_timeouts", 0),
    ):
        assert found[f"eia_sec_{name}",] == value, name
    assert found["eia_sec_reward", "monitoring"] == 1250.0
    assert found["eia_sec_reward", "mean"] == pytest.approx(420.5)
    assert found["eia_sec_episode_metric", "AoI"] == 1.234
    assert found["eia_sec_elite_score", "2", "c"] == 0.8125
    assert ("eia_sec_elite_score", "0", "m") not in found
    assert found["eia_sec_process_rate", "barn", "worker-1", "rollout"] == 600.4
    assert found["eia_sec_process_up", "barn", "learner", "learner"] == 1.0
    assert found["eia_sec_process_silence_seconds", "barn", "worker-0", "rollout"] == 0.2


def test_a_member_of_a_population_has_a_round_a_rank_and_hyperparameters():
    """Of a run alone there are none."""
    rows = (RoundRow(3, 0.5, 2, 4, 0.0),)
    member = Membership(3, (("actor_rate", 0.002),), rows)
    found = scraped(text_of(dataclasses.replace(SNAPSHOT, population=member)))
    assert found["eia_sec_population_round",] == 3
    assert found["eia_sec_population_rank",] == 2
    assert found["eia_sec_hyperparameter", "actor_rate"] == 0.002
    assert not [name for name, *_ in scraped(text_of(SNAPSHOT)) if "population" in name or "hyper" in name]


def test_no_field_of_a_snapshot_is_forgotten():
    """A changed field changes the text, but for those that say the same in another way."""
    said = {
        "run",
        "processes",
        "reward",
        "noise_free",
        "freshness",
        "ledger",
        "imitation",
        "population",
        "alarms",
        "state",
    }
    same = {"episodes_total", "steps_total", "steps", "steps_rate", "updates_rate", "others"}
    for field in dataclasses.fields(Snapshot):
        if field.name not in said | same:
            value = 1 + (getattr(SNAPSHOT, field.name) or 0)
            assert text_of(dataclasses.replace(SNAPSHOT, **{field.name: value})) != text_of(SNAPSHOT), field.name


def test_the_reward_without_noise_is_a_sample_once_it_is_known():
    """The newest evaluation's, not a mean over them."""
    seen = dataclasses.replace(SNAPSHOT, noise_free=Series("without noise", (700.0, 815.0), smoothing=1))
    assert scraped(text_of(seen))[("eia_sec_reward_without_noise",)] == 815.0
    assert ("eia_sec_reward_without_noise",) not in scraped(text_of(SNAPSHOT))


def test_what_is_not_known_has_no_sample():
    """Before the learner's first report nothing is counted, so that no count seems to rise with it."""
    found = scraped(text_of(Snapshot("farm-7", processes=(worker(0), worker(1, left=True)))))
    assert found["eia_sec_run_state", "starting"] == 1.0
    assert {name for name, *_ in found if not name.startswith("eia_sec_process")} == {
        "eia_sec_run_state",
        "eia_sec_alarms",
    }
    assert {labels[1] for name, *labels in found if name == "eia_sec_process_up"} == {"worker-0"}


def test_odd_names_stay_labels():
    """A host's or a metric's name may hold anything."""
    odd = dataclasses.replace(SNAPSHOT, processes=(worker(0, host='a"b\n\\c'),))
    assert scraped(text_of(odd))["eia_sec_process_up", 'a"b\n\\c', "worker-0", "rollout"] == 1.0


def test_the_newest_snapshot_is_served_and_the_port_is_free_afterwards():
    """Each scrape reads the newest; a port that is taken is a sentence."""
    collector = RunCollector("farm-7")
    with OpenMetricsServer(collector, "127.0.0.1", 0) as server:
        address = f"http://127.0.0.1:{server.port}/metrics"
        asked = urllib.request.Request(address, headers={"Accept": "application/openmetrics-text; version=1.0.0"})
        for snapshot in (SNAPSHOT, dataclasses.replace(SNAPSHOT, episodes=900)):
            collector.show(snapshot)
            with urllib.request.urlopen(asked, timeout=30) as answer:
                assert answer.headers["Content-Type"].startswith("application/openmetrics-text")
                assert scraped(answer.read().decode())["eia_sec_episodes",] == snapshot.episodes
        with pytest.raises(EndpointError, match=f"cannot serve on 127.0.0.1, port {server.port}: "):
            OpenMetricsServer(collector, "127.0.0.1", server.port)
        taken = server.port
    with OpenMetricsServer(collector, "127.0.0.1", taken) as again:
        assert again.port == taken


def test_other_names_other_paths_and_too_many_are_refused():
    """A page of another site, a wrong path, connections that ask for nothing; the next scrape is answered."""
    with OpenMetricsServer(RunCollector("farm-7"), "127.0.0.1", 0) as server:
        address = f"http://127.0.0.1:{server.port}/metrics"
        for asked, code in (
            (urllib.request.Request(address, headers={"Host": "evil.example:80"}), 421),
            (urllib.request.Request(address.removesuffix("metrics")), 404),
        ):
            with pytest.raises(urllib.error.HTTPError) as refused:
                urllib.request.urlopen(asked, timeout=30)
            assert refused.value.code == code
        idle = [socket.create_connection(("127.0.0.1", server.port)) for _ in range(MOST_REQUESTS)]
        closed = socket.create_connection(("127.0.0.1", server.port))
        closed.settimeout(30.0)
        assert closed.recv(1) == b""
        for connection in (*idle, closed):
            connection.close()
        until(lambda: _answers(address), "a seat")


def _answers(address):
    try:
        with urllib.request.urlopen(address, timeout=30) as answer:
            return answer.status == 200
    except OSError:
        return False


def test_mistakes_are_one_sentence(monkeypatch):
    """An address that others reach needs consent; without the extra the command names it."""
    options = monitor.MonitorArguments(openmetrics=0, host="0.0.0.0")
    with pytest.raises(EndpointError, match=r"anybody who reaches 0.0.0.0 could read the figures; add --insecure"):
        monitor._served(options, "farm").__enter__()
    monkeypatch.setitem(sys.modules, "eia_sec.deploy.monitor.openmetrics", None)
    with pytest.raises(UsageError, match=r"pip install 'eia-sec\[openmetrics\]'"):
        monitor._served(monitor.MonitorArguments(openmetrics=0), "farm").__enter__()


def test_where_the_figures_are_is_said_on_standard_error(capsys):
    """So `--json` stays JSON."""
    with monitor._served(monitor.MonitorArguments(openmetrics=0), "farm-7") as show:
        show(SNAPSHOT)
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.startswith("OpenMetrics at http://127.0.0.1:")
