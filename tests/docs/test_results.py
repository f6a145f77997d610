"""The figures in README and docs are those of the committed results."""

import json
from pathlib import Path
from typing import Any

import pytest

from common.config.files import from_toml
from common.config.presets import PRESETS
from docs.tools.results import BLOCKS, HEURISTICS, NOT_MEASURED, refreshed

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize("document", BLOCKS)
def test_document_is_up_to_date(document: str) -> None:
    """The block is what `make docs` would write."""
    text = (ROOT / document).read_text(encoding="utf-8")
    assert refreshed(document, text, ROOT) == text, "run `make docs`"


@pytest.mark.parametrize("document", BLOCKS)
def test_a_block_replaces_only_itself(document: str) -> None:
    """What stands before and after the marks stays, and an old block does not."""
    name, sources, _ = BLOCKS[document]
    begin, end = f"<!-- {name}:begin -->", f"<!-- {name}:end -->"
    text = refreshed(document, f"before\n{begin}\noutdated\n{end}\nafter", ROOT)
    assert text.startswith(f"before\n{begin}\n")
    assert text.endswith(f"{end}\nafter")
    assert "outdated" not in text
    measured = all((ROOT / source).is_file() for source in sources)
    assert len(text) > 300 if measured else NOT_MEASURED in text


def test_the_cost_of_watching_tells_its_commit_when_it_is_known() -> None:
    """A file that names none is shown without; nothing is made up."""
    block = BLOCKS["docs/how-to/watch.md"][2]
    data = json.loads((ROOT / "docs" / "results" / "watch.json").read_text(encoding="utf-8"))
    without = {key: value for key, value in data.items() if key != "commit"}
    assert ", commit abc1234 (" in block({**without, "commit": "abc1234"})
    assert "commit" not in block(without)
    watched = data["watchers"][-1]
    shown = [line for line in block(without).splitlines() if line.startswith(f"| {watched['watchers']} |")]
    assert [f"{watched['watching_percent']:.2f} %" in line for line in shown] == [True]


def test_the_kept_run_is_that_of_the_default_preset() -> None:
    """What the README calls the default preset's result was made with exactly its settings."""
    kept = from_toml(ROOT / "docs" / "results" / "default" / "config.toml", PRESETS["quick"])
    assert kept == PRESETS["default"]


def test_watching_costs_the_worker_less_than_two_percent() -> None:
    """What the page says of the committed figures is what they are."""
    data = json.loads((ROOT / "docs" / "results" / "watch.json").read_text(encoding="utf-8"))
    watched = [line for line in data["watchers"] if line["watchers"]]
    assert {line["watchers"] for line in watched} >= {1, 4}
    assert all(line["watching_percent"] < 2.0 for line in watched)
    control = {**data["watchers"][0], "other_share": 0.25, "extra_percent": 7.5}
    block = BLOCKS["docs/how-to/watch.md"][2]({**data, "control": control})
    assert "busy with nothing for 25 % of its time |" in block
    assert "+7.5 %" in block


def readme_block(flown: dict[str, Any]) -> tuple[str, dict[str, Any]]:
    """Return the README's block from the default run and the smoke study, and that study."""
    folder = ROOT / "docs" / "results"
    run = json.loads((folder / "default" / "evaluation.json").read_text(encoding="utf-8"))
    study = json.loads((folder / "reproduce" / "smoke" / "training" / "results.json").read_text(encoding="utf-8"))
    seeds = {
        "methods": {
            "default preset": {
                "mean_reward": [1310.0, 1300.0, 1320.0],
                "figures": {"aoi": [0.5, 0.48, 0.51], "vdf": [1.8, 1.8, 1.8]},
                "runs": [{}] * 5,
            },
            "EIA-SEC": {"mean_reward": [1266.0, 1249.0, 1277.0]},
        },
        "sizes": {"first_farm": 1020, "farms": 80},
    }
    return BLOCKS["README.md"][2](run, study, flown, seeds), study


def test_methods_stand_in_the_order_of_their_rewards() -> None:
    """Every method of the study has a row, the best first, with the runs' commits; what it is compared with is bold."""
    text, study = readme_block(json.loads((ROOT / HEURISTICS).read_text(encoding="utf-8")))
    _, _, table = text.partition("Beside the paper's baselines")
    rows = [[cell.strip() for cell in row.split("|")[1:-1]] for row in table.splitlines() if row.startswith("|")][2:]
    wanted = sorted(study["methods"], key=lambda name: -study["methods"][name]["reward"][0])
    assert [row[0].strip("*") for row in rows] == wanted
    assert [row[0] for row in rows if row[0].startswith("**")] == ["**EIA-SEC**"]
    assert [row[0] for row in rows if not row[5]] == ["**EIA-SEC**"]
    assert f"commits {study['commit']}." in table
    assert f"{study['sizes']['episodes']} episodes and {study['sizes']['seeds']} seeds" in table


def test_the_readme_tells_where_the_policy_that_ships_stands() -> None:
    """Heuristics with a clearly higher reward are named as ahead, those within its interval as level, others not."""
    rewards = {
        "trained": (50, 45, 55),
        "high": (70, 65, 75),
        "higher": (80, 75, 85),
        "alike": (56, 52, 60),
        "low": (9, 8, 10),
    }
    results = [{"policy": name, "reward": reward} for name, reward in rewards.items()]
    text = readme_block({"first_farm": 1, "last_farm": 2, "results": results})[0].replace("\n", " ")
    assert "On farms 1..2 the policy that ships earns 50 (45..55). More earn the heuristics higher 80, high 70;" in text
    assert "as much: alike 56 (" in text
    assert "5 seeds of the preset earn 1310 (1300..1320) on farms 1020..1099 (mean; in brackets 95 % over" in text
    assert (
        "AoI 0.50 (0.48..0.51), VDF 1.80; with the settings of the comparison below it is 1266 (1249..1277) (" in text
    )
