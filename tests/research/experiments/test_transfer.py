"""A policy that flies fields and teams that it was not trained for."""

import json
import sys

from research.experiments import transfer
from research.experiments.transfer import FIELDS, TEAMS, configuration, main, places


def test_places_are_the_files_fields_and_the_teams():
    """Every field and every team is there once, and differs from the others in what its name says."""
    farm = configuration(1, 0, random_teams=True).farm
    found = places(farm)
    assert found == places(configuration(1, 0).farm)
    assert len(found) == len(FIELDS) + len(TEAMS)
    assert len({place.world.sensors for place in found.values()}) == 1 + len(FIELDS)
    assert [place.world.counts for place in found.values()][-len(TEAMS) :] == list(TEAMS)
    assert not farm.observation.identity
    assert farm.failures.missing
    assert farm.world.counts == (8, 8, 8)
    assert not any(place.failures.some for place in found.values())
    assert {place.world.counts for place in list(found.values())[: len(FIELDS)]} == {(4, 4, 4)}


def test_one_policy_flies_everywhere(monkeypatch, tmp_path, capsys):
    """The page has a row for each place with both sides and their ratio."""
    tiny = (
        "[farm.world]\nsteps = 40\n[rollout]\nenvironments = 2\nchunk_steps = 40\n[algorithm]\niteration_steps = 80\n"
    )
    monkeypatch.setattr(transfer, "ANY_TEAM", tiny + "[farm.observation]\nidentity = false")
    monkeypatch.setattr(transfer, "FIELDS", ("orchard",))
    monkeypatch.setattr(transfer, "TEAMS", ((1, 2, 3),))
    monkeypatch.setattr("research.experiments.conditions.TASKS", ("greedy",))
    monkeypatch.setattr(sys, "argv", ["transfer", "--episodes", "4", "--farms", "1000:1002", "--write", str(tmp_path)])
    main()
    found = json.loads((tmp_path / "results.json").read_text())["results"]
    text = (tmp_path / "README.md").read_text()
    assert list(found) == ["orchard, 340 m x 306 m, 45 sensors", "team 1 + 2 + 3"]
    for name, scores in found.items():
        ratio = scores["policy"]["reward"][0] / scores["heuristic"]["reward"][0]
        assert f"| {name} |" in text
        assert f"| greedy | {scores['policy']['reward'][0]:.0f} " in text
        assert f"| {ratio:.3f} |" in text
