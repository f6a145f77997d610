"""Runs seeds of the simulation: `python -m tests.simulation SEED`, or `FIRST:LAST` for a range."""

import sys
import time
from collections import Counter
from pathlib import Path

from tests.simulation.simulation import simulate

SCRATCH = "/dev/shm" if Path("/dev/shm").is_dir() else None
"""Files in memory where there are such: the seeds say what a disk does."""


def main() -> None:
    """Print what happens with one seed, or what became of every seed of a range; exit with 1 if one failed."""
    first, _, last = sys.argv[1].partition(":")
    if not last:
        outcome = simulate(int(first), SCRATCH)
        sys.stdout.write("\n".join(outcome.trace) + "\n")
        sys.stdout.write(f"seed {first}, {outcome.events} events: {outcome.failure or outcome.steps}\n")
        sys.exit(bool(outcome.failure))
    began, failed, faults, events = time.monotonic(), 0, Counter[str](), 0
    for seed in range(int(first), int(last)):
        outcome = simulate(seed, SCRATCH)
        faults.update(outcome.faults)
        events += outcome.events
        if outcome.failure:
            failed += 1
            sys.stdout.write(f"seed {seed}, event {outcome.events}: {outcome.failure}\n")
            sys.stdout.flush()
    seconds, count = time.monotonic() - began, int(last) - int(first)
    sys.stdout.write(f"{count} seeds, {events} events in {seconds:.0f} s: {failed} failed; faults: {dict(faults)}\n")
    sys.exit(bool(failed))


if __name__ == "__main__":
    main()
