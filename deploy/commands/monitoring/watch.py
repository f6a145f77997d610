"""`eia-sec watch`: one worker's first environment, or a flight, live in the browser."""

import logging
import sys
import time
import webbrowser
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Final

import tyro

from eia_sec.common.config.checks import within
from eia_sec.common.errors import EiaSecError
from eia_sec.common.names import check_name
from eia_sec.common.process import StopSignal
from eia_sec.deploy.exit_codes import DONE
from eia_sec.deploy.local.local_runs import RUN, chosen, reached
from eia_sec.deploy.monitor.web.address import bracketed, require_own_address
from eia_sec.deploy.monitor.web.hub import Hub
from eia_sec.deploy.monitor.web.server import WebServer
from eia_sec.deploy.monitor.web.source import Source
from eia_sec.deploy.options import parse

TICK_SECONDS: Final = 0.04
AWAY_SECONDS: Final = 10.0
"""Time without the run after which the terminal says so: routers and learners are restarted."""


@dataclass(frozen=True)
class WatchArguments:
    """Watch a worker's environment or a flight in the browser; it is published only while a page is open."""

    run_dir: Annotated[tyro.conf.Positional[Path | None], tyro.conf.arg(metavar="[RUN_DIR]")] = None
    """Directory of a run of this machine. Default: the run that trains here."""
    run: str | None = None
    """Name of the run. Default: that of the run of this machine, else farm."""
    connect: str | None = None
    """Endpoint where the learner or a router listens. Default: that of the run of this machine, else
    tcp/127.0.0.1:7447."""
    worker: str | None = None
    """Name of the worker or flight node. Default: the first one that is alive."""
    host: str = "127.0.0.1"
    """Address to serve the page on."""
    port: int = 8347
    """Port to serve the page on; 0 for any free one."""
    insecure: bool = False
    """Serve the page on an address that other machines reach; anybody there can watch."""
    open: bool = False
    """Open the page in this machine's browser."""
    tls: Path | None = None
    """Folder with a watcher's certificate (`eia-sec keys issue watcher NAME`); turns TLS on."""
    patience: float = 10.0
    """Seconds to wait for a listener at the endpoint."""


def command(arguments: Sequence[str]) -> int:
    """Serve the page until interrupted; return 0."""
    options = parse(WatchArguments, arguments, "watch")
    check_name(options.run or RUN, "run")
    if options.worker is not None:
        check_name(options.worker, "worker")
    within(0, 65_535, port=options.port)
    within(0.0, 1e9, patience=options.patience)
    require_own_address(options.host, insecure=options.insecure, what="watch the page")
    logging.getLogger("websockets").setLevel(logging.CRITICAL)  # browsers that disconnect are not worth a log line
    stop = StopSignal()
    stop.install()
    run, hub = chosen(options.run_dir, options.run, options.connect, options.patience, lambda: not stop), Hub()
    with (
        reached(run, options.tls, options.patience, lambda: not stop) as bus,
        WebServer(hub, options.host, options.port, strangers=options.insecure) as server,
    ):
        address = f"http://{bracketed(options.host)}:{server.port}/"
        sys.stdout.write(f"watch at {address}\n")
        sys.stdout.flush()
        if options.open:
            webbrowser.open(address)
        _serve(Source(bus, run.run, options.worker, hub), hub, server, stop)
    return DONE


def _serve(source: Source, hub: Hub, server: WebServer, stop: StopSignal) -> None:
    there, said = time.monotonic(), False
    while not stop.event.wait(TICK_SECONDS):
        if not source.ended:
            there, said = time.monotonic(), False
        elif not said and time.monotonic() - there > AWAY_SECONDS:
            said = True
            sys.stdout.write("nothing of the run is there any more; the page keeps what it has. Ctrl-C ends this.\n")
            sys.stdout.flush()
        if server.failed:
            raise EiaSecError("the web server has ended: too many files are open. Start eia-sec watch again.")
        source.tend(hub.seats > 0)
    source.leave()
