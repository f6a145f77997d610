"""The table of faults in docs/explanation/reliability.md, from the numbers in research/results/reliability.

EIA_SEC_RESULTS=research/results/reliability python -m pytest -m nightly tests/faults     # the full doses, about an
hour
"""

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

FOLDER = Path("research/results/reliability")
Numbers = dict[str, Any]


def seconds(spread: dict[str, float]) -> str:
    """Return a median and a maximum of seconds as words."""
    return f"{spread['median']:.1f} s, at most {spread['most']:.1f} s"


def explained(f: Numbers) -> str:
    """Return what the audit found, as words."""
    doubled = f.get("doubled", 0)
    return f"unexplained {f['unexplained']}" + (f", doubled {doubled}" if doubled else "")


def lost(f: Numbers) -> str:
    """Return how many chunks were declared lost, as words."""
    count = f["lost_chunks"]
    return f"{count or 'no'} chunk{'' if count == 1 else 's'} lost"


def killed_workers(f: Numbers) -> str:
    """Describe kills of workers."""
    return (
        f"{f['kills']} kills among {f['workers']} workers with spools of one chunk: {lost(f)}, "
        f"{f['lost_chunks_per_kill']:.2f} a kill; a replacement delivers after {seconds(f['seconds_to_replace'])}; "
        f"the learner grew by {f['learner_grew_mib']:.0f} MiB; {explained(f)}"
    )


def killed_learner(f: Numbers) -> str:
    """Describe kills of the learner."""
    return (
        f"{f['kills']} kills, {f['inside_a_checkpoint_write']} of them during a checkpoint write: chunks arrive again "
        "after "
        f"{seconds(f['seconds_to_resume'])}; {f['ledger_lost']:,} steps in {f['lost_chunks']} chunks were acknowledged "
        f"after the last checkpoint, and exactly those are counted as lost; {explained(f)}"
    )


def killed_coordinator(f: Numbers) -> str:
    """Describe kills of the coordinator."""
    order = "all in order" if f["in_order"] else "not in order"
    return (
        f"{f['kills']} kills: {f['events']} events, {order}; the next event after "
        f"{seconds(f['seconds_to_next_event'])}; {explained(f)}"
    )


def killed_router(f: Numbers) -> str:
    """Describe kills of the router."""
    return (
        f"{f['kills']} kills, {f['outage_seconds']:.0f} s without a router each: chunks arrive again after "
        f"{seconds(f['seconds_to_recover'])}; {lost(f)}; the worker grew by "
        f"{f['worker_grew_mib']:.1f} MiB; {explained(f)}"
    )


def frozen_learner(f: Numbers) -> str:
    """Describe how workers fared while the learner stood still."""
    rows = [
        f"{row['seconds']:.0f} s: back in {row['seconds_to_recover']:.1f} s, worker {row['worker_grew_mib']:+.1f} MiB"
        for row in f["freezes"]
    ]
    return "; ".join([*rows, explained(f)])


def replaced_learner(f: Numbers) -> str:
    """Describe what became of a learner that thawed too late."""
    falls = f["falls_of_the_epoch"]
    applied = (
        "the worker uses the new learner's actors throughout"
        if falls == 0
        else f"the old learner's actors were applied {falls} times"
    )
    return f"it exits with code {f['old_learner_exit_code']}; {applied}; {lost(f)}; {explained(f)}"


def partitions(f: Numbers) -> str:
    """Describe how workers fared while they were cut off."""
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


def bad_links(f: Numbers) -> str:
    """Describe how chunks travel on slow, narrow and stalled links."""
    rates = ", ".join(f"{name} {rate:.1f}" for name, rate in f["chunks_per_second"].items())
    return (
        f"chunks a second: {rates}; after a stall of {f['stall_seconds']:.0f} s back in "
        f"{f['seconds_to_recover']:.1f} s; {lost(f)}; {explained(f)}"
    )


def bad_road(f: Numbers) -> str:
    """Describe delivery over a bad channel."""
    return (
        f"{f['chunks']:,} chunks in {f['sendings']:,} sendings ({f['duplicated']:,} duplicated, {f['reordered']:,} "
        f"reordered, {f['cut']:,} truncated, {f['flipped']:,} flipped): {f['accepted']:,} accepted, "
        f"{f['accepted_twice']} of them twice; "
        f"{f['counted_damaged']:,} counted as damaged, the other {f['unseen']:,} followed a chunk that had to be "
        "sent again"
    )


def bad_proxy(f: Numbers) -> str:
    """Describe delivery through a bad proxy between real processes."""
    return (
        f"{f['accepted_chunks']:,} chunks of two workers ({f['duplicated']:,} requests duplicated, {f['reordered']:,} "
        f"sent again after newer ones, {f['cut']:,} truncated, {f['flipped']:,} flipped): "
        f"{f['doubled']} accepted twice; "
        f"{f['counted_damaged']:,} counted as damaged, the other {f['unseen']:,} followed a chunk that had to be sent "
        f"again; {explained(f)}"
    )


def mutated_frames(f: Numbers) -> str:
    """Describe the decoding of mutated frames."""
    return f"{f['frames']:,} frames, {f['messages']:,} still messages; memory {f['grown_mib']:+.1f} MiB"


def flood(f: Numbers) -> str:
    """Describe what the others kept during a flood."""
    return (
        f"{f['junk_requests']:,} requests of 128 KiB: the others keep {f['share_kept']:.0%} of their rate; the "
        f"flooder is blocked and named; {explained(f)}"
    )


def hostile_chunks(f: Numbers) -> str:
    """Describe requests with one invalid field each."""
    return (
        f"{f['kinds']:,} kinds in {f['requests']:,} requests, {f['answered']:,} of them answered; the honest worker "
        f"keeps {f['share_kept']:.0%} of its rate; the learner {f['first_round_mib']:+.1f} MiB while each kind comes "
        f"once, {f['learner_grew_mib']:+.1f} MiB from then on; {explained(f)}"
    )


def full_disk(f: Numbers) -> str:
    """Describe a full disk."""
    return f"{f['alarms']} alarms; a new checkpoint {f['seconds_to_recover']:.1f} s after space was freed"


def stops(f: Numbers) -> str:
    """Describe how stops went."""
    return f"{f['stops']} stops: ended after {seconds(f['seconds_to_end'])}"


def soak(f: Numbers) -> str:
    """Describe what grew."""
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
        describe: describes its numbers; the file of numbers has the name of this function.
        test: where the small dose is.
    """

    fault: str
    holds: str
    describe: Callable[[Numbers], str]
    test: str

    @property
    def source(self) -> str:
        """Name of the file of numbers, without its ending."""
        return self.describe.__name__


ROWS = (
    Row(
        "kill -9 a worker, 50 times",
        "at most one unsent chunk a kill, counted",
        killed_workers,
        "processes/test_kills.py",
    ),
    Row(
        "kill -9 the learner, 20 times",
        "resumes; the ledger counts the losses exactly",
        killed_learner,
        "processes/test_kills.py",
    ),
    Row("kill -9 the coordinator, 20 times", "the schedule continues", killed_coordinator, "processes/test_kills.py"),
    Row("kill -9 the router, 20 times", "nothing lost", killed_router, "processes/test_kills.py"),
    Row("learner frozen", "worker at most +64 MiB; back within 10 s", frozen_learner, "processes/test_freezes.py"),
    Row(
        "learner frozen, replaced, thawed",
        "nothing of the old one is applied",
        replaced_learner,
        "processes/test_freezes.py",
    ),
    Row("partitions between network namespaces", "back within 15 s", partitions, "test_partitions.py"),
    Row("slow, narrow and stalled links", "nothing lost", bad_links, "test_partitions.py"),
    Row(
        "a channel that duplicates, reorders, truncates and flips bits",
        "the accepted set is exact",
        bad_road,
        "test_messages.py",
    ),
    Row(
        "a proxy that does the same between real processes", "every chunk is accepted once", bad_proxy, "test_proxy.py"
    ),
    Row("mutated frames", "typed errors only; at most +32 MiB", mutated_frames, "test_decoder.py"),
    Row(
        "a flood of invalid requests by one of four workers",
        "the others keep 80 % of their rate",
        flood,
        "test_refusals.py",
    ),
    Row(
        "requests with one invalid field each, generated from the message declarations",
        "all answered; the honest worker keeps 80 % of its rate; at most +32 MiB",
        hostile_chunks,
        "test_hostile.py",
    ),
    Row("full disk", "training continues; the previous checkpoint loads", full_disk, "test_disk.py"),
    Row("SIGTERM and Ctrl-C, 50 times", "exit 0 within 10 s, no orphan processes", stops, "processes/test_stops.py"),
    Row("soak", "below 1 MiB an hour; threads and descriptors flat", soak, "processes/test_soak.py"),
)


def faults(root: Path) -> str:
    """Return the table for the numbers in a repository."""
    folder = root / FOLDER
    lines = ["| fault | must hold | measured | commit | small version in |", "|---|---|---|---|---|"]
    for row in ROWS:
        path = folder / f"{row.source}.json"
        measured, commit = "not run at full scale yet", "-"
        if path.exists():
            found = json.loads(path.read_text(encoding="utf-8"))
            measured, commit = row.describe(found), found["commit"]
        cells = [row.fault, row.holds, measured, commit, f"`tests/faults/{row.test}`"]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"
