"""The page of the intake benchmark: a Markdown template, filled in from the results."""

from pathlib import Path
from typing import Any, Final

from research.benchmarks.peers.report import table

TEMPLATE: Final = Path(__file__).with_suffix(".md")
SIZES: Final = {"16 KB": 16_384, "128 KB": 131_072, "1 MB": 1_048_576}
SWEPT: Final = "128 KB"
"""The size that is measured with every number of workers, and compared with Ray's."""
RAY_NAME, TORCHRL_NAME, ZMQ_NAME = "Ray actors", "TorchRL distributed collector", "pyzmq"
OURS: Final = "EIA-SEC"
"""How the names of our transports begin."""
TIMES_RAY: Final = 5.0
"""The least multiple of Ray's rate that is wanted at SWEPT."""
STEPS: Final = 300_000
"""Environment steps a second that are wanted."""
Result = dict[str, float]
Table = dict[str, dict[str, Result]]
"""For each transport, and each size or number of workers."""


def page(data: dict[str, Any]) -> str:
    """Return the results as Markdown."""
    lines = [
        *_rows(data["transports"], {str(size): f"{label} chunks" for label, size in SIZES.items()}),
        *_aims(data["transports"]),
    ]
    if by_workers := data.get("by_workers"):
        numbers = sorted({number for results in by_workers.values() for number in results}, key=int)
        lines += ["", f"With other numbers of workers, all of them played by one process, {SWEPT} chunks:", ""]
        lines += _rows(by_workers, {number: _workers(int(number)) for number in numbers})
    return TEMPLATE.read_text(encoding="utf-8").format(
        command=data["command"],
        commit=data["commit"],
        cores=data["cores"],
        workers=_workers(data["workers"]),
        in_flight=", ".join(f"{count} of {label}" for label, count in data["chunks_under_way"].items()),
        tables="\n".join(lines),
    )


def _workers(number: int) -> str:
    return f"{number:,} worker{'s' if number != 1 else ''}"


def _rows(found: Table, columns: dict[str, str]) -> list[str]:
    """Return a table with a row for each transport, and a column, by its key in the results, for each title."""
    rows = []
    for name, results in found.items():
        cells = [results.get(key) for key in columns]
        texts = [f"{c['env_steps_per_second']:,.0f} ({c['mb_per_second']:,.0f})" if c else "-" for c in cells]
        rows.append([name, *texts])
    return table(["transport", *columns.values()], rows, 1)


def _aims(found: Table) -> list[str]:
    """Return how often our transports take in what Ray does, and which of them reach what is wanted."""
    rays = found.get(RAY_NAME, {})
    sizes = {label: str(size) for label, size in SIZES.items() if str(size) in rays}
    ours = {name: results for name, results in found.items() if name.startswith(OURS) and results}
    if SWEPT not in sizes or not ours:
        return []
    times = {
        name: {
            label: results[size]["env_steps_per_second"] / rays[size]["env_steps_per_second"]
            for label, size in sizes.items()
            if size in results
        }
        for name, results in ours.items()
    }
    rows = [
        [name, *(f"{known[label]:.2f}" if label in known else "-" for label in sizes)] for name, known in times.items()
    ]
    most = {name: max(result["env_steps_per_second"] for result in results.values()) for name, results in ours.items()}
    near = {name: known[SWEPT] >= TIMES_RAY for name, known in times.items() if SWEPT in known}
    fast = {name: rate >= STEPS for name, rate in most.items()}
    return [
        "",
        "How many times as much as Ray's actors:",
        "",
        *table(["transport", *sizes], rows, 1),
        "",
        f"Wanted are {TIMES_RAY:g} times at {SWEPT}",
        f"({_verdict(near)})",
        f"and {STEPS:,} steps a second, which we read as at some size of chunks",
        f"({_verdict(fast)}).",
    ]


def _verdict(reached: dict[str, bool]) -> str:
    """Return who reaches something and who does not."""
    short: dict[bool, list[str]] = {True: [], False: []}
    for name, does in reached.items():
        short[does].append(name.removeprefix(f"{OURS}, "))
    parts = [
        f"{word}: {', '.join(names)}" for word, names in (("reached", short[True]), ("not", short[False])) if names
    ]
    return "; ".join(parts)
