"""How a claim of the paper is judged by our numbers. Every rule is here, and none looks at which answer is welcome."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal

Verdict = Literal["holds", "holds in part", "does not hold", "cannot be told"]
Answer = bool | None
"""Yes, no, or open."""
Triple = Sequence[float]
"""A number and the ends of its interval."""

NOT_RUN: Final = "not run at full scale"
NEAR: Final = 0.05
"""Ratios of rewards that differ by less count as equal."""
NEAR_TIME: Final = 0.1
"""The same for ratios of times."""


@dataclass(frozen=True)
class Row:
    """One figure, number or sentence of the paper beside ours.

    Attributes:
        paper: what the paper says.
        ours: what we found.
        verdict: how the two agree.
        why: what the verdict rests on.
    """

    paper: str
    ours: str = NOT_RUN
    verdict: Verdict = "cannot be told"
    why: str = ""


def judged(answers: Sequence[Answer]) -> Verdict:
    """Return the verdict on a claim that consists of several: yes to all, to some, to none, or open throughout."""
    if all(answer is True for answer in answers):
        return "holds"
    if any(answer is True for answer in answers):
        return "holds in part"
    return "cannot be told" if all(answer is None for answer in answers) else "does not hold"


def above(probability: Triple) -> Answer:
    """Return whether one method is above another, by the interval of its probability of improvement."""
    return True if probability[1] > 0.5 else False if probability[2] < 0.5 else None


def lower(one: Triple, other: Triple) -> Answer:
    """Return whether the first number is the lower one; open where the intervals overlap."""
    return True if one[2] < other[1] else False if one[1] > other[2] else None


def alike(paper: float, ours: float, near: float = NEAR) -> Verdict:
    """Return how two ratios agree: within the tolerance, only on the same side of 1, or not.

    A ratio of the paper that is itself within the tolerance of 1 has no side: it says that there is no difference.
    """
    if abs(ours / paper - 1.0) <= near:
        return "holds"
    if abs(paper - 1.0) <= near:
        return "does not hold"
    return "holds in part" if (ours - 1.0) * (paper - 1.0) > 0.0 else "does not hold"


def best_of(rewards: Mapping[str, Triple], wanted: str) -> Verdict:
    """Return whether the wanted one has the largest number, and clearly so."""
    others = {name: numbers for name, numbers in rewards.items() if name != wanted}
    first = max(rewards, key=lambda name: rewards[name][0])
    if first == wanted:
        return "holds" if all(lower(numbers, rewards[wanted]) for numbers in others.values()) else "holds in part"
    return "does not hold" if lower(rewards[wanted], rewards[first]) else "cannot be told"


def shown(numbers: Triple, digits: int = 0) -> str:
    """Return a number with its interval."""
    value, low, high = (f"{number:.{digits}f}" for number in numbers)
    return value if low == high else f"{value} ({low}..{high})"


def rows_table(rows: Sequence[Row]) -> str:
    """Return rows as a Markdown table."""
    lines = ["| the paper | here | verdict | why |", "|---|---|---|---|"]
    lines += [f"| {row.paper} | {row.ours} | **{row.verdict}** | {row.why} |" for row in rows]
    return "\n".join(lines) + "\n"


def full(data: Mapping[str, Any] | None) -> Mapping[str, Any] | None:
    """Return a study's results when they are of the full scale, None otherwise."""
    return data if data is not None and data.get("scale") == "full" else None
