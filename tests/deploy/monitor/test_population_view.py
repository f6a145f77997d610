"""What a view shows of a population: a member's round and rank in its own view, and a line for each member."""

import io

import pytest
from rich.console import Console

from eia_sec.common.errors import SchemaError
from eia_sec.deploy.monitor.live_view import membership, render, summary
from eia_sec.deploy.monitor.population_view import render_population, summaries
from eia_sec.deploy.monitor.process_report import membership_of
from eia_sec.deploy.monitor.snapshot import LedgerCounts, Membership, RoundRow, Snapshot, record

IMITATED = {
    "round": 2,
    "scores": {"member-0": 1.0, "member-1": 3.0, "member-2": 2.0},
    "rate": 0.5,
    "sources": {"monitoring": "member-1"},
    "hyperparameters": {"actor_rate": 1.2e-3},
}
KEPT = {**IMITATED, "round": 3, "scores": {"member-0": 4.0, "member-1": 3.0}, "rate": 0.0, "sources": {}}
REPORT = {"round": 3, "hyperparameters": {"actor_rate": 1.2e-3}, "exploits": [IMITATED, KEPT]}
LINE = "round 3 of its population, rank 1 of 2, imitated in round 2: monitoring member-1, share 0.5, actor_rate 0.0012"


def drawn(view) -> str:
    console = Console(file=io.StringIO(), width=200, height=60)
    console.print(view)
    return console.file.getvalue()


def test_a_member_shows_its_round_and_whom_it_imitated():
    """In the view, in the summary and in the record; a run alone shows nothing of it."""
    member = membership_of(REPORT, "member-0")
    assert member == Membership(
        3,
        (("actor_rate", 1.2e-3),),
        (RoundRow(2, 1.0, 3, 3, 0.5, (("monitoring", "member-1"),)), RoundRow(3, 4.0, 1, 2, 0.0)),
    )
    assert membership(member) == LINE
    snapshot = Snapshot("member-0", "training", episodes_total=10, population=member)
    assert LINE in summary(snapshot)
    assert LINE in drawn(render(snapshot))
    assert record(snapshot)["population"]["newest"][1]["rank"] == 1
    assert membership_of({}, "train") is None
    assert "population" not in drawn(render(Snapshot("train")))


@pytest.mark.parametrize("change", [{"scores": {"a": "b"}}, {"sources": 3}, {"rate": None}, {"round": "x"}])
def test_a_report_that_cannot_be_read_is_malformed(change):
    """The monitor drops and counts it, as any other."""
    with pytest.raises((SchemaError, TypeError, ValueError, AttributeError)):
        membership_of({**REPORT, "exploits": [{**IMITATED, **change}]}, "member-0")


def test_a_population_has_a_line_for_each_member():
    """Also one whose learner was not reached yet; alarms name their member."""
    ledger = LedgerCounts(unexplained=5)
    trains = Snapshot(
        "member-0", "training", episodes_total=10, episodes=4, progress=0.4, ledger=ledger, alarms=("odd.",)
    )
    text = drawn(render_population({"member-0": trains, "member-1": None}, ["elite ended."]))
    rows = {line.split()[1]: line for line in text.splitlines() if line.startswith("│ member-")}
    assert rows["member-0"].split()[2:6] == ["training", "40%", "-", "-"]
    assert " 5 " in rows["member-0"]
    assert rows["member-1"].split()[2] == "starting"
    assert "elite ended." in text
    assert "member-0: odd." in text
    assert [line.split(": ")[0:2] for line in summaries({"member-0": trains, "member-1": None})] == [
        ["member-0", "training"],
        ["member-1", "starting"],
    ]
