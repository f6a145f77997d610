"""The rules by which claims are judged: what an interval decides, and what it leaves open."""

import pytest

from research.studies.analysis.verdicts import (
    FAR,
    SIMILAR,
    above,
    alike,
    alike_throughout,
    best_of,
    far,
    full,
    judged,
    ratio,
    similar,
)


@pytest.mark.parametrize(
    ("answers", "verdict"),
    [
        ([True, True], "holds"),
        ([True, None], "holds in part"),
        ([True, False], "holds in part"),
        ([False, None], "does not hold"),
        ([False], "does not hold"),
        ([None, None], "undecided"),
    ],
)
def test_verdicts_on_several_answers(answers, verdict):
    """All, some, none, and open throughout."""
    assert judged(answers) == verdict


def test_intervals_decide():
    """Only an interval that excludes the other side is an answer."""
    assert [above(p) for p in ((0.9, 0.6, 1.0), (0.1, 0.0, 0.4), (0.6, 0.4, 0.8))] == [True, False, None]
    assert [far(lead) for lead in ((0.3, 0.25, 0.4), (0.1, 0.0, 0.15), (0.2, 0.1, 0.3))] == [True, False, None]


def test_a_gap_is_not_both_large_and_none():
    """Whatever the gap and its interval, two methods that are alike are not far apart."""
    assert FAR > SIMILAR
    for gap in (0.0, 0.05, 0.0634, 0.0654, 0.099, 0.15, 0.19, 0.21, 0.4):
        for width in (0.0, 0.02, 0.3):
            lead = (gap, gap - width, gap + width)
            assert not (far(lead) and similar(lead, (1.0, 1.0, 1.0)))


def test_methods_are_alike_by_the_whole_interval():
    """A narrow interval inside the tolerance shows it, a wide one does not, and a clear larger gap refutes it."""
    assert similar((0.03, -0.02, 0.08), (0.9, 0.7, 1.0)) is True
    assert similar((0.03, -0.2, 0.2), (0.6, 0.2, 1.0)) is None
    assert similar((-0.15, -0.2, -0.1), (0.0, 0.0, 0.0)) is False
    assert similar((0.15, -0.1, 0.4), (0.7, 0.3, 1.0)) is None


@pytest.mark.parametrize(
    ("ours", "verdict"), [(0.80, "holds"), (0.83, "holds"), (0.95, "holds in part"), (1.01, "does not hold")]
)
def test_ratios_agree_within_five_percent(ours, verdict):
    """Beside the paper's 0.81: within the tolerance, on the same side of 1, on the other."""
    assert alike(0.81, ours) == verdict


@pytest.mark.parametrize(("ours", "verdict"), [(1.01, "holds"), (0.94, "holds"), (0.46, "does not hold")])
def test_a_ratio_near_one_has_no_side(ours, verdict):
    """Beside the paper's 0.98, which says that nothing changes, half as much is no agreement."""
    assert alike(0.98, ours) == verdict


@pytest.mark.parametrize(
    ("ours", "verdict"),
    [
        ((0.80, 0.78, 0.83), "holds"),
        ((0.83, 0.80, 0.90), "undecided"),
        ((0.90, 0.60, 0.95), "undecided"),
        ((0.95, 0.90, 0.99), "holds in part"),
        ((1.00, 0.99, 1.01), "does not hold"),
        ((1.10, 1.05, 1.15), "does not hold"),
    ],
)
def test_a_ratio_agrees_with_its_whole_interval(ours, verdict):
    """Beside the paper's 0.81; an interval on both sides of the tolerance's edge decides nothing."""
    assert alike_throughout(0.81, ours) == verdict


def test_a_ratio_is_as_wide_as_its_numbers():
    """Its ends are those of the numbers, taken against each other."""
    assert ratio((4.0, 2.0, 6.0), (2.0, 1.0, 4.0)) == (2.0, 0.5, 6.0)


def test_the_best_of_several():
    """It has to be the first, and clearly, and another has to be clearly above it to refute that."""
    numbers = {"1": (5, 4, 6), "2": (9, 8, 10)}
    assert best_of(numbers, "2", {"1": (1.0, 0.9, 1.0)}) == "holds"
    assert best_of(numbers, "2", {"1": (0.7, 0.4, 1.0)}) == "holds in part"
    assert best_of(numbers, "1", {"2": (0.0, 0.0, 0.1)}) == "does not hold"
    assert best_of(numbers, "1", {"2": (0.3, 0.1, 0.6)}) == "undecided"


def test_smoke_results_are_no_results():
    """Only the full scale counts."""
    assert full({"scale": "smoke"}) is None
    assert full(None) is None
    assert full({"scale": "full"}) is not None
