"""A run's figures as OpenMetrics, for Prometheus and everything that reads its format.

All counts are gauges: a learner that resumes goes back to those of its checkpoint, and a counter that falls would be
read as one that began again at 0.
"""

import socket
import threading
from collections.abc import Iterable, Iterator
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from types import TracebackType
from typing import Any, Final, Self

from prometheus_client import CollectorRegistry
from prometheus_client.core import GaugeMetricFamily, Metric, StateSetMetricFamily
from prometheus_client.exposition import choose_encoder
from prometheus_client.registry import Collector

from eia_sec.common.errors import EndpointError
from eia_sec.deploy.monitor.snapshot import ProcessRow, Snapshot
from eia_sec.deploy.monitor.web.address import own_hosts

STATES: Final = ("starting", "training", "draining", "finished", "without learner")
"""States of a run that a scrape distinguishes; any other is "starting"."""
PREFIX: Final = "eia_sec_"
MOST_REQUESTS: Final = 16
REQUEST_SECONDS: Final = 5.0
"""Time that a client has to ask, and to take its answer."""


class RunCollector(Collector):
    """Turns the newest snapshot into metric families at each scrape."""

    def __init__(self, run: str) -> None:
        self._newest = Snapshot(run)

    def show(self, snapshot: Snapshot) -> None:
        """Take the snapshot that scrapes return from now on."""
        self._newest = snapshot

    def collect(self) -> Iterable[Metric]:
        """Return all families; of the run and what it learns there are none while no report of a learner is known."""
        snapshot = self._newest
        yield from _of_monitor(snapshot)
        yield from _of_processes(snapshot)
        if any(row.role == "learner" and row.pid for row in snapshot.processes):
            yield from _of_run(snapshot)
            yield from _of_ledger(snapshot)
            yield from _of_learning(snapshot)


class OpenMetricsServer:
    """Serves a collector's figures over HTTP, as long as the block lasts.

    Args:
        collector: what is served.
        host: address to serve on.
        port: port to serve on; 0 for any free one.
        strangers: whether requests with other Host names than this machine's loopback are answered.

    Attributes:
        port: the port.

    Raises:
        EndpointError: the address cannot be used.
    """

    def __init__(self, collector: RunCollector, host: str, port: int, *, strangers: bool = False) -> None:
        registry = CollectorRegistry(auto_describe=False)
        registry.register(collector)
        address = host.strip("[]")
        try:
            self._server = _Server(
                socket.AF_INET6 if ":" in address else socket.AF_INET, (address, port), _handler(registry, strangers)
            )
        except OSError as error:
            raise EndpointError(f"cannot serve on {host}, port {port}: {error.strerror}.") from None
        self.port = int(self._server.server_port)
        self._thread = threading.Thread(target=self._server.serve_forever, name="openmetrics", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()


class _Server(ThreadingHTTPServer):
    """Answers so many requests at a time; further ones are closed at once, and who hangs up is no news."""

    def __init__(
        self, family: socket.AddressFamily, address: tuple[str, int], handler: type[BaseHTTPRequestHandler]
    ) -> None:
        self.address_family = family
        self._seats = threading.BoundedSemaphore(MOST_REQUESTS)
        super().__init__(address, handler)
        self.own = own_hosts(address[0], self.server_port)

    def process_request(self, request: Any, client_address: Any) -> None:
        if self._seats.acquire(blocking=False):
            super().process_request(request, client_address)
        else:
            self.shutdown_request(request)

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        try:
            super().process_request_thread(request, client_address)
        finally:
            self._seats.release()

    def handle_error(self, request: Any, client_address: Any) -> None:
        return


def _handler(registry: CollectorRegistry, strangers: bool) -> type[BaseHTTPRequestHandler]:
    """Return what answers GET /metrics, to requests for this machine's own names unless strangers are welcome."""

    class Handler(BaseHTTPRequestHandler):
        timeout = REQUEST_SECONDS

        def do_GET(self) -> None:
            assert isinstance(self.server, _Server)
            if not (strangers or self.headers.get("Host") in self.server.own):
                self.send_error(HTTPStatus.MISDIRECTED_REQUEST)
            elif self.path.partition("?")[0] != "/metrics":
                self.send_error(HTTPStatus.NOT_FOUND)
            else:
                encode, content = choose_encoder(self.headers.get("Accept") or "")
                body = encode(registry)
                self.send_response(HTTPStatus.OK)
                self.send_header("Content-Type", content)
                self.send_header("Content-Length", str(len(body)))
                self.end_headers()
                self.wfile.write(body)

        def log_message(self, format: str, *args: Any) -> None:
            return

    return Handler


def _gauge(name: str, meaning: str, unit: str, labels: tuple[str, ...]) -> GaugeMetricFamily:
    return GaugeMetricFamily(PREFIX + name, meaning, labels=labels, unit=unit)


def _single(snapshot: Snapshot, name: str, unit: str, meaning: str, value: float | None) -> Metric:
    """Return a family of one sample, labelled by the run; of none where the value is not known."""
    family = _gauge(name, meaning, unit, ("run",))
    if value is not None:
        family.add_metric([snapshot.run], value)
    return family


def _of_monitor(snapshot: Snapshot) -> Iterator[Metric]:
    states = StateSetMetricFamily(PREFIX + "run_state", "What the run does.", labels=["run"])
    state = snapshot.state if snapshot.state in STATES else STATES[0]
    states.add_metric([snapshot.run], {name: name == state for name in STATES})
    yield states
    yield _single(snapshot, "alarms", "", "Alarms that a monitor shows now.", len(snapshot.alarms))


def _of_run(snapshot: Snapshot) -> Iterator[Metric]:
    for name, unit, meaning, value in (
        ("run_elapsed_seconds", "seconds", "Time since the run's start.", snapshot.elapsed),
        ("run_remaining_seconds", "seconds", "Estimated time to the run's end.", snapshot.left),
        ("run_progress_ratio", "ratio", "Finished share of the run.", snapshot.progress),
        ("episodes", "", "Training episodes finished.", snapshot.episodes),
        ("updates", "", "Updates of the networks.", snapshot.updates),
        ("environment_outages", "", "Times that environments went away.", snapshot.outages),
        ("step_timeouts", "", "Workers ended for env.step_timeout.", snapshot.step_timeouts),
    ):
        yield _single(snapshot, name, unit, meaning, value)


def _of_ledger(snapshot: Snapshot) -> Iterator[Metric]:
    ledger = snapshot.ledger
    for name, meaning, value in (
        ("produced_steps", "Environment steps that workers simulated.", ledger.produced),
        ("accepted_steps", "Environment steps that the learner accepted.", ledger.accepted),
        ("rejected_steps", "Environment steps in chunks that it refused.", ledger.rejected),
        ("lost_steps", "Environment steps declared lost.", ledger.lost),
        ("in_flight_steps", "Environment steps neither arrived nor given up.", ledger.in_flight),
        ("unexplained_steps", "Environment steps that no count explains; 0 but for a defect.", ledger.unexplained),
    ):
        yield _single(snapshot, name, "steps", meaning, value)
    yield _single(snapshot, "duplicate_chunks", "chunks", "Chunks that arrived again, taken once.", ledger.duplicates)


def _of_learning(snapshot: Snapshot) -> Iterator[Metric]:
    for name, meaning, label, series in (
        ("reward", "Mean reward per agent in the newest training episodes.", "type", snapshot.reward),
        ("episode_metric", "The environment's own metrics in the newest episodes.", "metric", snapshot.freshness),
    ):
        family = _gauge(name, meaning, "", ("run", label))
        for one in series:
            if one.latest is not None:
                family.add_metric([snapshot.run, one.name], one.latest)
        yield family
    scores = _gauge("elite_score", "Score omega of each type's elite.", "", ("run", "type", "agent"))
    for name, agent, score in snapshot.imitation.elites:
        if score is not None:
            scores.add_metric([snapshot.run, name, str(agent)], score)
    yield scores
    member = snapshot.population
    values = _gauge("hyperparameter", "With which a member of a population learns.", "", ("run", "name"))
    for option, held in member.hyperparameters if member else ():
        values.add_metric([snapshot.run, option], held)
    yield values
    newest = member.newest[-1] if member and member.newest else None
    for name, unit, meaning, value in (
        ("reward_without_noise", "", "Mean reward per agent in a small evaluation.", snapshot.noise_free.latest),
        (
            "population_round",
            "",
            "Newest round of the population that it took part in.",
            member.round if member else None,
        ),
        ("population_rank", "", "Its rank in that round, 1 for the best.", newest.rank if newest else None),
        ("imitation_events", "", "Imitation events applied.", snapshot.imitation.events),
        ("imitation_rate_ratio", "ratio", "Rate vartheta of the next event.", snapshot.imitation.rate),
        ("lag_versions", "versions", "Age of the newest chunks' policies.", snapshot.staleness),
        ("learner_wait_ratio", "ratio", "Share of its time that the learner waits.", snapshot.learner_wait),
        ("worker_wait_ratio", "ratio", "Mean share that workers wait.", snapshot.worker_wait),
    ):
        yield _single(snapshot, name, unit, meaning, value)


def _of_processes(snapshot: Snapshot) -> Iterator[Metric]:
    labels = ("run", "role", "name", "host")
    for name, unit, meaning in (
        ("process_up", "", "Whether the process has a liveliness token."),
        ("process_trouble", "", "Whether it is gone, silent, far behind or slow."),
        ("process_uptime_seconds", "seconds", "Time since its start."),
        ("process_silence_seconds", "seconds", "Time since its last message."),
        ("process_rate", "", "Steps (rollout), updates (learner) or decisions (flight) a second."),
        ("process_queue_chunks", "chunks", "Chunks that wait in its queue."),
        ("process_behind_versions", "versions", "Parameter versions that it lags behind the learner."),
    ):
        family = _gauge(name, meaning, unit, labels)
        for row in snapshot.processes:
            value = _value(row, name)
            if value is not None and not row.left:
                family.add_metric([snapshot.run, row.role, row.name, row.host], value)
        yield family


def _value(row: ProcessRow, name: str) -> float | None:
    """Return one figure of a process; a process without a number has sent no message yet."""
    return {
        "process_up": float(row.alive),
        "process_trouble": float(row.trouble),
        "process_uptime_seconds": row.uptime if row.pid else None,
        "process_silence_seconds": row.age if row.pid else None,
        "process_rate": row.rate,
        "process_queue_chunks": row.queue,
        "process_behind_versions": row.behind,
    }[name]
