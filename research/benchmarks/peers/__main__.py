"""Simulator and learner beside those of other projects, in one session on the same cores.

    python -m research.benchmarks.peers [simulator | learner | both] [--json] [--write research/results/peers
    [--redraw]]

Each peer runs in a virtual environment of its own under research/benchmarks/.venvs, which is made when it is missing.
The whole sequence of programs is repeated, so that what disturbs the machine for a while disturbs all of them.
"""

import argparse
import json
import os
import platform
import sys
from collections.abc import Sequence
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path
from typing import Any

from eia_sec.common.errors import EiaSecError
from eia_sec.deploy.reports.plots import DPI
from eia_sec.deploy.reports.provenance import provenance
from research.benchmarks.peers import report
from research.benchmarks.peers.catalogue import OURS, PROGRAMS, ROOT, SUBJECTS, Program
from research.benchmarks.peers.session import Line, Plan, ProgramError, jobs, run
from research.benchmarks.peers.summary import summarised
from research.benchmarks.peers.venvs import provide


def options(arguments: Sequence[str] | None = None) -> argparse.Namespace:
    """Return the command line."""
    parser = argparse.ArgumentParser(
        prog="python -m research.benchmarks.peers", description=(__doc__ or "").partition("\n")[0]
    )
    parser.add_argument("subject", nargs="?", choices=(*SUBJECTS, "both"), default="both")
    parser.add_argument("--json", action="store_true", help="print JSON instead of tables")
    parser.add_argument("--write", type=Path, metavar="FOLDER", help="write data, picture and the page's tables")
    parser.add_argument("--redraw", action="store_true", help="with --write: only picture and page, from peers.json")
    parser.add_argument("--threads", type=int, nargs="+", default=sorted({1, os.cpu_count() or 1}))
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=4.0, help="measuring time of each case of a simulator")
    parser.add_argument("--updates", type=int, default=100, help="updates of each case of a learner")
    parser.add_argument("--widths", type=int, nargs="+", default=[64, 128, 256])
    parser.add_argument("--batches", type=int, nargs="+", default=[1, 32, 1024])
    parser.add_argument("--only", nargs="+", metavar="NAME", help="only these programs, by name")
    parser.add_argument("--venvs", type=Path, default=ROOT / "research" / "benchmarks" / ".venvs")
    parser.add_argument("--pip-args", default="", help="added to pip install: --pip-args='--index-url URL'")
    parser.add_argument("--make-venvs", action="store_true", help="only make what is missing")
    return parser.parse_args(arguments)


def chosen(subject: str, only: Sequence[str] | None) -> tuple[Program, ...]:
    """Return the programs of a subject, or those of them that are named.

    Raises:
        EiaSecError: a name is unknown.
    """
    programs = tuple(program for program in PROGRAMS if subject in ("both", program.subject))
    unknown = set(only or ()) - {program.name for program in programs}
    if unknown:
        known = ", ".join(dict.fromkeys(program.name for program in programs))
        raise EiaSecError(f"there is no program {', '.join(sorted(unknown))} here; known are {known}.")
    return tuple(program for program in programs if not only or program.name in only)


def processor() -> str:
    """Return the processor's name, as far as the system names it."""
    info = Path("/proc/cpuinfo")
    if info.is_file():
        for line in info.read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


def measure(programs: tuple[Program, ...], plan: Plan, venvs: Path) -> dict[str, Any]:
    """Run everything and return the whole result; a program that fails is noted, and the others go on."""
    machine: dict[str, Any] = {"processor": processor(), "cores": os.cpu_count(), "system": platform.platform()}
    machine["load_before"] = os.getloadavg()[0]
    lines: list[Line] = []
    failures: list[str] = []
    versions = {name: version(name) for name in ("torch", "numpy", "numba")}
    for repeat in range(plan.repeats):
        sys.stderr.write(f"repeat {repeat + 1} of {plan.repeats}\n")
        for job in jobs(programs, plan):
            try:
                found, theirs = run(job, plan, venvs)
            except ProgramError as error:
                failures.append(str(error))
                sys.stderr.write(f"{error}\n")
                continue
            lines += found
            own = job.program.environment == OURS
            versions |= {} if own else {name: n for name, n in theirs.items() if name not in versions}
    machine["load_after"] = os.getloadavg()[0]
    origin = provenance("research.benchmarks.peers")
    session = {"machine": machine, "plan": asdict(plan), "versions": versions, "failures": failures}
    return {**origin, **session, **summarised(lines)}


def write(result: dict[str, Any], folder: Path) -> None:
    """Write the data, the picture and the page's generated part."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "peers.json").write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    show(result, folder)


def show(result: dict[str, Any], folder: Path) -> None:
    """Write the picture and the page's generated part."""
    report.figure(result).savefig(folder / "peers.png", dpi=DPI)
    page = folder / "README.md"
    text = page.read_text(encoding="utf-8") if page.is_file() else "# Side by side\n\n" + "\n".join(report.MARKS) + "\n"
    page.write_text(report.refreshed(text, result), encoding="utf-8")


def kept(folder: Path | None) -> dict[str, Any]:
    """Return the result that a folder holds.

    Raises:
        EiaSecError: there is none.
    """
    if folder is None or not (folder / "peers.json").is_file():
        raise EiaSecError("--redraw needs --write FOLDER with a peers.json in it.")
    found: dict[str, Any] = json.loads((folder / "peers.json").read_text(encoding="utf-8"))
    return found


def main() -> None:
    """Measure and print; exit with 2 when asked for what cannot be, with 1 when a program has failed."""
    asked = options()
    plan = Plan(
        threads=tuple(asked.threads),
        repeats=asked.repeats,
        seconds=asked.seconds,
        updates=asked.updates,
        widths=tuple(asked.widths),
        batches=tuple(asked.batches),
    )
    try:
        if asked.redraw:
            show(kept(asked.write), asked.write)
            return
        programs = chosen(asked.subject, asked.only)
        for program in programs:
            provide(program, asked.venvs, asked.pip_args)
        if asked.make_venvs:
            return
        result = measure(programs, plan, asked.venvs)
    except EiaSecError as error:
        sys.stderr.write(f"{error}\n")
        sys.exit(2)
    if asked.write:
        write(result, asked.write)
    sys.stdout.write(json.dumps(result, indent=1) + "\n" if asked.json else report.block(result))
    sys.exit(1 if result["failures"] else 0)


if __name__ == "__main__":
    main()
