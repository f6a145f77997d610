"""The pages that are written from committed results are up to date, and say what the results are made from."""

import re
from pathlib import Path

import pytest

from research.pages.reproduce_tables import BLOCKS, RESULTS, SHOWN, written
from research.studies.analysis.targets import block as targets_block
from research.studies.analysis.verdicts import NOT_RUN
from research.studies.pages.notes import TEMPLATE, note

ROOT = Path(__file__).resolve().parents[3]
KEPT = sorted(path.parent.relative_to(ROOT / RESULTS).as_posix() for path in (ROOT / RESULTS).rglob("results.json"))


@pytest.mark.parametrize("name", KEPT)
def test_a_studys_page_is_written_from_its_results(name):
    """The page beside each results.json is what its table and notes come to today, and all pictures are on it."""
    folder = ROOT / RESULTS / name
    text = (folder / "README.md").read_text(encoding="utf-8")
    assert sorted(SHOWN.findall(text)) == sorted(path.name for path in folder.glob("*.png"))
    assert written(folder) == text, "run `make docs`"


def flown(policy, reward, aoi):
    around = (aoi, aoi - 0.01, aoi + 0.01)
    rewards = (reward, reward - 5.0, reward + 5.0)
    return {"policy": policy, "reward": rewards, "aoi": around, "vdf": around, "per_farm": [0.0] * 20 + [reward] * 80}


def reach(*runs):
    points = [
        {"software": software, "points": [{"seconds": at, "steps": 1, "reward": reward} for at, reward in course]}
        for software, course in runs
    ]
    return {"bar": 1000.0, "runs": points}


def verdicts(text, word):
    return [
        line.rsplit("| **", 1)[1].rstrip("* |") for line in text.splitlines() if line.startswith("|") and word in line
    ]


def test_targets_are_met_only_by_the_whole_interval():
    """Reward against the best heuristic and the supply bound, AoI and VDF against all of them; nothing else is met."""
    good = {"results": [flown("trained:instant", 1600.0, 0.4), flown("horizon", 1400.0, 0.5)], "last_farm": 1099}
    text = targets_block(good, None, None)
    assert verdicts(text, "the policy that ships") == ["met"] * 4
    assert verdicts(text, "seeds of") == ["not measured"] * 4
    assert "1540 (horizon 1400)" in text
    assert "1600 (1595..1605); 1600 on 1020..1099" in text
    close = {"results": [flown("trained:instant", 1278.0, 0.4), flown("horizon", 1164.0, 0.415)], "last_farm": 1099}
    assert verdicts(targets_block(close, None, None), "the policy that ships") == ["not met"] * 4
    assert "0 of 12 met." in targets_block(close, None, None)


def test_the_seeds_of_the_preset_eia_sec_are_judged_by_their_interval():
    """Their mean reward, AoI and VDF stand beside the study's own heuristics, not beside those flown elsewhere."""
    study = {
        "references": {
            "best": "horizon",
            "policies": {"horizon": {"reward": 1400.0, "metrics": {"aoi": 0.5, "vdf": 2.0}}},
        },
        "methods": {
            "preset eia-sec": {
                "mean_reward": [1530.0, 1280.0, 1600.0],
                "metrics": {"aoi": [0.45, 0.4, 0.49], "vdf": [1.9, 1.8, 2.1]},
                "runs": [{}] * 5,
            },
            "EIA-SEC": {"mean_reward": [0.0] * 3, "metrics": {"aoi": [9.0] * 3, "vdf": [9.0] * 3}, "runs": []},
        },
        "scale": "full",
        "sizes": {"first_farm": 1020},
    }
    text = targets_block(None, study, None)
    assert verdicts(text, "seeds of") == ["not met", "met", "met", "not met"]
    assert "| 1540 (horizon 1400) | 1530 (1280..1600), 5 seeds; on farms from 1020 on |" in text
    assert "| below 0.50 (horizon) | 0.45 (0.40..0.49) |" in text
    assert verdicts(text, "the policy that ships") == ["not measured"] * 4


def test_sooner_means_ten_times():
    """A peer that never got there counts by the time that it was given; nothing is met where ours did not get there."""
    ours = ("EIA-SEC", [(10.0, 600.0), (20.0, 800.0)])
    late, never = ("AgileRL", [(150.0, 600.0), (190.0, 800.0)]), ("BenchMARL", [(60.0, 600.0), (300.0, 700.0)])
    text = targets_block(None, None, reach(ours, late, never))
    assert verdicts(text, "than AgileRL") == ["met", "not met", "not met", "not met"]
    assert verdicts(text, "than BenchMARL") == ["not met", "met", "not met", "not met"]
    assert "ours not within 20 s" in text
    short = ("BenchMARL", [(60.0, 400.0)])
    assert verdicts(targets_block(None, None, reach(ours, short)), "than BenchMARL")[0] == "undecided"


def test_runs_of_more_time_decide_about_the_whole():
    """What was tried for longer shows that the last part takes ten times as long; other parts have more seeds."""
    short = reach(("EIA-SEC", [(10.0, 1000.0)]), ("AgileRL", [(50.0, 600.0)]))
    longer = reach(("EIA-SEC", [(11.0, 1000.0)]), ("AgileRL", [(120.0, 600.0)]))
    assert verdicts(targets_block(None, None, short), "than AgileRL") == ["not met", *["undecided"] * 3]
    assert verdicts(targets_block(None, None, short, longer), "than AgileRL") == [
        "not met",
        *["undecided"] * 2,
        "met",
    ]


def test_the_slowest_of_ours_and_the_fastest_of_theirs_decide():
    """Medians that are ten times apart are not enough when some pair of seeds is nearer, or may be."""

    def judged_times(*theirs):
        runs = [("BenchMARL", course) for course in theirs]
        text = targets_block(None, None, reach(*(("EIA-SEC", [(at, 700.0)]) for at in (10.0, 12.0, 17.0)), *runs))
        (line,) = (line for line in text.splitlines() if line.startswith("| 50%"))
        return line, verdicts(text, "than BenchMARL")[0]

    def reached(*times):
        return [[(at, 700.0)] for at in times]

    line, verdict = judged_times(*reached(170.0, 180.0, 300.0))
    assert ("15.0 times (10.0..30.0), ours in 12 s; 3 seeds" in line, verdict) == (True, "met")
    line, verdict = judged_times(*reached(150.0, 180.0, 300.0))
    assert ("15.0 times (8.8..30.0)" in line, verdict) == (True, "undecided")
    assert judged_times(*reached(50.0, 60.0, 90.0))[1] == "not met"
    line, verdict = judged_times([(480.0, 0.0)], *reached(160.0, 180.0))
    assert ("| 15.0 times (9.4..)" in line, verdict) == (True, "undecided")
    line, verdict = judged_times(*[[(480.0, 0.0)]] * 2, *reached(160.0))
    assert ("| more than 40.0 times (9.4..)" in line, verdict) == (True, "undecided")
    assert judged_times([(480.0, 0.0)], [(300.0, 700.0)], [(200.0, 0.0)])[1] == "met"


@pytest.mark.parametrize("name", BLOCKS)
def test_a_repository_without_results_says_so(name, tmp_path):
    """A block whose results are missing says that they are, and shows no number."""
    text = BLOCKS[name](tmp_path)
    assert any(word in text for word in (NOT_RUN, "not measured", "has not been counted"))


def test_every_note_has_its_values_and_a_missing_one_is_an_error():
    """A page never shows a brace that nobody filled in."""
    values = {"first": 1, "last": 2, "statistic": "x", "level": "95%", "band": "5%", "tail": "10%", "groups": "A: b"}
    names = re.findall(r"^## (\w+)$", TEMPLATE.read_text(encoding="utf-8"), re.MULTILINE)
    assert len(names) >= 8
    assert not any("{" in note(name, **values) for name in names)
    with pytest.raises(KeyError):
        note("nothing")
    with pytest.raises(KeyError):
        note("legend")
