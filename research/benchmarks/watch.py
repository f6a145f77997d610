"""What watching costs a worker.

Run `python -m research.benchmarks.watch --write research/results/watch.json`, then `make docs`.

One worker simulates the default farm as fast as it can. Stretches with no watcher, one and four take turns in one run.
The listener and the watchers are a process of their own, as they are in a run. Counted is the worker's whole processor
time for each environment step, which is as noisy as the machine; and, exactly, the part of it that watching takes: the
main thread's time in `ViewService` and the probe, and that of all other threads, Zenoh's.

Where cores share caches or are two halves of one, a step takes longer because the watchers' process works beside it,
whatever that does. As a control, there are stretches in which nobody watches and the other process is kept as busy as
it was with the most watchers.
"""

import json
import selectors
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Any, Final

import psutil
import tyro

from eia_sec.common.actors import TeamActors
from eia_sec.common.config.files import to_toml
from eia_sec.common.config.presets import preset
from eia_sec.common.process import Presence
from eia_sec.common.transport.bus import Bus
from eia_sec.common.transport.endpoint import Endpoint, free_endpoint
from eia_sec.deploy.monitor.web.hub import Hub, Seat
from eia_sec.deploy.monitor.web.source import Source
from eia_sec.deploy.reports.provenance import provenance
from eia_sec.rollout.worker.collector import Collector
from eia_sec.rollout.worker.farm_probe import FarmProbe
from eia_sec.rollout.worker.view_service import ViewService

RUN: Final = "watch"
CHECK_SECONDS: Final = 0.05
CONTROL: Final = -1
"""In the place of a number of watchers: nobody watches, and the other process is busy with nothing."""


@dataclass(frozen=True)
class Arguments:
    """Measure what watching costs a worker."""

    repeats: int = 4
    """Rounds; in each of them every number of watchers has its stretch."""
    seconds: float = 20.0
    """Length of a stretch: in 20 s a worker shows one whole episode, and one more to somebody new."""
    watchers: tuple[int, ...] = (0, 1, 4)
    """Numbers of watchers; the first is what the others are compared with."""
    json: bool = False
    """Print one JSON object."""
    write: Path | None = None
    """File for the same object."""
    other_side: str | None = None
    """Endpoint; be the listener and the watchers (the command starts itself so)."""


@dataclass
class _Tally:
    """The totals of a stretch."""

    steps: int = 0
    processor: float = 0.0
    watching: float = 0.0
    beside: float = 0.0
    frames: int = 0
    wall: float = 0.0
    other: float = 0.0


class _TimedProbe(FarmProbe):
    """A probe that measures the time it takes."""

    seconds = 0.0

    def record(self) -> None:
        """Record, and count the time."""
        started = time.thread_time()
        super().record()
        self.seconds += time.thread_time() - started


def main() -> None:
    """Measure and print."""
    arguments = tyro.cli(Arguments, prog="python -m research.benchmarks.watch")
    if arguments.other_side is not None:
        _watch(Endpoint.parse(arguments.other_side))
        return
    result = measure(arguments)
    text = json.dumps(result, indent=2) + "\n"
    if arguments.write is not None:
        arguments.write.write_text(text, encoding="utf-8")
    if arguments.json:
        sys.stdout.write(text)
        return
    for row in (*result["watchers"], result["control"]):
        who = "nobody, the other process busy" if row["watchers"] == CONTROL else f"{row['watchers']} watchers"
        sys.stdout.write(
            f"{who}: {row['processor_us_per_step']:.2f} us of processor time a step, "
            f"{row['extra_percent']:+.2f} % ({row['extra_percent_least']:+.2f} to {row['extra_percent_most']:+.2f}), "
            f"of which {row['watching_percent']:.3f} % for watching; {row['frames_per_second']:.1f} frames/s\n"
        )


def measure(arguments: Arguments) -> dict[str, Any]:
    """Return costs by number of watchers."""
    endpoint = free_endpoint()
    command = [sys.executable, "-m", "research.benchmarks.watch", "--other-side", str(endpoint)]
    other = subprocess.Popen(command, stdin=subprocess.PIPE, text=True)
    try:
        with Bus.connect(endpoint, "control", wait=60.0) as bus:
            found = _repeats(arguments, bus, other)
    finally:
        other.kill()
        other.wait()
    rows = [_row(number, found[number], found[arguments.watchers[0]]) for number in (*arguments.watchers, CONTROL)]
    made = {"repeats": arguments.repeats, "seconds": arguments.seconds, "watchers": rows[:-1], "control": rows[-1]}
    return {**provenance("research.benchmarks.watch"), **made}


def _repeats(arguments: Arguments, bus: Bus, other: "subprocess.Popen[str]") -> dict[int, list[_Tally]]:
    config = preset("study")
    collector = Collector(config, "w", 1)
    view_service = ViewService(bus, RUN, "w", 1, collector, to_toml(config))
    probe = view_service._probe = _TimedProbe(collector.environments, 0)  # type: ignore[arg-type]  # a worker of farms
    presence = Presence(bus, RUN, "rollout", "w", 1)
    actors = TeamActors.initial(collector.team, config.algorithm.hidden, seed=0)
    cases = (*arguments.watchers, CONTROL)
    found: dict[int, list[_Tally]] = {number: [] for number in cases}
    beside = psutil.Process(other.pid)
    for turn in range(arguments.repeats):
        for number in cases if turn % 2 == 0 else cases[::-1]:
            busy = found[max(cases)][-1].other if number == CONTROL else 0.0
            assert other.stdin is not None
            other.stdin.write(f"{max(0, number)} {busy}\n")
            other.stdin.flush()
            while view_service.watchers != max(0, number):
                _fly(collector, view_service, actors, CHECK_SECONDS, _Tally())
            before = sum(beside.cpu_times()[:2])
            found[number].append(_stretch(collector, view_service, probe, actors, arguments.seconds))
            found[number][-1].other = (sum(beside.cpu_times()[:2]) - before) / found[number][-1].wall
    del presence
    return found


def _stretch(
    collector: Collector, view_service: ViewService, probe: _TimedProbe, actors: TeamActors, seconds: float
) -> _Tally:
    tally = _Tally()
    steps, frames, looked = collector.environment_steps, view_service.shown, probe.seconds
    processor, own, started = time.process_time(), time.thread_time(), time.monotonic()
    _fly(collector, view_service, actors, seconds, tally)
    tally.processor, tally.wall = time.process_time() - processor, time.monotonic() - started
    tally.beside = tally.processor - (time.thread_time() - own)
    tally.steps, tally.frames = collector.environment_steps - steps, view_service.shown - frames
    tally.watching += probe.seconds - looked
    return tally


def _fly(collector: Collector, view_service: ViewService, actors: TeamActors, seconds: float, tally: _Tally) -> None:
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        started = time.thread_time()
        view_service.poll(1, 0.1, False)
        tally.watching += time.thread_time() - started
        collector.collect(actors, 0.1, False)


def _row(number: int, tallies: list[_Tally], base: list[_Tally]) -> dict[str, Any]:
    """Return a number of watchers' costs; extra costs are those of each repeat against the base of the same repeat."""
    extra = [
        100.0 * (own.processor / own.steps / (bare.processor / bare.steps) - 1.0)
        for own, bare in zip(tallies, base, strict=True)
    ]
    processor = sum(tally.processor for tally in tallies)
    steps = sum(tally.steps for tally in tallies)
    main, beside = sum(tally.watching for tally in tallies), sum(tally.beside for tally in tallies)
    return {
        "watchers": number,
        "steps": steps,
        "processor_us_per_step": 1e6 * processor / steps,
        "extra_percent": median(extra),
        "extra_percent_least": min(extra),
        "extra_percent_most": max(extra),
        "main_thread_percent": 100.0 * main / processor,
        "other_threads_percent": 100.0 * beside / processor,
        "watching_percent": 100.0 * (main + beside) / processor,
        "frames_per_second": sum(tally.frames for tally in tallies) / sum(tally.wall for tally in tallies),
        "processor_share": processor / sum(tally.wall for tally in tallies),
        "other_share": median(tally.other for tally in tallies),
    }


def _watch(endpoint: Endpoint) -> None:
    """Listen, and let as many watchers watch as standard input says, until it is closed."""
    with Bus.listen(endpoint, "control") as bus:
        looking: list[tuple[Source, Hub, Seat]] = []
        wanted = _Wanted()
        while True:
            wanted.read()
            while len(looking) > wanted.number:
                looking.pop()[0].leave()
            while len(looking) < wanted.number:
                hub = Hub()
                source = Source(bus, RUN, "w", hub)
                source._name += f"-{len(looking)}"
                seat = hub.enter(1)
                assert seat is not None
                looking.append((source, hub, seat))
            for source, _, seat in looking:
                source.tend(True)
                while seat.take(0.0) is not None:
                    pass
            busy_until = time.monotonic() + wanted.busy * CHECK_SECONDS
            while time.monotonic() < busy_until:
                pass
            time.sleep(CHECK_SECONDS * (1.0 - wanted.busy))


class _Wanted:
    """The last number of watchers, and share of a core to keep busy, that came on standard input."""

    def __init__(self) -> None:
        self.number, self.busy = 0, 0.0
        self._selector = selectors.DefaultSelector()
        self._selector.register(sys.stdin, selectors.EVENT_READ)

    def read(self) -> None:
        """Take what has come; end the process when nothing more will."""
        while self._selector.select(0):
            line = sys.stdin.readline()
            if not line:
                sys.exit(0)
            number, busy = line.split()
            self.number, self.busy = int(number), min(0.95, float(busy))


if __name__ == "__main__":
    main()
