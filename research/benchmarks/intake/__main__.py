"""Environment steps a second that a learner accepts into replay, beside other ways to move them.

    python -m research.benchmarks.intake [--json] [--write research/results/intake] [--workers 8 64 256 ...]
    [--pip-args=...]

Two processes on one machine, a player that stands for many workers and a sink, and a third where there is a router.
Ours does all that a run does (checksum, checks, deduplication, ledger, acknowledgement, copy into replay); the peers
move the same arrays and copy them into a preallocated ring. Ray and TorchRL run in environments of their own, which are
made when they are missing; each with one player. At every size each transport has as many chunks under way from each
worker as one of our requests takes from a spool, except TorchRL, whose collector makes one batch after another. Every
case is measured in turn, the whole sequence several times, and the best of each counts. Every size is measured with the
first number of workers, 128 KB with the others, too; these all play in the one player, so that it is the learner's side
that is loaded, and TorchRL is left out there because its collector stands for one worker.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final

from eia_sec.common.config.presets import preset
from eia_sec.common.errors import EiaSecError
from eia_sec.common.farm import farm_team
from eia_sec.common.transport.endpoint import free_endpoint
from eia_sec.deploy.local.threads import thread_environment
from eia_sec.deploy.reports.provenance import provenance
from research.benchmarks.intake.page import RAY_NAME, SIZES, SWEPT, TORCHRL_NAME, ZMQ_NAME, Result, Table, page
from research.benchmarks.intake.player import in_flight
from research.benchmarks.intake.record import record, write
from research.benchmarks.peers.catalogue import ROOT, SOURCES, Program
from research.benchmarks.peers.venvs import interpreter, provide

WORKERS: Final = 8
MOST_WORKERS: Final = 4096
LIMIT: Final = 180.0
"""Seconds after which a case counts as failed."""
RAY = Program("intake", "Ray", "research.benchmarks.intake.peer_ray", "intake")
TORCHRL = Program("intake", "TorchRL", "research.benchmarks.intake.peer_torchrl", "benchmarl")
ZMQ = Program("intake", "pyzmq", "research.benchmarks.intake.peer_zmq", "intake")
PEERS: Final = {RAY_NAME: RAY, TORCHRL_NAME: TORCHRL, ZMQ_NAME: ZMQ}


class Bench:
    """Measures one case at a time.

    Args:
        seconds: measuring time of a case.
        venvs: where the peers' environments lie.
        scratch: a folder for recorded chunks.
        spool: chunks that each worker's spool holds.

    Attributes:
        under_way: for each size, how many chunks each worker has under way at once.
    """

    def __init__(self, seconds: float, venvs: Path, scratch: Path, spool: int) -> None:
        self._seconds, self._venvs, self._scratch = seconds, venvs, scratch
        self.under_way = {label: in_flight(size, spool) for label, size in SIZES.items()}
        for label, size in SIZES.items():
            write(record(size), scratch / label)

    def _load(self, label: str, workers: int) -> tuple[str, ...]:
        """Return the arguments that say how many workers play, and how many chunks each has under way."""
        return "--workers", str(workers), "--chunks", str(self.under_way[label])

    def _start(self, python: str, *arguments: str) -> "subprocess.Popen[str]":
        environment = {**os.environ, **thread_environment(1), "PYTHONPATH": SOURCES}
        return subprocess.Popen(
            [python, "-m", *arguments],
            cwd=ROOT,
            env=environment,
            text=True,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
        )

    def _result(self, sink: "subprocess.Popen[str]") -> Result:
        """Wait for a sink's last line; raise EiaSecError when there is none."""
        try:
            output, complaints = sink.communicate(timeout=LIMIT)
        except subprocess.TimeoutExpired as error:
            raise EiaSecError("nothing was measured in time.") from error
        if sink.returncode:
            raise EiaSecError(f"a sink failed: {complaints.strip().rpartition(chr(10))[2]}")
        result: Result = json.loads(output.strip().rpartition("\n")[2])
        return result

    def ours(self, label: str, workers: int, *, routed: bool, shared: bool) -> Result:
        """Measure ours, through a router or direct, with shared memory or over TCP alone."""
        endpoint = free_endpoint()
        more = ["--shared-memory"] if shared else []
        running = []
        try:
            if routed:
                running.append(self._start(sys.executable, "research.benchmarks.intake.router", str(endpoint), *more))
                time.sleep(1.0)
            where, size = [str(endpoint), *more], ("--bytes", str(SIZES[label]))
            seconds = ("--seconds", str(self._seconds))
            door = ["--routed"] if routed else []
            sink = self._start(sys.executable, "research.benchmarks.intake.sink", *where, *size, *seconds, *door)
            running.append(sink)
            assert sink.stdout is not None
            sink.stdout.readline()
            load = (*size, *self._load(label, workers))
            running.append(self._start(sys.executable, "research.benchmarks.intake.player", *where, *load))
            return self._result(sink)
        finally:
            end(running)

    def peer(self, program: Program, label: str, workers: int) -> Result:
        """Measure a peer that starts its own processes."""
        folder = ("--folder", str(self._scratch / label), "--seconds", str(self._seconds))
        python = str(interpreter(program, self._venvs))
        sink = self._start(python, program.module, *folder, *self._load(label, workers))
        try:
            return self._result(sink)
        finally:
            end([sink])

    def zmq(self, label: str, workers: int) -> Result:
        """Measure pyzmq."""
        endpoint = free_endpoint()
        address = f"tcp://{endpoint.host}:{endpoint.port}"
        python, folder = str(interpreter(ZMQ, self._venvs)), ("--folder", str(self._scratch / label))
        sink = self._start(python, ZMQ.module, "sink", address, *folder, "--seconds", str(self._seconds))
        player = self._start(python, ZMQ.module, "player", address, *folder, *self._load(label, workers))
        try:
            return self._result(sink)
        finally:
            end([player, sink])


def end(processes: "list[subprocess.Popen[str]]") -> None:
    """Kill what still runs."""
    for process in reversed(processes):
        process.kill()
        process.communicate()


def transports(bench: Bench) -> dict[str, Callable[[str, int], Result]]:
    """Return how each transport is measured at a size, with a number of workers."""
    return {
        "EIA-SEC, TCP": lambda label, workers: bench.ours(label, workers, routed=False, shared=False),
        "EIA-SEC, shared memory": lambda label, workers: bench.ours(label, workers, routed=False, shared=True),
        "EIA-SEC, TCP through a router": lambda label, workers: bench.ours(label, workers, routed=True, shared=False),
        "EIA-SEC, shared memory through a router": lambda label, workers: bench.ours(
            label, workers, routed=True, shared=True
        ),
        RAY_NAME: lambda label, workers: bench.peer(RAY, label, workers),
        TORCHRL_NAME: lambda label, workers: bench.peer(TORCHRL, label, workers),
        ZMQ_NAME: bench.zmq,
    }


def wanted(name: str, only: list[str] | None) -> bool:
    """Return whether a transport is asked for."""
    return not only or any(word in name for word in only)


def cases(name: str, workers: Sequence[int]) -> list[tuple[str, int]]:
    """Return the sizes and numbers of workers that a transport is measured with."""
    first, *others = workers
    swept = [] if name == TORCHRL_NAME else [(SWEPT, number) for number in others]
    return [*((label, first) for label in SIZES), *swept]


def measure(
    bench: Bench, repeats: int, only: list[str] | None, workers: Sequence[int]
) -> tuple[Table, Table, list[str]]:
    """Return the best of all repeats of each case, by size and by number of workers, and what failed."""
    found: dict[str, dict[tuple[str, int], Result]] = {}
    failures = []
    chosen = {name: run for name, run in transports(bench).items() if wanted(name, only)}
    for repeat in range(repeats):
        for name, run in chosen.items():
            for case in cases(name, workers):
                label = f"{name}, {case[0]}, {case[1]} workers"
                try:
                    result = run(*case)
                except EiaSecError as error:
                    failures.append(f"{label}: {error}")
                    sys.stderr.write(f"{failures[-1]}\n")
                    continue
                sys.stderr.write(f"{repeat + 1}: {label}: {result['env_steps_per_second']:,.0f} steps/s\n")
                before = found.setdefault(name, {}).get(case)
                if before is None or result["env_steps_per_second"] > before["env_steps_per_second"]:
                    found[name][case] = {key: round(value, 1) for key, value in result.items()}
    return (*tables(found, workers), failures)


def tables(found: dict[str, dict[tuple[str, int], Result]], workers: Sequence[int]) -> tuple[Table, Table]:
    """Return what was found by the bytes of a chunk, and by the number of workers where there were several."""
    by_size, by_workers = {}, {}
    for name, results in found.items():
        by_size[name] = {
            str(SIZES[label]): result for (label, number), result in results.items() if number == workers[0]
        }
        swept = {str(number): result for (label, number), result in results.items() if label == SWEPT}
        if len(workers) > 1 and name != TORCHRL_NAME:
            by_workers[name] = swept
    return by_size, by_workers


def options() -> argparse.Namespace:
    """Return what the command line asks for."""
    parser = argparse.ArgumentParser(
        prog="python -m research.benchmarks.intake", description=(__doc__ or "").partition("\n")[0]
    )
    parser.add_argument("--json", action="store_true", help="print JSON instead of a table")
    parser.add_argument("--write", type=Path, metavar="FOLDER")
    parser.add_argument("--seconds", type=float, default=4.0)
    parser.add_argument("--repeats", type=int, default=2)
    more = f"workers that play: the first number at every size, the others at {SWEPT}"
    parser.add_argument("--workers", type=int, nargs="+", default=[WORKERS], metavar="N", help=more)
    parser.add_argument(
        "--spool", type=int, default=preset("study").rollout.spool_chunks, help="chunks in a worker's spool"
    )
    parser.add_argument("--only", nargs="+", metavar="WORD", help="only transports whose name holds one of these")
    parser.add_argument("--venvs", type=Path, default=ROOT / "research" / "benchmarks" / ".venvs")
    parser.add_argument("--pip-args", default="", help="added to pip install")
    asked = parser.parse_args()
    if not all(1 <= number <= MOST_WORKERS for number in asked.workers):
        parser.error(f"--workers must be 1 to {MOST_WORKERS}.")
    if len(set(asked.workers)) < len(asked.workers):
        parser.error("--workers names a number twice.")
    return asked


def main() -> None:
    """Measure and print; exit with 1 when a case has failed."""
    asked = options()
    for name, program in PEERS.items():
        if wanted(name, asked.only):
            provide(program, asked.venvs, asked.pip_args)
    with tempfile.TemporaryDirectory() as scratch:
        bench = Bench(asked.seconds, asked.venvs, Path(scratch), asked.spool)
        found, by_workers, failures = measure(bench, asked.repeats, asked.only, asked.workers)
    data = {
        **provenance("research.benchmarks.intake"),
        "team": farm_team(preset("study").farm).digest,
        "cores": os.cpu_count(),
        "workers": asked.workers[0],
        "chunks_under_way": bench.under_way,
        "transports": found,
        **({"by_workers": by_workers} if by_workers else {}),
        "failures": failures,
    }
    if asked.write:
        asked.write.mkdir(parents=True, exist_ok=True)
        (asked.write / "intake.json").write_text(json.dumps(data, indent=1) + "\n", encoding="utf-8")
        (asked.write / "README.md").write_text(page(data), encoding="utf-8")
    sys.stdout.write(json.dumps(found) + "\n" if asked.json else page(data))
    sys.exit(1 if failures else 0)


if __name__ == "__main__":
    main()
