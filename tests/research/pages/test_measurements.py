"""The numbers in README and docs are those of the committed results."""

import json
from pathlib import Path
from typing import Any

import pytest

from eia_sec.common.config.files import read_saved
from eia_sec.common.config.presets import PRESETS
from research.pages.measurements import HEURISTICS, MEASUREMENTS, NOT_MEASURED, measured, watch_block
from research.pages.readme_results import default_block, results_block
from research.studies.methods import TUNED_PRESET

ROOT = Path(__file__).resolve().parents[3]


@pytest.mark.parametrize("name", MEASUREMENTS)
def test_a_measurement_that_was_not_made_is_said(name: str, tmp_path: Path) -> None:
    """Without its data a block says so; with it there is more to read."""
    assert measured(name, tmp_path) == NOT_MEASURED
    assert len(measured(name, ROOT)) > 100


def test_the_cost_of_watching_names_its_commit_when_it_is_known() -> None:
    """A file that names none is shown without; nothing is made up."""
    data = json.loads((ROOT / "research" / "results" / "watch.json").read_text(encoding="utf-8"))
    without = {key: value for key, value in data.items() if key != "commit"}
    assert ", commit abc1234 (" in watch_block({**without, "commit": "abc1234"})
    assert "commit" not in watch_block(without)
    watched = data["watchers"][-1]
    shown = [line for line in watch_block(without).splitlines() if line.startswith(f"| {watched['watchers']} |")]
    assert [f"{watched['watching_percent']:.2f} %" in line for line in shown] == [True]


@pytest.mark.parametrize("name", ["default", "eia-sec"])
def test_a_kept_run_is_that_of_its_preset(name: str) -> None:
    """What the pages call the result of a preset was made with exactly its settings."""
    assert read_saved(ROOT / "research" / "results" / name / "config.toml") == PRESETS[name]


def test_watching_costs_the_worker_less_than_two_percent() -> None:
    """What the page says of the committed numbers is what they are."""
    data = json.loads((ROOT / "research" / "results" / "watch.json").read_text(encoding="utf-8"))
    watched = [line for line in data["watchers"] if line["watchers"]]
    assert {line["watchers"] for line in watched} >= {1, 4}
    assert all(line["watching_percent"] < 2.0 for line in watched)
    control = {**data["watchers"][0], "other_share": 0.25, "extra_percent": 7.5}
    block = watch_block({**data, "control": control})
    assert "loops idly for 25 % of its time |" in block
    assert "+7.5 %" in block


def results() -> tuple[dict[str, Any], dict[str, Any], dict[str, Any], dict[str, Any]]:
    """Return the default run, the smoke study of methods, every policy as flown, and a study of `eia-sec`."""
    folder = ROOT / "research" / "results"
    files = ("default/evaluation.json", "reproduce/smoke/training/results.json")
    run, study = (json.loads((folder / file).read_text(encoding="utf-8")) for file in files)
    flown = json.loads((ROOT / HEURISTICS).read_text(encoding="utf-8"))
    own = {
        "mean_reward": [1310.0, 1300.0, 1320.0],
        "metrics": {"aoi": [0.5, 0.48, 0.51], "vdf": [1.8, 1.8, 1.8]},
        "runs": [{}] * 5,
    }
    policies = {
        "high": {"mean_reward": 1321.0, "metrics": {"aoi": 0.1, "vdf": 0.2}},
        "level": {"mean_reward": 1320.0, "metrics": {"aoi": 0.1, "vdf": 0.2}},
    }
    seeds = {
        "methods": {TUNED_PRESET: own},
        "references": {"policies": policies},
        "sizes": {"first_farm": 1020, "farms": 80},
    }
    return run, study, flown, seeds


def default_seeds() -> dict[str, Any]:
    """Return two seeds of the default preset."""
    runs = [
        {"reward": {"mean": mean}, "seconds": seconds, "reached": {"0.5": 9.0, "0.75": 20.4, "0.9": 61.0, "1": full}}
        for mean, seconds, full in ((1303.0, 300.0, 200.0), (1321.0, 420.0, None))
    ]
    size = {"first_farm": 1020, "farms": 80, "lawnmower": 1394.0, "command": "x", "commit": "abc", "runs": runs}
    return {**size, "reward": [1312.0, 1303.0, 1320.0], "aoi": [0.4, 0.3, 0.5], "vdf": [1.7, 1.6, 1.8]}


def test_seeds_of_the_default_preset_are_shown_with_their_slowest() -> None:
    """A share that one seed never reaches is never reached."""
    run, study, flown, seeds = results()
    text = " ".join(default_block(run, study, flown, seeds, default_seeds()).split())
    assert "2 seeds score 1312 (1303..1320) on farms 1020..1099 (each: 1303, 1321; the lawnmower 1394)" in text
    assert "after 5 to 7 minutes each. The slowest needs 9, 20, 61, never seconds" in text
    beside = {**default_seeds(), "runs": [{**run, "at_once": 2} for run in default_seeds()["runs"]]}
    text = " ".join(default_block(run, study, flown, seeds, beside).split())
    assert "after 5 to 7 minutes each, up to 2 at a time. The slowest needs 9," in text


def long_seeds() -> dict[str, Any]:
    """Return one seed of the preset `long`, which scores as much as one heuristic."""
    return {**default_seeds(), "runs": default_seeds()["runs"][:1], "reward": [1320.6] * 3}


def rows_of(text: str) -> list[list[str]]:
    """Return the cells of a text's tables, heads and rules left out."""
    rows = [[cell.strip() for cell in row.split("|")[1:-1]] for row in text.splitlines() if row.startswith("|")]
    return [row for number, row in enumerate(rows) if number > 1 and not row[0].startswith("---")]


def test_the_readme_orders_policies_by_reward_and_names_those_ahead() -> None:
    """Learned methods and heuristics share one table, best first; those ahead of the default preset are named."""
    _, study, _, seeds = results()
    text = results_block(study, seeds, default_seeds(), long_seeds())
    rows = rows_of(text)
    assert [row[0] for row in rows][:3] == ["high, heuristic", "**IPPO, preset `long`**", "level, heuristic"]
    assert rows[1][1] == "1321"
    assert [row[0] for row in rows][3:5] == ["**IPPO, default preset**", "EIA-SEC, preset `eia-sec`"]
    assert [row[1] for row in rows[3:5]] == ["1312 (1303..1320)", "1310 (1300..1320)"]
    assert {row[0].partition(",")[0] for row in rows if "heuristic" not in row[0]} >= set(study["methods"])
    rewards = [float(row[1].partition(" ")[0]) for row in rows]
    assert rewards == sorted(rewards, reverse=True)
    words = " ".join(text.split())
    assert "**Of 2 heuristics, these score higher than `long`: none; than the default preset: high.**" in words
    assert "Level with `long`: high. Level with the default preset: level." in words
    assert "2 or 5 seeds (`long`: 1)" in words


def test_methods_stand_in_the_order_of_their_rewards() -> None:
    """Every method of the study has a row, the best first, with the runs' commits; what it is compared with is bold."""
    run, study, flown, seeds = results()
    _, _, part = default_block(run, study, flown, seeds, default_seeds()).partition("The methods of the paper")
    rows = rows_of(part)
    wanted = sorted(study["methods"], key=lambda name: -study["methods"][name]["reward"][0])
    assert [row[0].strip("*") for row in rows] == wanted
    assert [row[0] for row in rows if row[0].startswith("**")] == ["**EIA-SEC**"]
    assert [row[0] for row in rows if not row[5]] == ["**EIA-SEC**"]
    words = " ".join(part.split())
    assert f"commits {study['commit']}." in words
    assert f"{study['sizes']['episodes']} episodes and {study['sizes']['seeds']} seeds" in words


def test_the_policy_that_ships_is_ranked() -> None:
    """Heuristics with a clearly higher reward are named as ahead, those within its interval as level, others not."""
    run, study, _, seeds = results()
    rewards = {
        "trained": (50, 45, 55),
        "high": (70, 65, 75),
        "higher": (80, 75, 85),
        "alike": (56, 52, 60),
        "low": (9, 8, 10),
    }
    found = [{"policy": name, "reward": reward} for name, reward in rewards.items()]
    flown = {"first_farm": 1, "last_farm": 2, "results": found}
    text = default_block(run, study, flown, seeds, default_seeds()).replace("\n", " ")
    assert "The policy that ships scores 50 (45..55) on farms 1..2." in text
    assert "score higher: higher 80, high 70. Level with it: alike 56." in text
    assert "5 seeds of the preset `eia-sec` score 1310 (1300..1320) on farms 1020..1099" in text
    assert "AoI 0.50 (0.48..0.51), VDF 1.80 (" in text
