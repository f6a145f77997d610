"""Where learning pays."""

import json
import re
import sys

import numpy as np
import pytest

from eia_sec.common.config.presets import preset
from eia_sec.common.errors import UsageError
from eia_sec.common.farm import farm_team
from eia_sec.common.policy_file import load_policy
from eia_sec.deploy.local.in_process import train_in_process
from eia_sec.rollout.policies import policy_of
from eia_sec.rollout.start_policy import start_parameters
from research.experiments import condition_farms, conditions
from research.experiments.condition_farms import CONDITIONS, configuration, longer_configuration
from research.experiments.conditions import (
    POLICIES,
    Episodes,
    best_heuristics,
    compare,
    flown,
    kept,
    main,
    own_reward,
    page,
    policy_file,
)

TINY = "[farm.world]\nsteps = 40\n[rollout]\nenvironments = 2\nchunk_steps = 40\n[algorithm]\niteration_steps = 80"


def test_every_policy_has_a_file_of_its_own():
    """Names of conditions with spaces, commas and slashes give plain file names."""
    names = {policy_file(name, policy) for name in CONDITIONS for policy in POLICIES}
    assert len(names) == len(CONDITIONS) * len(POLICIES)
    assert all(re.fullmatch(r"[a-z0-9-]+\.safetensors", name) for name in names)


def test_heuristics_charge_by_themselves(monkeypatch):
    """Autopilots do not interfere with the bar."""
    flew = []
    monkeypatch.setattr(conditions, "TASKS", ("greedy",))
    monkeypatch.setattr(conditions, "flown", lambda farm, *_: flew.append(farm.battery) or {"reward": [1.0]})
    best_heuristics(preset("battery").farm, range(1))
    assert (flew[0].some, flew[0].watched) == (True, False)


def test_every_condition_is_a_run():
    """Each can be configured and begun; the range of links is what its name says."""
    for name in CONDITIONS:
        config, longer = configuration(name, 7, 3), longer_configuration(name, 3)
        assert (config.episodes, config.seed, longer.seed) == (7, 3, 3)
        for run in (config, longer):
            found = start_parameters(run, farm_team(run.farm))
            assert any(flat is not None for flat in found) == any(run.on_policy.start_policy.values())
        if name.startswith("links"):
            assert config.farm.relay.require_link
            assert f"links {config.farm.relay.link_range:.0f} m" in name


def test_pay_for_links_does_not_count():
    """The same flight earns more on the farm that pays relays for links."""
    farm = preset("connected").farm
    policy = policy_of("tour", farm)
    assert own_reward(farm).reward.relayed == 0.0 < farm.reward.relayed
    assert flown(farm, policy, "tour", range(1000, 1001)) == flown(own_reward(farm), policy, "tour", range(1000, 1001))


@pytest.fixture
def tiny(monkeypatch):
    """Replace the conditions by one that takes a second, and the heuristics by one."""
    for module in (conditions, condition_farms):
        monkeypatch.setattr(module, "CONDITIONS", {"tiny": ("connected", TINY), "other": ("instant", TINY)})
    monkeypatch.setattr(conditions, "TASKS", ("greedy",))


def test_a_condition_is_trained_and_compared(tiny, tmp_path):
    """Both sides have rewards, and the page says who won."""
    found = compare("tiny", {"commit": "d"}, Episodes(4, 8), 0, range(1000, 1002), tmp_path / "policies")
    assert found["learned"]["steps"] == 160
    assert found["longer"]["steps"] == 320
    longer = load_policy(tmp_path / "policies" / "tiny-longer.safetensors")
    assert longer[1]["episodes"] == "8"
    own = train_in_process(configuration("tiny", 8, 0)).actors()
    for kept_flat, flat in zip(longer[0].flat, own.flat, strict=True):
        np.testing.assert_allclose(kept_flat, flat, rtol=2e-3, atol=1e-4)
    assert [scores["policy"] for scores in found["heuristics"]] == ["greedy"]
    origin = {"command": "c", "commit": "d", "farms": [1000, 1001], "episodes": 4, "seed": 0}
    text = page({**origin, "results": {"tiny": found}})
    for policy in ("learned", "longer"):
        assert f"| {found[policy]['reward'][0] / found['heuristics'][0]['reward'][0]:.3f} |" in text
    alone = {name: scores for name, scores in found.items() if name != "longer"}
    assert "| - | - |" in page({**origin, "results": {"tiny": found, "other": alone}})
    assert "| longer |" not in page({**origin, "results": {"tiny": alone}})


def test_new_heuristics_replace_the_old_ones():
    """What the page says was measured where goes with them."""
    found = {"commit": "a, heuristics c, longer d", "learned": {}, "heuristics": []}
    assert conditions.with_new_bar(found, "e") == {"learned": {}, "commit": "a, longer d, heuristics e"}


def test_what_was_measured_is_kept(tiny, monkeypatch, tmp_path, capsys):
    """A second call measures what is missing, and a named condition anew."""
    measured = []
    score = {"policy": "greedy", "reward": [1.0, 1.0, 1.0], "types": {"c": 1.0}, "aoi": 1.0, "vdf": 1.0}

    def once(config, farms, name, keep):
        measured.append(f"{name} {config.farm.relay.require_link}")
        return {**score, "seconds": 1.0, "steps": 1}

    monkeypatch.setattr(conditions, "trained", once)
    monkeypatch.setattr(conditions, "best_heuristics", lambda farm, farms: [score])
    for words in ([], [], ["tiny"]):
        monkeypatch.setattr(sys, "argv", ["conditions", *words, "--write", str(tmp_path)])
        main()
    assert measured == ["learned True", "learned False", "learned True"]
    monkeypatch.setattr(sys, "argv", ["conditions", "--heuristics", *conditions.CONDITIONS, "--write", str(tmp_path)])
    main()
    assert len(measured) == 3
    for found in kept(tmp_path).values():
        assert found["commit"].count("heuristics") == 1
    monkeypatch.setattr(sys, "argv", ["conditions", "--longer", "tiny", "--write", str(tmp_path)])
    main()
    main()
    assert measured[3:] == ["longer True", "longer True"]
    parts = kept(tmp_path)["tiny"]["commit"].split(", ")
    assert [part.partition(" ")[0] for part in parts[1:]] == ["heuristics", "longer"]
    assert "longer" not in kept(tmp_path)["other"]
    assert list(kept(tmp_path)) == ["tiny", "other"]
    assert json.loads((tmp_path / "results.json").read_text())["seed"] == 0
    monkeypatch.setattr(sys, "argv", ["conditions", "nothing"])
    with pytest.raises(SystemExit):
        main()
    monkeypatch.setattr(sys, "argv", ["conditions", "tiny", "--farms", "5:7", "--write", str(tmp_path)])
    with pytest.raises(UsageError, match="of other farms"):
        main()


def test_policies_of_other_seeds_are_added(tiny, monkeypatch, tmp_path, capsys):
    """Their mean makes the ratio; a seed that is there is replaced, and the first one's own is refused."""
    score = {"policy": "greedy", "types": {"c": 1.0}, "aoi": 1.0, "vdf": 1.0, "seconds": 1.0, "steps": 1}

    def of_seed(config, farms, name, keep=None):
        return {**score, "reward": [100.0 + 10.0 * config.seed] * 3, "seed": config.seed}

    monkeypatch.setattr(conditions, "trained", of_seed)
    monkeypatch.setattr(conditions, "best_heuristics", lambda farm, farms: [{**score, "reward": [100.0] * 3}])

    def call(*words):
        monkeypatch.setattr(sys, "argv", ["conditions", *words, "--write", str(tmp_path)])
        return main()

    with pytest.raises(UsageError, match="hold no policy 'learned' of 'tiny'"):
        call("tiny", "--another", "1")
    call("tiny", "--longer")
    call("other")
    for seed in ("2", "1", "2"):
        call("tiny", "--longer", "--another", seed)
    call("tiny", "--another", "3")
    found = kept(tmp_path)
    assert [other["seed"] for other in found["tiny"]["longer"]["others"]] == [1, 2]
    assert [other["seed"] for other in found["tiny"]["learned"]["others"]] == [3]
    assert "others" not in found["other"]["learned"]
    text = (tmp_path / "README.md").read_text()
    assert "| 100, 130 | 1.150 | 100, 110, 120 | 1.100 |" in text
    assert text.count("learned 3 ") == text.count("longer 2 ") == 1
    with pytest.raises(UsageError, match="has seed 0 already"):
        call("tiny", "--another", "0")
    with pytest.raises(UsageError, match="hold no policy 'longer' of 'other'"):
        call("tiny", "other", "--longer", "--another", "4")
    assert [other["seed"] for other in kept(tmp_path)["tiny"]["longer"]["others"]] == [1, 2]
    for words in (["--another", "1"], ["tiny", "--another", "1", "--heuristics"]):
        with pytest.raises(SystemExit):
            call(*words)
