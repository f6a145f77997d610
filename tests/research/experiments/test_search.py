"""What a harder search gives."""

from eia_sec.common.config.presets import preset
from eia_sec.rollout.heuristics.tasks.horizon import EFFORT
from research.experiments.search import FORMS, fly, forms, page
from tests.rollout.heuristics.small_farm import SMALL


def test_a_harder_search_flies_otherwise(monkeypatch):
    """With the heuristic's own effort it earns the same, with another it does not, and monitors search where asked."""
    flown = {form: fly(SMALL, form, range(2)) for form in list(FORMS)[:2]}
    monkeypatch.setitem(FORMS, "equal", {"collectors": EFFORT})
    monkeypatch.setitem(FORMS, "all", {"collectors": EFFORT, "monitors": EFFORT})
    plain, wide = flown.values()
    equal, whole = fly(SMALL, "equal", range(2)), fly(SMALL, "all", range(2))
    parts = ("reward", "communication", "monitoring", "collection", "aoi", "vdf")
    assert [equal[part] for part in parts] == [plain[part] for part in parts]
    assert wide["collection"] != plain["collection"]
    assert (whole["monitoring"] != plain["monitoring"], whole["collection"] == plain["collection"]) == (True, True)
    data = {"command": "python -m research.experiments.search", "commit": "abc", "preset": "uneven", "farms": [0, 1]}
    text = page({**data, "results": [{**plain, "reward": 100.0}, {**wide, "reward": 103.0}]})
    assert "1.030 times" in text
    assert "farms 0..1 of the preset `uneven`" in text
    assert text.count("\n| ") == 3


def test_only_forms_that_search_harder_are_flown():
    """Where the heuristic itself keeps many paths, a form with as many shows nothing."""
    assert forms(preset("study").farm) == list(FORMS)
    assert forms(preset("uneven").farm) == [form for form in FORMS if form != "256 paths"]
