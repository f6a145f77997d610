"""From the lines of all repeats to one line for each case, and to ratios. Nothing here measures."""

import statistics
from collections.abc import Iterable
from typing import Any

Line = dict[str, Any]
OURS = "EIA-SEC"
PEER_AIMS = {"AgileRL": 12.0, "BenchMARL": 4.0}
"""How many times as long as ours a peer's update was meant to take, at least, where the algorithm is the same."""
LIMIT_AIMS = {64: 2.0, 128: 1.6}
"""How many times its arithmetic limit an update of EIA-SEC was meant to take, at most, by width."""
REFERENCE = "NumPy reference"
MEASURES = {"simulator": "env_steps_per_second", "learner": "ms"}
"""The result of a line of each subject: the first is better when large, the second when small."""
RESULTS = ("env_steps_per_second", "ms", "median_ms", "limit_ms", "gflops")
"""What differs between repeats of one case."""


def subject_of(line: Line) -> str:
    """Return "simulator" or "learner"."""
    return "simulator" if MEASURES["simulator"] in line else "learner"


def merged(lines: Iterable[Line]) -> list[Line]:
    """Return one line for each case, in the order of first appearance.

    Each holds the case, `best` and `median` over repeats, `repeats` (all values), and what else the first one said.
    """
    cases: dict[tuple[Any, ...], list[Line]] = {}
    for line in lines:
        case = tuple(sorted((name, str(value)) for name, value in line.items() if name not in RESULTS))
        cases.setdefault(case, []).append(line)
    found = []
    for same in cases.values():
        measure = MEASURES[subject_of(same[0])]
        values = [float(line[measure]) for line in same]
        best = max(values) if measure == MEASURES["simulator"] else min(values)
        kept = {name: value for name, value in same[0].items() if name not in RESULTS}
        extra = {"limit_ms": min(line["limit_ms"] for line in same)} if "limit_ms" in same[0] else {}
        found.append({**kept, **extra, "best": best, "median": statistics.median(values), "repeats": values})
    return found


def cores(line: Line) -> int:
    """Return on how many cores a line was measured."""
    return int(line["threads"]) * int(line.get("processes", 1))


def simulator_ratios(lines: list[Line]) -> list[Line]:
    """Return, for each number of cores, our best rate by that of each other simulator at its best batch."""
    found = []
    for count in sorted({cores(line) for line in lines}):
        here = [line for line in lines if cores(line) == count]
        ours = [line for line in here if line["software"] == OURS]
        names = dict.fromkeys((line["software"], line["agents"]) for line in here if line["software"] != OURS)
        for name, agents in names:
            theirs = [line for line in here if (line["software"], line["agents"]) == (name, agents)]
            if not ours:
                continue
            left, right = (max(group, key=lambda line: line["best"]) for group in (ours, theirs))
            found.append(
                {
                    "cores": count,
                    "peer": name,
                    "peer_agents": agents,
                    "peer_environments": right["environments"],
                    "peer_processes": right["processes"],
                    "our_environments": left["environments"],
                    "ratio": left["best"] / right["best"],
                    "median_ratio": left["median"] / right["median"],
                }
            )
    return found


def learner_ratios(lines: list[Line]) -> list[Line]:
    """Return every peer's time by ours, for each width, number of threads and algorithm of ours.

    Of a peer's forms of one algorithm, the fastest counts.
    """
    found = []
    for ours in (line for line in lines if line["software"] == OURS):
        same = [
            line
            for line in lines
            if line["software"] != OURS and (line["width"], line["threads"]) == (ours["width"], ours["threads"])
        ]
        for name, algorithm in dict.fromkeys((line["software"], line["algorithm"]) for line in same):
            theirs = [line for line in same if (line["software"], line["algorithm"]) == (name, algorithm)]
            fastest = min(theirs, key=lambda line: line["best"])
            found.append(
                {
                    "width": ours["width"],
                    "threads": ours["threads"],
                    "ours": ours["algorithm"],
                    "peer": name,
                    "peer_algorithm": algorithm,
                    "peer_form": fastest["form"],
                    "ratio": fastest["best"] / ours["best"],
                    "median_ratio": fastest["median"] / ours["median"],
                }
            )
    return found


def learner_aims(lines: list[Line]) -> list[Line]:
    """Return what was aimed for and what was measured, for each number of threads and width.

    Each line holds `threads`, `width`, `against` (a peer, or "limit"), `aim` (None where there is none), `ratios` by
    algorithm, and `met`: whether all of them reach the aim, None without one. Best values count, and of a peer's forms
    the fastest.
    """
    ratios, found = learner_ratios(lines), []
    for ours in (line for line in lines if line["software"] == OURS and line["algorithm"] == "eia-sec"):
        case = {"threads": ours["threads"], "width": ours["width"]}
        for peer, aim in PEER_AIMS.items():
            same = {
                ratio["peer_algorithm"]: ratio["ratio"]
                for ratio in ratios
                if case.items() <= ratio.items()
                and ratio["peer"] == peer
                and ratio["ours"].lower() == ratio["peer_algorithm"].lower()
            }
            if same:
                met = all(value >= aim for value in same.values())
                found.append({**case, "against": peer, "aim": aim, "ratios": same, "met": met})
        over = ours["best"] / ours["limit_ms"]
        most = LIMIT_AIMS.get(ours["width"])
        met = over <= most if most else None
        found.append({**case, "against": "limit", "aim": most, "ratios": {"eia-sec": over}, "met": met})
    return found


def summarised(lines: Iterable[Line]) -> dict[str, list[Line]]:
    """Return the cases and ratios of each subject."""
    cases = merged(lines)
    simulator = [line for line in cases if subject_of_case(line) == "simulator"]
    learner = [line for line in cases if subject_of_case(line) == "learner"]
    return {
        "simulator": simulator,
        "learner": learner,
        "simulator_ratios": simulator_ratios(simulator),
        "learner_ratios": learner_ratios(learner),
    }


def subject_of_case(case: Line) -> str:
    """Return the subject of a merged line."""
    return "simulator" if "environments" in case else "learner"
