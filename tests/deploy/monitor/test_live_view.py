"""The live view: what it says, and that it says it at every width."""

import dataclasses
import io
import json
from pathlib import Path

import pytest
from rich.console import Console

from eia_sec.deploy.monitor.alarms import BEHIND_VERSIONS, examine
from eia_sec.deploy.monitor.live_view import MOST_ALARMS, render, summary
from eia_sec.deploy.monitor.snapshot import Imitation, ImitationRow, LedgerCounts, ProcessRow, Series, Snapshot, record
from eia_sec.deploy.monitor.sparkline import Sparkline, bars, buckets
from eia_sec.deploy.monitor.tables import ProcessTable, duration, short


def worker(index: int, **changes) -> ProcessRow:
    row = ProcessRow(
        role="rollout",
        name=f"worker-{index}",
        host="barn",
        pid=4200 + index,
        uptime=65.0 + index,
        rate=600.4,
        version=3019,
        episodes=406,
        queue=1,
        age=0.2,
        behind=2,
        ledger=LedgerCounts(produced=52_480, accepted=52_000, in_flight=480),
    )
    return dataclasses.replace(row, **changes)


SNAPSHOT = Snapshot(
    run="farm-7",
    state="training",
    elapsed=1512.0,
    left=2133.0,
    episodes=812,
    episodes_total=2000,
    progress=812 / 2000,
    reward=(
        Series("mean", (100.0, 741.0)),
        Series("communication", (-12.5,)),
        Series("monitoring", (1250.0,)),
        Series("collection", (960.0,)),
    ),
    freshness=(Series("AoI", (1.234,), 2), Series("VDF", (0.567,), 2)),
    steps=406_000,
    steps_rate=1201.3,
    updates=203_000,
    updates_rate=1003.2,
    staleness=1.7,
    learner_wait=0.02,
    worker_wait=0.41,
    ledger=LedgerCounts(produced=406_480, accepted=406_000, duplicates=3, rejected=120, lost=140, in_flight=220),
    imitation=Imitation(
        events=6,
        rate=0.003125,
        next_episode=1270,
        elites=(("c", 2, 0.8125), ("m", 0, None), ("d", 3, -1.5)),
        newest=tuple(
            ImitationRow(k, 10 * 2**k, 0.1 / 2**k, (("c", 2, 0.8125), ("m", 0, None), ("d", 3, -1.5)))
            for k in range(3, 7)
        ),
    ),
    processes=(
        ProcessRow("learner", "learner", "barn", 4199, 1512.0, 1003.0, 3021, 812, 2, 0.3),
        *(worker(index) for index in range(3)),
    ),
    alarms=("worker-2 has been silent for 7 s.",),
)


def drawn(snapshot: Snapshot, width: int = 100, height: int = 30, **settings) -> list[str]:
    """Return the lines that a console without a terminal records."""
    output = io.StringIO()
    Console(width=width, file=output, **settings).print(render(snapshot, height))
    return output.getvalue().splitlines()


def line_with(text: str, lines: list[str]) -> str:
    (line,) = (line for line in lines if text in line)
    return line


@pytest.mark.parametrize("width", [80, 100, 140])
def test_every_figure_is_shown_at_every_width(width):
    """All numbers are shown whole at 80, 100 and 140 columns, and no line is wider than the console."""
    lines = drawn(SNAPSHOT, width)
    text = "\n".join(lines)
    texts = ["farm-7", "training", "25:12 elapsed, 35:33 left", "812 of 2,000 episodes", "420.5", "-12.5", "1,250.0"]
    texts += ["960.0", "1.23", "0.57", "406,000", "1,201/s", "203,000", "1,003/s", "1.7", "2%", "41%"]
    texts += [
        "406,480",
        "3 duplicate chunks",
        "120",
        "140",
        "220",
        "6, share 0.00313",
        "learner idle",
        "episode 1,270",
        "c 2 m 0 d 3",
    ]
    texts += ["worker-0", "barn", "1:05", "600", "480", "worker-2 has been silent for 7 s."]
    texts += ["52,000"] if width >= 100 else []
    texts += ["4199", "3,019", "406", "52,480"] if width >= 140 else []
    assert [shown for shown in texts if shown not in text] == []
    assert max(map(len, lines)) <= width


@pytest.mark.parametrize("workers", [2, 60])
@pytest.mark.parametrize(("width", "height"), [(80, 24), (120, 40), (200, 60)])
def test_view_fits_the_terminal(width, height, workers):
    """With few or many processes, events and alarms the view is neither higher nor wider than the terminal."""
    crowd = tuple(worker(index) for index in range(workers))
    for alarms in ((), ("an alarm.",) * 12):
        lines = drawn(dataclasses.replace(SNAPSHOT, processes=crowd, alarms=alarms), width, height)
        assert len(lines) <= height
        assert max(map(len, lines)) <= width
        assert bool(alarms) == any("an alarm." in line for line in lines)


def test_imitation_events_say_who_was_the_elite_when_there_is_room():
    """In a high terminal each event has its episode, vartheta, and for each type the elite and its omega."""
    lines = drawn(SNAPSHOT, 120, 40)
    assert line_with("best c (score)", lines).split()[1:4] == ["event", "episode", "share"]
    assert line_with(" 640 ", lines).split()[1:-1] == ["6", "640", "0.00156", "2", "(0.81)", "0", "(-)", "3", "(-1.50)"]
    calm = dataclasses.replace(SNAPSHOT, alarms=())
    shown_at = {height: any("(score)" in line for line in drawn(calm, 80, height)) for height in (24, 32, 33, 50)}
    assert shown_at == {24: False, 32: False, 33: True, 50: True}
    assert "From 33 lines" in (Path(__file__).resolve().parents[3] / "docs" / "reference" / "monitoring.md").read_text()


def test_a_run_in_which_nobody_imitates_has_no_panel_about_it():
    """Neither without a coordinator nor while agents share their actors; the ledger takes the room."""
    for imitation in (Imitation(), Imitation(shared=True, next_episode=10)):
        lines = drawn(dataclasses.replace(SNAPSHOT, imitation=imitation), 80)
        assert not any("elite" in line for line in lines)
        assert len(line_with("ledger, steps", lines)) == 80
    for imitation in (Imitation(next_episode=10), Imitation(events=1, shared=True)):
        assert line_with("elite imitation", drawn(dataclasses.replace(SNAPSHOT, imitation=imitation), 80))


def test_what_the_actors_earn_without_noise_stands_below_the_mean():
    """Its newest value is shown, on a terminal of any size and without one; before the first nothing is."""
    seen = dataclasses.replace(SNAPSHOT, noise_free=Series("without noise", (100.0, 815.0), smoothing=1))
    for height in (24, 40):
        lines = drawn(seen, 80, height)
        assert "815" in line_with("without noise", lines)
        assert lines.index(line_with("without noise", lines)) == lines.index(line_with("mean", lines)) + 1
        assert len(lines) <= height
    assert "reward mean 420.5, without noise 815.0, communication" in summary(seen)
    assert "without noise" not in summary(SNAPSHOT) + "".join(drawn(SNAPSHOT, 80))


def test_the_end_is_never_exceeded():
    """Episodes and steps that were under way when the run ended are not shown beyond its total."""
    over = dataclasses.replace(SNAPSHOT, episodes=2016)
    assert line_with("2,000 of 2,000 episodes", drawn(over, 80))
    assert summary(dataclasses.replace(over, episodes_total=0, steps_total=406_000 - 1)).startswith(
        "training: 405,999 of 405,999 steps"
    )


def test_a_curve_is_followed_by_its_lowest_and_its_highest_value():
    """Where there is room; the values are those of the bars. In a narrow place the bars are alone."""
    texts = {}
    for width in (30, 12):
        output = io.StringIO()
        Console(width=width, file=output).print(Sparkline(tuple(map(float, range(1000, 1300))), digits=0))
        texts[width] = output.getvalue().strip()
    drawn_bars, scale = texts[30].split()
    assert (drawn_bars[0], drawn_bars[-1], scale) == ("▁", "█", "1,008..1,290")
    assert len(texts[30]) == 30
    assert texts[12] == bars(tuple(map(float, range(300))), 12)


def test_what_environments_did_is_counted_on_a_terminal_and_without_one():
    """Outages and calls that took too long stand above the processes, and in the line of plain output."""
    troubled = dataclasses.replace(SNAPSHOT, outages=2, step_timeouts=1)
    assert "2 outages, 1 step timeout" in line_with("processes (", drawn(troubled, 80))
    assert "2 outages; 1 step timeout" in summary(troubled)
    assert not any("outage" in line for line in drawn(SNAPSHOT, 80))


def test_empty_snapshot_says_what_is_not_known():
    """Before anything has happened the view shows dashes and says that no episode has ended."""
    lines = drawn(Snapshot("new"), 80)
    assert "- left" in line_with("EIA-SEC new", lines)
    assert line_with("No episode has ended yet.", lines)
    assert "-/s" in line_with("│ updates  ", lines)
    assert "processes (0)" in line_with("processes", lines)


def test_processes_in_trouble_come_first_and_the_others_are_summed():
    """Of more processes than there is room for those in trouble come first, and the last row sums what is not shown."""
    rows = [worker(index) for index in range(20)]
    rows[17] = worker(17, alive=False)
    rows[19] = worker(19, age=7.4)
    rows[11] = worker(11, trouble=True, ledger=LedgerCounts(produced=10, accepted=4, lost=6))
    table = ProcessTable(dataclasses.replace(SNAPSHOT, processes=tuple(rows)), 6)
    shown, hidden = table.parts()
    assert [row.name for row in shown] == ["worker-11", "worker-17", "worker-19", "worker-0", "worker-1"]
    assert len(hidden) == 15
    output = io.StringIO()
    Console(width=140, file=output).print(table)
    lines = output.getvalue().splitlines()
    assert "gone" in line_with("worker-17", lines)
    assert "7 s" in line_with("worker-19", lines)
    others = line_with("15 others", lines).split()
    assert {"9,006", "787k", "780k", "7,200"} <= set(others)


def test_every_kind_of_trouble_is_named():
    """Gone, silent, behind and slow workers are marked and named; many of a kind share one sentence."""
    rows = [worker(index) for index in range(12)]
    rows[1] = worker(1, alive=False)
    rows[2] = worker(2, age=7.4)
    rows[3] = worker(3, behind=BEHIND_VERSIONS)
    rows[4] = worker(4, rate=40.0)
    found, sentences = examine(rows, training=True)
    assert [row.name for row in found if row.trouble] == ["worker-1", "worker-2", "worker-3", "worker-4"]
    assert sentences == [
        "rollout worker-1 is gone.",
        "rollout worker-2 has been silent for 7 s.",
        "rollout worker-3 is behind: its actors are 20 versions old.",
        "rollout worker-4 produces 40 steps/s, the median worker 600.",
    ]
    gone = [dataclasses.replace(row, alive=False) for row in rows]
    assert examine(gone, training=True)[1] == [
        "rollout worker-0, rollout worker-1, rollout worker-2 and 9 others are gone."
    ]
    rows, sentences = examine(gone, training=False, over=True)
    assert sentences == []
    assert not any(row.trouble for row in rows)
    assert all(row.left for row in rows)
    still = [worker(index, rate=0.0) for index in range(2)]
    assert examine(still, training=True)[1] == ["rollout worker-0 and rollout worker-1 produce no steps."]
    assert examine(still, training=False)[1] == []
    assert examine([worker(index, rate=0.0, uptime=5.0) for index in range(2)], training=True)[1] == []


def test_a_worker_that_left_before_is_in_the_ledger_and_no_alarm():
    """A worker known from the learner's ledger alone has its row, comes last of all, and is not called gone."""
    left = ProcessRow(
        "rollout", "old", "-", 0, 0.0, alive=False, ledger=LedgerCounts(produced=70, accepted=70), left=True
    )
    rows, sentences = examine([left, worker(0)], training=True)
    assert sentences == []
    assert not any(row.trouble for row in rows)
    table = ProcessTable(dataclasses.replace(SNAPSHOT, processes=(*rows, worker(1), worker(2))), 3)
    assert [row.name for row in table.parts()[1]] == ["worker-2", "old"]
    shown = line_with("old", drawn(dataclasses.replace(SNAPSHOT, processes=rows), 140))
    assert shown.split()[1:7] == ["rollout", "old", "-", "-", "-", "left"]


def test_record_is_json_of_known_fields():
    """What `--json` prints has every field, the latest value of a series, and null for what is not finite."""
    odd = dataclasses.replace(SNAPSHOT, reward=(Series("mean", (float("nan"),)), Series("m", (1.0, 2.0))))
    found = json.loads(json.dumps(record(odd), allow_nan=False))
    assert set(found) == {item.name for item in dataclasses.fields(Snapshot)}
    assert found["reward"] == [{"name": "mean", "latest": None}, {"name": "m", "latest": 1.5}]
    assert found["processes"][1]["ledger"]["in_flight"] == 480
    assert found["imitation"]["newest"][0]["elites"][0] == ["c", 2, 0.8125]


@pytest.mark.parametrize(
    ("count", "text"),
    [(None, "-"), (99_999, "99,999"), (100_000, "100k"), (787_200, "787k"), (1_500_000, "1.5M"), (2**40, "1,100G")],
)
def test_counts_are_short(count, text):
    """A count is exact below 100,000 and has at most one decimal above."""
    assert short(count) == text


def test_newest_alarms_are_shown():
    """Of many alarms the newest are shown and the others counted; the higher the terminal, the more."""
    alarms = tuple(f"number-{index}." for index in range(12))
    for height, shown in ((24, 1), (60, MOST_ALARMS)):
        lines = drawn(dataclasses.replace(SNAPSHOT, alarms=alarms), height=height)
        assert line_with(f"alarms ({12 - shown} more)", lines)
        assert [line.split()[1] for line in lines if "number-" in line] == list(alarms[-shown:])


def test_trouble_in_the_ledger_is_coloured():
    """Unexplained steps are shown in red, and a ledger that closes is not."""
    closed = SNAPSHOT.ledger
    colours = {}
    for unexplained in (0, 5):
        ledger = dataclasses.replace(closed, unexplained=unexplained)
        settings = {"force_terminal": True, "color_system": "standard"}
        text = line_with("unexplained", drawn(dataclasses.replace(SNAPSHOT, ledger=ledger), **settings))
        colours[unexplained] = "\x1b[1;31munexplained" in text
    assert colours == {0: False, 5: True}


def test_names_are_not_taken_for_markup():
    """A name with brackets is shown as it is."""
    strange = worker(0, name="[red]w[/red]", host="[b]")
    line = line_with("[red]w[/red]", drawn(dataclasses.replace(SNAPSHOT, processes=(strange,)), 140))
    assert "[b]" in line


def test_ascii_console_gets_ascii():
    """A console that can write only ASCII is given nothing else."""
    raw = io.BytesIO()
    output = io.TextIOWrapper(raw, encoding="ascii", errors="strict")
    Console(width=100, file=output).print(render(SNAPSHOT))
    output.flush()
    assert b"farm-7" in raw.getvalue()


def test_summary_is_the_essence_in_one_line():
    """The summary names state, episodes, rewards, rates, time left and the number of alarms."""
    assert summary(SNAPSHOT) == (
        "training: 812 of 2,000 episodes; reward mean 420.5, communication -12.5, monitoring 1,250.0, "
        "collection 960.0; 1,201 steps/s; 1,003 updates/s; 35:33 left; 1 alarm"
    )
    in_steps = dataclasses.replace(SNAPSHOT, episodes_total=0, steps_total=1_000_000)
    assert summary(in_steps).startswith("training: 406,000 of 1,000,000 steps; ")
    assert summary(Snapshot("new")) == "starting: no report from the learner yet"


def test_latest_is_the_mean_of_the_newest_values():
    """A series' latest value is the mean of its newest 20, and None without any."""
    assert Series("x", tuple(map(float, range(100)))).latest == pytest.approx(89.5)
    assert Series("x").latest is None


@pytest.mark.parametrize(
    ("seconds", "text"),
    [(None, "-"), (-3.0, "0:00"), (59.6, "1:00"), (125.0, "2:05"), (3599.0, "59:59"), (36_061.0, "10:01:01")],
)
def test_duration(seconds, text):
    """A time span reads as m:ss or h:mm:ss."""
    assert duration(seconds) == text


@pytest.mark.parametrize(
    ("values", "width", "means"),
    [([], 5, []), ([1.0, 2.0], 5, [1.0, 2.0]), ([1.0, 3.0, 5.0, 7.0], 2, [2.0, 6.0]), ([1.0, 2.0, 6.0], 1, [3.0])],
)
def test_buckets_are_means_of_consecutive_parts(values, width, means):
    """A series longer than the width becomes the means of its parts, a shorter one stays."""
    assert buckets(values, width) == means


def test_bars_span_from_smallest_to_largest():
    """The smallest bucket has the lowest bar, the largest the highest, and a flat series lies between."""
    assert bars([0.0, 7.0, 3.0], 8) == "▁█▄"
    assert bars([5.0, 5.0], 8) == "▄▄"
    assert bars([0.0, 1.0], 8, ascii_only=True) == "_@"
    assert bars([], 8) == ""
