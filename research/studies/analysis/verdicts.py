"""How a claim of the paper is judged by our numbers. Every rule is here, and none looks at which answer is welcome."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal

Verdict = Literal["holds", "holds in part", "does not hold", "undecided"]
Answer = bool | None
"""Yes, no, or open."""
Triple = Sequence[float]
"""A number and the ends of its interval."""

NOT_RUN: Final = "not run at full scale"
NEAR: Final = 0.05
"""Ratios of rewards that differ by less count as equal."""
NEAR_TIME: Final = 0.1
"""The same for ratios of times."""
SIMILAR: Final = 0.1
"""Methods' normalised scores within this count as alike."""
FAR: Final = 0.2
"""A normalised lead has to be larger than this to be far: twice what still counts as alike, so nothing can be both."""


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
    verdict: Verdict = "undecided"
    why: str = ""


def judged(answers: Sequence[Answer]) -> Verdict:
    """Return the verdict on a claim that consists of several: yes to all, to some, to none, or open throughout."""
    if not answers:
        return "undecided"
    if all(answer is True for answer in answers):
        return "holds"
    if any(answer is True for answer in answers):
        return "holds in part"
    return "undecided" if all(answer is None for answer in answers) else "does not hold"


def above(probability: Triple) -> Answer:
    """Return whether one method is above another, by the interval of its probability of improvement."""
    return True if probability[1] > 0.5 else False if probability[2] < 0.5 else None


def far(lead: Triple) -> Answer:
    """Return whether a normalised lead is a large one; open where its interval lies on both sides of FAR."""
    return True if lead[1] > FAR else False if lead[2] <= FAR else None


def similar(lead: Triple, probability: Triple) -> Answer:
    """Return whether two methods are alike.

    They are when the whole interval of the difference is within SIMILAR, so that few seeds cannot show it; they are not
    when one is above the other and the difference is larger.
    """
    if max(abs(lead[1]), abs(lead[2])) <= SIMILAR:
        return True
    return False if above(probability) is not None and abs(lead[0]) > SIMILAR else None


def alike(paper: float, ours: float, near: float = NEAR) -> Verdict:
    """Return how two ratios agree: within the tolerance, only on the same side of 1, or not.

    A ratio of the paper that is itself within the tolerance of 1 has no side: it says that there is no difference.
    """
    if abs(ours / paper - 1.0) <= near:
        return "holds"
    if abs(paper - 1.0) <= near:
        return "does not hold"
    return "holds in part" if (ours - 1.0) * (paper - 1.0) > 0.0 else "does not hold"


def alike_throughout(paper: float, ours: Triple, near: float = NEAR) -> Verdict:
    """Return how two ratios agree when ours has an interval, judged as `alike` does.

    The paper's number holds when the whole interval is within the tolerance, is open when a part of it is, and is
    refuted otherwise; then it still holds in part when the whole interval is on its side of 1.
    """
    low, high = min(ours), max(ours)
    inside = [abs(number / paper - 1.0) <= near for number in (low, high)]
    if all(inside):
        return "holds"
    if any(inside) or low <= paper <= high:
        return "undecided"
    same = {alike(paper, number, near) for number in ours}
    return "holds in part" if same == {"holds in part"} else "does not hold"


def best_of(numbers: Mapping[str, Triple], wanted: str, better: Mapping[str, Triple]) -> Verdict:
    """Return whether the wanted one is the best of several, and clearly so.

    Args:
        numbers: every one's number.
        wanted: the one that is said to be the best.
        better: the probability that the wanted one is better than each other.
    """
    answers = [above(probability) for probability in better.values()]
    if max(numbers, key=lambda name: numbers[name][0]) == wanted:
        return "holds" if all(answers) else "holds in part"
    return "does not hold" if False in answers else "undecided"


def ratio(one: Triple, other: Triple) -> Triple:
    """Return the ratio of two positive numbers, and its ends when each is anywhere in its interval."""
    return one[0] / other[0], one[1] / other[2], one[2] / other[1]


def shown(numbers: Triple, digits: int = 0) -> str:
    """Return a number with its interval."""
    value, low, high = (f"{number:.{digits}f}" for number in numbers)
    return value if low == high else f"{value} ({low}..{high})"


def listed(numbers: Mapping[str, str]) -> str:
    """Return names with what each has, one after another."""
    return ", ".join(f"{name} {value}" for name, value in numbers.items())


def rows_table(rows: Sequence[Row]) -> str:
    """Return rows as a Markdown table."""
    lines = ["| the paper | here | verdict | why |", "|---|---|---|---|"]
    lines += [f"| {row.paper} | {row.ours} | **{row.verdict}** | {row.why} |" for row in rows]
    return "\n".join(lines) + "\n"


def full(data: Mapping[str, Any] | None) -> Mapping[str, Any] | None:
    """Return a study's results when they are of the full scale, None otherwise."""
    return data if data is not None and data.get("scale") == "full" else None
