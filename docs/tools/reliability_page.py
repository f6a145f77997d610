"""The page of faults and full doses: docs/explanation/reliability.md from the figures in docs/results/reliability.

    EIA_SEC_FIGURES=docs/results/reliability python -m pytest -m nightly tests/faults     # the doses, about an hour
    python -m docs.tools.reliability_page                                                     # the page

What the page says besides its table is in `docs/tools/reliability_page.md`.
"""

import json
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

FIGURES = Path("docs/results/reliability")
PAGE = Path("docs/explanation/reliability.md")
TEXT = Path(__file__).with_suffix(".md")
TABLE = "<!-- table -->\n"
"""Where the table stands in the text."""
Figures = dict[str, Any]


def seconds(spread: dict[str, float]) -> str:
    """Return a median and a maximum of seconds as words."""
    return f"{spread['median']:.1f} s, at most {spread['most']:.1f} s"


def explained(figures: Figures) -> str:
    """Return what the audit found, as words."""
    doubled = figures.get("doubled", 0)
    return f"unexplained {figures['unexplained']}" + (f", doubled {doubled}" if doubled else "")


def lost(figures: Figures) -> str:
    """Return how many chunks were declared lost, as words."""
    count = figures["lost_chunks"]
    return f"{count or 'no'} chunk{'' if count == 1 else 's'} lost"


def killed_workers(f: Figures) -> str:
    """Say what kills of workers came to."""
    return (
        f"{f['kills']} kills among {f['workers']} workers with spools of one chunk: {lost(f)}, "
        f"{f['lost_chunks_per_kill']:.2f} a kill; a replacement delivers after {seconds(f['seconds_to_replace'])}; "
        f"the learner grew by {f['learner_grew_mib']:.0f} MiB; {explained(f)}"
    )


def killed_learner(f: Figures) -> str:
    """Say what kills of the learner came to."""
    return (
        f"{f['kills']} kills, {f['inside_a_checkpoint_write']} of them inside a write: chunks flow again after "
        f"{seconds(f['seconds_to_resume'])}; {f['ledger_lost']:,} steps in {f['lost_chunks']} chunks were acknowledged "
        f"after the last checkpoint, and exactly those are declared lost; {explained(f)}"
    )


def killed_coordinator(f: Figures) -> str:
    """Say what kills of the coordinator came to."""
    order = "all in order" if f["in_order"] else "not in order"
    return (
        f"{f['kills']} kills: {f['events']} events, {order}; the next event after "
        f"{seconds(f['seconds_to_next_event'])}; {explained(f)}"
    )


def killed_router(f: Figures) -> str:
    """Say what kills of the router came to."""
    return (
        f"{f['kills']} kills, {f['outage_seconds']:.0f} s without a router each: chunks flow again after "
        f"{seconds(f['seconds_to_recover'])}; {lost(f)}; the worker grew by "
        f"{f['worker_grew_mib']:.1f} MiB; {explained(f)}"
    )


def frozen_learner(f: Figures) -> str:
    """Say how workers fared while the learner stood still."""
    rows = [
        f"{row['seconds']:.0f} s: back in {row['seconds_to_recover']:.1f} s, worker {row['worker_grew_mib']:+.1f} MiB"
        for row in f["freezes"]
    ]
    return "; ".join([*rows, explained(f)])


def replaced_learner(f: Figures) -> str:
    """Say what became of a learner that thawed too late."""
    falls = f["falls_of_the_epoch"]
    applied = (
        "the worker's actors are of the new one throughout" if falls == 0 else f"{falls} times the old one's applied"
    )
    return f"it ends with code {f['old_learner_exit_code']}; {applied}; {lost(f)}; {explained(f)}"


def partitions(f: Figures) -> str:
    """Say how workers fared while they were cut off."""
    names = {"link": "link down", "both": "both ways", "to_learner": "to the learner", "to_worker": "to the worker"}
    rows = []
    for way, name in names.items():
        mine = [row for row in f["partitions"] if row["way"] == way]
        if mine:
            spans = "/".join(f"{row['seconds']:.0f}" for row in mine)
            rows.append(
                f"{name} {spans} s: back after " + "/".join(f"{row['seconds_to_recover']:.1f}" for row in mine) + " s"
            )
    grown = max(row["worker_grew_mib"] for row in f["partitions"])
    return "; ".join([*rows, f"worker at most {grown:+.1f} MiB", lost(f), explained(f)])


def bad_links(f: Figures) -> str:
    """Say how chunks travel on slow, narrow and stalled links."""
    rates = ", ".join(f"{name} {rate:.1f}" for name, rate in f["chunks_per_second"].items())
    return (
        f"chunks a second: {rates}; after a stall of {f['stall_seconds']:.0f} s back in "
        f"{f['seconds_to_recover']:.1f} s; {lost(f)}; {explained(f)}"
    )


def bad_road(f: Figures) -> str:
    """Say what came of a bad road."""
    return (
        f"{f['chunks']:,} chunks in {f['sendings']:,} sendings ({f['duplicated']:,} doubled, {f['reordered']:,} "
        f"overtaken, {f['cut']:,} cut, {f['flipped']:,} flipped): {f['accepted']:,} accepted, "
        f"{f['accepted_twice']} of them twice; "
        f"{f['counted_damaged']:,} counted as damaged, the other {f['unseen']:,} lay behind a chunk that had to "
        "come again"
    )


def bad_proxy(f: Figures) -> str:
    """Say what came of a proxy that does the same to messages of real processes."""
    return (
        f"{f['accepted_chunks']:,} chunks of two workers ({f['duplicated']:,} requests doubled, {f['reordered']:,} "
        f"once more behind newer ones, {f['cut']:,} cut, {f['flipped']:,} flipped): {f['doubled']} taken twice; "
        f"{f['counted_damaged']:,} counted as damaged, the other {f['unseen']:,} lay behind a chunk that had to come "
        f"again; {explained(f)}"
    )


def mutated_frames(f: Figures) -> str:
    """Say what came of mutated frames."""
    return f"{f['frames']:,} frames, {f['messages']:,} still messages; memory {f['grown_mib']:+.1f} MiB"


def flood(f: Figures) -> str:
    """Say what a flood left the others."""
    return (
        f"{f['junk_requests']:,} requests of 128 KiB: the others keep {f['share_kept']:.0%} of their rate; who floods "
        f"is cut off and named; {explained(f)}"
    )


def hostile_chunks(f: Figures) -> str:
    """Say what came of requests that are spoilt in one field each."""
    return (
        f"{f['kinds']:,} kinds in {f['requests']:,} requests, {f['answered']:,} of them answered; the honest worker "
        f"keeps {f['share_kept']:.0%} of its rate; the learner {f['learner_grew_mib']:+.1f} MiB; {explained(f)}"
    )


def full_disk(f: Figures) -> str:
    """Say what came of a full disk."""
    return f"{f['alarms']} alarms; a new checkpoint {f['seconds_to_recover']:.1f} s after there was room again"


def stops(f: Figures) -> str:
    """Say how stops went."""
    return f"{f['stops']} stops: ended after {seconds(f['seconds_to_end'])}"


def soak(f: Figures) -> str:
    """Say what grew."""
    rows = [
        f"{name} {row['mib_per_hour']:+.1f} MiB an hour ({row['mib']:.0f} MiB), threads {row['threads'][0]} to "
        f"{row['threads'][1]}, descriptors {row['descriptors'][0]} to {row['descriptors'][1]}"
        for name, row in f["processes"].items()
    ]
    return f"{f['minutes']:.0f} minutes (`EIA_SEC_SOAK_MINUTES`), the last two thirds measured: " + "; ".join(rows)


@dataclass(frozen=True)
class Row:
    """One line of the table.

    Attributes:
        fault: what is done, at full dose.
        holds: what must hold.
        told: puts its figures into words; its name is that of the file of figures.
        test: where the small dose is.
    """

    fault: str
    holds: str
    told: Callable[[Figures], str]
    test: str

    @property
    def figures(self) -> str:
        """Name of the file of figures."""
        return self.told.__name__


ROWS = (
    Row("kill -9 a worker, 50 times", "at most one unsent chunk a kill, counted", killed_workers, "test_kills.py"),
    Row("kill -9 the learner, 20 times", "resumes; the ledger's losses are exact", killed_learner, "test_kills.py"),
    Row("kill -9 the coordinator, 20 times", "the schedule goes on", killed_coordinator, "test_kills.py"),
    Row("kill -9 the router, 20 times", "nothing lost", killed_router, "test_kills.py"),
    Row("learner frozen", "worker at most +64 MiB; back within 10 s", frozen_learner, "test_freezes.py"),
    Row("learner frozen, replaced, thawed", "nothing of the old one is applied", replaced_learner, "test_freezes.py"),
    Row("partitions between network namespaces", "back within 15 s", partitions, "test_partitions.py"),
    Row("slow, narrow and stalled links", "nothing lost", bad_links, "test_partitions.py"),
    Row("a road that doubles, reorders, cuts and flips", "the accepted set is exact", bad_road, "test_messages.py"),
    Row("a proxy that does so between real processes", "every chunk is taken once", bad_proxy, "test_proxy.py"),
    Row("mutated frames", "typed errors only; at most +32 MiB", mutated_frames, "test_decoder.py"),
    Row("flood of junk by one of four workers", "the others keep 80 % of their rate", flood, "test_refusals.py"),
    Row(
        "requests spoilt in one field each, generated from the messages",
        "all answered; the honest worker keeps 80 % of its rate; at most +32 MiB",
        hostile_chunks,
        "test_hostile.py",
    ),
    Row("full disk", "training goes on; the checkpoint before loads", full_disk, "test_disk.py"),
    Row("SIGTERM and Ctrl-C, 50 times", "exit 0 within 10 s, no orphan", stops, "test_stops.py"),
    Row("soak", "below 1 MiB an hour; threads and descriptors flat", soak, "test_soak.py"),
)


def table(folder: Path) -> str:
    """Return the table for a folder of figures."""
    lines = ["| fault | must hold | measured | commit | small dose in |", "|---|---|---|---|---|"]
    for row in ROWS:
        path = folder / f"{row.figures}.json"
        measured, commit = "not run at full dose yet", "-"
        if path.exists():
            figures = json.loads(path.read_text(encoding="utf-8"))
            measured, commit = row.told(figures), figures["commit"]
        cells = [row.fault, row.holds, measured, commit, f"`tests/faults/{row.test}`"]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def page(folder: Path) -> str:
    """Return the page for a folder of figures."""
    return TEXT.read_text(encoding="utf-8").replace(TABLE, table(folder))


def main(arguments: list[str]) -> None:
    """Write the page."""
    target = Path(arguments[0]) if arguments else PAGE
    target.write_text(page(FIGURES), encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
