"""What many workers cost a router: joining, metrics, progress and parameters, without any environment.

    python -m research.benchmarks.sessions [--workers 100 300 1000] [--sites 0 2] [--write research/results/sessions]
        [--without progress metrics parameters ...]

One process routes. One stands for the learner: it publishes progress and parameters of the default preset's size at a
run's paces. Ghost workers declare what a worker declares on its two sessions and report once a second, GHOSTS of them
in a process. This process watches, as `eia-sec monitor` does. With sites, processes of ghosts are shared out to routers
that are linked to the first one. All on one machine, so ghosts and routers share its cores.
`--without` leaves kinds of messages out, to see what each costs.
"""

import itertools
import json
import math
import os
import select
import struct
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
import psutil
import tyro

from eia_sec.common.actors import TeamActors
from eia_sec.common.config.presets import preset
from eia_sec.common.errors import EiaSecError
from eia_sec.common.farm import farm_team
from eia_sec.common.process import Presence
from eia_sec.common.protocol import keys
from eia_sec.common.protocol.messages import MetricMessage, ProgressMessage
from eia_sec.common.transport.bus import Bus, Subscription
from eia_sec.common.transport.endpoint import Endpoint, free_endpoint
from eia_sec.deploy.local.threads import thread_environment
from eia_sec.deploy.reports.provenance import provenance
from research.benchmarks.peers.catalogue import ROOT, SOURCES
from research.experiments.reporting import store_results
from research.pages.sessions_table import page

RUN: Final = "ghosts"
GHOSTS: Final = 100
"""Ghost workers in a process."""
PROGRESS_SECONDS: Final = 0.1
REPORT_SECONDS: Final = 1.0
PARAMETER_SECONDS: Final = 2.0
"""Pauses between two messages: of the learner's progress, of a worker's metrics, and between two versions of actors."""
PATIENCE: Final = 300.0
"""Seconds after which not all have joined."""
STEADY_SECONDS: Final = 15.0
"""Time over which costs are measured once all have joined."""
STAMP: Final = struct.Struct("<d")
TIMED: Final = 4
"""Ghosts of a process that look for parameters at every turn; the others look once a second and are not timed."""

Kind = Literal["progress", "metrics", "parameters", "bulk"]


@dataclass(frozen=True)
class Arguments:
    """Measure what many workers cost a router."""

    workers: tuple[int, ...] = (100, 300, 1000)
    """Numbers of ghost workers."""
    sites: tuple[int, ...] = (0,)
    """Numbers of sites with a router of their own, each measured with every number of workers; 0 for none."""
    without: tuple[Kind, ...] = ()
    """What is left out: messages of a kind, or the sessions of the bulk lane."""
    write: Path | None = None
    """Folder for the results, or none."""
    part: Literal["", "learner", "ghosts"] = ""
    """Which process this is; the first one starts the others."""
    endpoint: str = ""
    """Where the router listens, for the other processes."""
    first: int = 0
    """The first ghost's number, for a process of ghosts."""
    count: int = 0
    """How many ghosts it has."""


def main() -> None:
    """Measure each number of workers, or be one of the processes."""
    arguments = tyro.cli(Arguments, prog="python -m research.benchmarks.sessions")
    if arguments.part == "learner":
        _learner(arguments)
    elif arguments.part == "ghosts":
        _ghosts(arguments)
    else:
        results = []
        for workers, sites in itertools.product(arguments.workers, arguments.sites):
            results.append(measured(workers, sites, arguments.without))
            sys.stderr.write(json.dumps(results[-1]) + "\n")
        data = {**provenance("research.benchmarks.sessions"), "cores": os.cpu_count(), "results": results}
        if arguments.write is not None:
            store_results(data, page, arguments.write)
        sys.stdout.write(json.dumps(data) + "\n")


def measured(workers: int, sites: int, without: tuple[str, ...]) -> dict[str, Any]:
    """Return the costs of so many workers, at so many sites or, without any, at the one router.

    Raises:
        EiaSecError: they have not all joined in time.
    """
    endpoint = free_endpoint()
    with ExitStack() as opened:
        router = opened.enter_context(_process("eia_sec.deploy.cli", "router", "--listen", str(endpoint)))
        watcher = opened.enter_context(Bus.connect(endpoint, "control", wait=60.0))
        metrics = watcher.subscribe(keys.METRIC.pattern(RUN), 65_536)
        tokens = watcher.watch(keys.LIVE.pattern(RUN, role="rollout"), 4096)
        places = [free_endpoint() for _ in range(sites)]
        linked = ("--connect", str(endpoint))
        beyond = [
            opened.enter_context(_process("eia_sec.deploy.cli", "router", "--listen", str(place), *linked))
            for place in places
        ]
        common = ("research.benchmarks.sessions", *(("--without", *without) if without else ()))
        learner = opened.enter_context(_process(*common, "--endpoint", str(endpoint), "--part", "learner"))
        used = _seconds(router)
        ghosts = [
            opened.enter_context(
                _process(
                    *(*common, "--endpoint", str(places[number % sites] if sites else endpoint), "--part", "ghosts"),
                    *("--first", str(first), "--count", str(min(GHOSTS, workers - first))),
                )
            )
            for number, first in enumerate(range(0, workers, GHOSTS))
        ]
        joining, router_joining = _joined(tokens, workers), _seconds(router) - used
        time.sleep(2.0)
        for _ in metrics.drain():
            pass
        before = [_seconds(one) for one in (router, learner, *beyond)]
        began = time.monotonic()
        time.sleep(STEADY_SECONDS)
        seconds = time.monotonic() - began
        heard, lost = _heard(metrics)
        every = zip((router, learner, *beyond), before, strict=True)
        used_by = [(_seconds(one) - then) / seconds for one, then in every]
        process = psutil.Process(router.pid)
        descriptors, memory = process.num_fds(), process.memory_info().rss
        delays = np.concatenate([_delays(ghost) for ghost in ghosts])
    known = delays if len(delays) else np.array([math.nan])
    return {
        "workers": workers,
        "sites": sites,
        "without": list(without),
        "join_seconds": round(joining, 2),
        "router_join_cpu_seconds": round(router_joining, 2),
        "router_cores": round(used_by[0], 3),
        "learner_cores": round(used_by[1], 3),
        "site_cores": [round(cores, 3) for cores in used_by[2:]],
        "metrics_rate": round(heard / (workers * seconds / REPORT_SECONDS), 3),
        "metrics_lost": round(lost / max(1, heard + lost), 3),
        "router_descriptors": descriptors,
        "router_megabytes": round(memory / 1e6),
        "parameters_seconds": {
            "median": round(float(np.median(known)), 4),
            "p99": round(float(np.quantile(known, 0.99)), 4),
        },
    }


def _joined(tokens: Subscription, workers: int) -> float:
    """Wait until so many ghosts are there; return the seconds from the first to the last."""
    alive: set[str] = set()
    end, first = time.monotonic() + PATIENCE, math.inf
    while len(alive) < workers:
        for sample in tokens.drain():
            (alive.add if sample.present else alive.discard)(sample.key)
            first = min(first, time.monotonic())
        if time.monotonic() > end:
            raise EiaSecError(f"{len(alive)} of {workers} ghost workers have joined in {PATIENCE:.0f} s.")
        time.sleep(0.02)
    return time.monotonic() - first


def _heard(metrics: Subscription) -> tuple[int, int]:
    """Return how many reports have come, and how many are missing by the gaps in their numbers."""
    counters: dict[str, list[int]] = {}
    for sample in metrics.drain():
        counters.setdefault(sample.key, []).append(MetricMessage.decode(sample.payload).counter)
    heard = sum(map(len, counters.values()))
    return heard, sum(max(found) - min(found) + 1 for found in counters.values()) - heard


@contextmanager
def _process(module: str, *arguments: str) -> "Iterator[subprocess.Popen[str]]":
    """Start a module as a process of one thread; end it at the end."""
    environment = {**os.environ, **thread_environment(1), "PYTHONPATH": SOURCES}
    with subprocess.Popen(
        [sys.executable, "-m", module, *arguments],
        cwd=ROOT,
        env=environment,
        text=True,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
    ) as process:
        try:
            yield process
        finally:
            process.kill()


def _seconds(process: "subprocess.Popen[str]") -> float:
    times = psutil.Process(process.pid).cpu_times()
    return float(times.user + times.system)


def _delays(ghosts: "subprocess.Popen[str]") -> np.ndarray[Any, np.dtype[np.float64]]:
    """Tell a process of ghosts to end; return the delays of the parameters that its ghosts have received, s."""
    assert ghosts.stdin is not None
    assert ghosts.stdout is not None
    ghosts.stdin.close()
    return np.array(json.loads(ghosts.stdout.readline()), np.float64)


def _learner(arguments: Arguments) -> None:
    """Publish what a learner publishes, until this process is killed."""
    config = preset("inertial")
    actors = TeamActors.initial(farm_team(config.farm), config.algorithm.hidden, 0, head="gaussian")
    parameters = bytes(sum(weights.nbytes for weights in actors.flat))
    with Bus.connect(Endpoint.parse(arguments.endpoint), "control", wait=60.0) as bus:
        presence = Presence(bus, RUN, "learner", "learner", 1)
        progress = bus.publish_state(keys.PROGRESS.key(RUN))
        published = bus.publish_state(keys.PARAMETERS.key(RUN))
        served = bus.serve(keys.TRANSITION.pattern(RUN), 64)
        turn = 0
        while True:
            if "progress" not in arguments.without:
                progress.put(ProgressMessage(1, turn, 0, 0, 0, 0, "training").encode())
            if turn % round(PARAMETER_SECONDS / PROGRESS_SECONDS) == 0 and "parameters" not in arguments.without:
                published.put(STAMP.pack(time.time()) + parameters)
            if turn % round(REPORT_SECONDS / PROGRESS_SECONDS) == 0:
                presence.report({})
            served.poll()
            turn += 1
            time.sleep(PROGRESS_SECONDS)


@dataclass
class _Ghost:
    """What a worker declares, and what it has heard."""

    presence: Presence
    states: tuple[Subscription, ...]
    kept: tuple[object, ...]


def _ghosts(arguments: Arguments) -> None:
    """Stand for so many workers, until standard input closes; then print the parameters' delays."""
    endpoint, delays = Endpoint.parse(arguments.endpoint), []
    with ExitStack() as opened:
        ghosts = [
            _ghost(opened, endpoint, str(arguments.first + index), bulk="bulk" not in arguments.without)
            for index in range(arguments.count)
        ]
        turn, due = 0, time.monotonic()
        while not select.select([sys.stdin], [], [], max(0.0, due - time.monotonic()))[0]:
            ghost = ghosts[turn % len(ghosts)]
            if "metrics" not in arguments.without:
                ghost.presence.report({"environment_steps": 0, "alarms": []})
            for state in ghost.states[1:]:
                state.poll()
            for place, one in enumerate(ghosts):
                if (place < TIMED or one is ghost) and (sample := one.states[0].poll()) is not None and place < TIMED:
                    delays.append(time.time() - STAMP.unpack_from(sample.payload)[0])
            turn += 1
            due += REPORT_SECONDS / len(ghosts)
        sys.stdout.write(json.dumps(delays) + "\n")
        sys.stdout.flush()


def _ghost(opened: ExitStack, endpoint: Endpoint, name: str, *, bulk: bool) -> _Ghost:
    control = opened.enter_context(Bus.connect(endpoint, "control", wait=PATIENCE))
    kept: list[object] = [opened.enter_context(Bus.connect(endpoint, "bulk", wait=PATIENCE))] if bulk else []
    presence = Presence(control, RUN, "rollout", name, 1)
    families = (keys.PARAMETERS, keys.IMITATION_EVENT, keys.PROGRESS)
    states = tuple(control.subscribe_state(family.key(RUN)) for family in families)
    kept += [control.serve(family.key(RUN, worker=name), 16, newest=True) for family in (keys.EVALUATION, keys.WATCH)]
    return _Ghost(presence, states, tuple(kept))


if __name__ == "__main__":
    main()
