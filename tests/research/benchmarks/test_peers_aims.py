"""What the page of the side-by-side benchmarks says of aims and of how updates were timed, and how it is made anew."""

import json

import pytest

from research.benchmarks.peers import __main__ as driver
from research.benchmarks.peers import report
from research.benchmarks.peers.summary import learner_aims, merged
from tests.research.benchmarks.test_peers import learner_line, recorded_result


def aimed_lines(width: int, over: float, maddpg: float, masac: float) -> list[dict]:
    """Return our updates of 2 ms beside those of BenchMARL, merged, with a limit that EIA-SEC's is so many times of."""
    ours = [{**learner_line("EIA-SEC", name, 2.0, width=width), "burst": 2} for name in ("eia-sec", "maddpg", "masac")]
    ours[0]["limit_ms"] = 2.0 / over
    forms = [("groups", 99.0), ("one group", maddpg)]
    theirs = [learner_line("BenchMARL", "MADDPG", ms, form, width) for form, ms in forms]
    return merged([*ours, *theirs, learner_line("BenchMARL", "MASAC", masac, "groups", width)])


def test_an_aim_is_met_where_every_algorithm_reaches_it():
    """Verdicts come from the best values of equal algorithms; a width without an aim of its own gets none."""
    found = learner_aims([*aimed_lines(64, 1.9, 8.0, 9.0), *aimed_lines(128, 1.7, 8.0, 7.9)])
    found += learner_aims(aimed_lines(256, 1.2, 1.0, 1.0))
    assert [(line["width"], line["against"], line["aim"], line["met"]) for line in found] == [
        (64, "BenchMARL", 4.0, True),
        (64, "limit", 2.0, True),
        (128, "BenchMARL", 4.0, False),
        (128, "limit", 1.6, False),
        (256, "BenchMARL", 4.0, False),
        (256, "limit", None, None),
    ]
    assert found[2]["ratios"] == {"MADDPG": 4.0, "MASAC": pytest.approx(3.95)}
    assert found[3]["ratios"] == {"eia-sec": pytest.approx(1.7)}


def test_the_page_shows_aims_with_their_verdicts():
    """A row for each width, a column for each peer that was measured; without EIA-SEC there is no table."""
    lines = [*aimed_lines(64, 1.9, 8.0, 9.0), *aimed_lines(256, 1.2, 1.0, 1.0)]
    rows = [row for row in report.aims_table(lines) if row.startswith("| ")]
    assert rows == [
        "| threads | width | BenchMARL, at least 4 x | EIA-SEC by its limit |",
        "| --- | --- | --- | --- |",
        "| 1 | 64 | met: 4.00 (MADDPG), 4.50 (MASAC) | met: 1.90, at most 2 |",
        "| 1 | 256 | not met: 0.50 (MADDPG), 0.50 (MASAC) | 1.20, no aim |",
    ]
    assert report.aims_table([line for line in lines if line["software"] != "EIA-SEC"]) == []


def test_results_of_single_updates_are_reported():
    """As soon as every line of ours names its burst, nothing is said of single updates."""
    lines = aimed_lines(64, 1.9, 8.0, 9.0)
    assert report.burst_note(lines) == []
    (old, *others) = lines
    without = [{name: value for name, value in old.items() if name != "burst"}, *others]
    assert "fastest single update" in report.burst_note(without)[0]
    assert "fastest single update" in report.block({**recorded_result(), "learner": without})


def test_a_page_is_made_anew_without_measuring(tmp_path, monkeypatch, capsys):
    """`--redraw` changes picture and page alone, and needs a result."""
    monkeypatch.setattr("sys.argv", ["peers", "--write", str(tmp_path), "--redraw"])
    with pytest.raises(SystemExit) as ended:
        driver.main()
    assert ended.value.code == 2
    assert capsys.readouterr().err == "--redraw needs --write FOLDER with a peers.json in it.\n"
    data = json.dumps(recorded_result())
    (tmp_path / "peers.json").write_text(data)
    driver.main()
    assert (tmp_path / "peers.json").read_text() == data
    assert report.block(recorded_result()) in (tmp_path / "README.md").read_text()
    assert (tmp_path / "peers.png").is_file()
