"""`eia-sec monitor`: a plain Zenoh subscriber that shows a run live and publishes nothing."""

import json
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console
from rich.live import Live

from eia_sec.common.config.checks import within
from eia_sec.common.errors import UsageError
from eia_sec.common.names import check_name
from eia_sec.common.process import StopSignal, denial
from eia_sec.common.protocol import keys
from eia_sec.common.transport.bus import Bus
from eia_sec.deploy.local.local_runs import RUN, chosen, reached
from eia_sec.deploy.monitor.live_view import render, summary
from eia_sec.deploy.monitor.new_alarms import NewAlarms
from eia_sec.deploy.monitor.run_monitor import RunMonitor
from eia_sec.deploy.monitor.snapshot import Snapshot, record
from eia_sec.deploy.monitor.web.address import bracketed, require_own_address
from eia_sec.deploy.options import parse


@dataclass(frozen=True)
class MonitorArguments:
    """Watch a run live; the monitor only subscribes."""

    run_dir: Annotated[tyro.conf.Positional[Path | None], tyro.conf.arg(metavar="[RUN_DIR]")] = None
    """Directory of a run of this machine. Default: the run that trains here."""
    run: str | None = None
    """Name of the run. Default: that of the run of this machine, else farm."""
    connect: str | None = None
    """Endpoint where the learner or a router listens. Default: that of the run of this machine, else
    tcp/127.0.0.1:7447."""
    tls: Path | None = None
    """Folder with a monitor's certificate (`eia-sec keys issue monitor NAME`); turns TLS on."""
    patience: float = 10.0
    """Seconds to wait for a listener at the endpoint."""
    json: bool = False
    """Print one JSON object per refresh instead of the live view."""
    refresh: float = 1.0
    """Seconds between two refreshes."""
    seconds: float | None = None
    """Seconds until it stops. Default: run until interrupted."""
    openmetrics: int | None = None
    """Port on which the figures are also served as OpenMetrics, for Prometheus; 0 for any free one."""
    host: str = "127.0.0.1"
    """Address to serve them on."""
    insecure: bool = False
    """Serve them on an address that other machines reach; anybody there can read them."""


def command(arguments: Sequence[str]) -> int:
    """Watch until interrupted or the time is up; return 0."""
    options = parse(MonitorArguments, arguments, "monitor")
    check_name(options.run or RUN, "run")
    within(0.05, 3600.0, refresh=options.refresh)
    within(0, 65_535, openmetrics=options.openmetrics or 0)
    within(0.0, 1e9, patience=options.patience, seconds=0.0 if options.seconds is None else options.seconds)
    stop = StopSignal()
    stop.install()
    run = chosen(options.run_dir, options.run, options.connect, options.patience, lambda: not stop)
    with reached(run, options.tls, options.patience, lambda: not stop) as bus, _served(options, run.run) as served:
        _show(options, run.run, stop, bus, served)
    return 0


@contextmanager
def _served(options: MonitorArguments, run: str) -> Iterator[Callable[[Snapshot], None]]:
    """Yield what takes each snapshot for OpenMetrics; nothing is served where the option is not given.

    Raises:
        EndpointError: other machines reach the address, or it cannot be used.
        UsageError: the package that serves it is not installed.
    """
    if options.openmetrics is None:
        yield lambda snapshot: None
        return
    require_own_address(options.host, insecure=options.insecure, what="read the figures")
    try:
        from eia_sec.deploy.monitor.openmetrics import OpenMetricsServer, RunCollector  # noqa: PLC0415  (an extra)
    except ImportError:
        raise UsageError("--openmetrics needs prometheus-client: pip install 'eia-sec[openmetrics]'.") from None
    collector = RunCollector(run)
    with OpenMetricsServer(collector, options.host, options.openmetrics, strangers=options.insecure) as server:
        sys.stderr.write(f"OpenMetrics at http://{bracketed(options.host)}:{server.port}/metrics\n")
        yield collector.show


def _show(options: MonitorArguments, run: str, stop: StopSignal, bus: Bus, served: Callable[[Snapshot], None]) -> None:
    monitor, console, alarms = RunMonitor(bus, run), Console(), NewAlarms()
    deadline = time.monotonic() + (options.seconds if options.seconds is not None else float("inf"))
    plain = options.json or not console.is_terminal
    live = None if plain else Live(console=console, auto_refresh=False, screen=True)
    if live is not None:
        live.start()
    try:
        while not stop and time.monotonic() < deadline:
            stop.event.wait(options.refresh)
            monitor.update()
            silent = bus.credentials is not None and not monitor.learner_values()
            denied = denial(bus, run, keys.METRIC.pattern(run)) if silent else None
            snapshot = monitor.snapshot((denied,) if denied else ())
            served(snapshot)
            if live is not None:
                live.update(render(snapshot, console.height), refresh=True)
            elif options.json:
                sys.stdout.write(json.dumps(record(snapshot), allow_nan=False) + "\n")
                sys.stdout.flush()
            else:
                for line in (*alarms.of(snapshot), summary(snapshot)):
                    console.print(line, highlight=False, markup=False, soft_wrap=True)
    finally:
        if live is not None:
            live.stop()
            console.print(live.renderable)  # the screen goes with the view; what it showed last stays
