"""Demonstrations: what is recorded, what a file may hold, and heuristics named by their place."""

from dataclasses import replace

import numpy as np
import pytest
from mytask.heuristics import Nearest

from eia_sec.common.config.presets import preset
from eia_sec.common.errors import ConfigError, PluginError, PolicyError
from eia_sec.common.farm import farm_team
from eia_sec.common.team import GroupSpec, TeamSpec
from eia_sec.rollout.demonstrations import (
    Demonstrations,
    load_demonstrations,
    recorded,
    require_team,
    save_demonstrations,
)
from eia_sec.rollout.heuristics.random import RandomPolicy
from eia_sec.rollout.policies import run_policy

COVER = preset("generic").with_environment("mytask.env:Cover")
LIGHTS = preset("generic").with_environment("pictures.env:Lights")
TEAM = TeamSpec((GroupSpec("chooser", 1, 3, 2, choices=(2, 3)), GroupSpec("walker", 2, 2, 1)))


def some(**changed):
    """Return demonstrations of a team with choices and continuous actions."""
    draw = np.random.default_rng(0)
    action = np.concatenate([draw.integers(0, 2, (9, 2)), draw.uniform(-1, 1, (9, 2))], axis=1).astype(np.float32)
    found = Demonstrations(TEAM, draw.standard_normal((9, 7)).astype(np.float32), action, {"policy": "mine"})
    return replace(found, **changed)


def test_every_step_of_every_episode_is_recorded(tmp_path):
    """The rows are what the heuristic saw and did; a file gives them back."""
    found = recorded(COVER, Nearest(), 40, "nearest")
    assert found.observation.shape == (800, 8)
    assert found.metadata["episodes"] == "40"
    offsets = found.observation.reshape(-1, 2, 4)[..., :2]
    nearest = np.take_along_axis(offsets, np.abs(offsets).argmin(axis=2)[..., None], axis=2)[..., 0]
    np.testing.assert_array_equal(found.action, np.sign(nearest) + 1)
    save_demonstrations(path := tmp_path / "demos.safetensors", found)
    again = load_demonstrations(path)
    assert (again.team, again.metadata) == (found.team, found.metadata)
    np.testing.assert_array_equal(again.observation, found.observation)
    np.testing.assert_array_equal(again.action, found.action)
    with pytest.raises(PolicyError, match=r"is of 2 walker agents .*, and this run trains 1 chooser agents"):
        require_team(again, TEAM, path)


def test_pictures_are_recorded_as_bytes(tmp_path):
    """A byte for each channel of a pixel, in the file as well."""
    found = recorded(LIGHTS, RandomPolicy(), 2, "random")
    save_demonstrations(path := tmp_path / "demos.safetensors", found)
    assert load_demonstrations(path).observation.dtype == np.uint8
    assert path.stat().st_size < 40 * (216 + 8) + 2000


def test_the_farm_is_not_recorded():
    """Its heuristics choose velocities, and actors do not."""
    assert any(group.adapters for group in farm_team(preset("instant").farm).groups)
    with pytest.raises(ConfigError, match="policies cannot be recorded on the farm"):
        recorded(preset("instant"), RandomPolicy(), 1, "random")


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"observation": np.zeros((9, 6), np.float32)}, r"its observation is F32\[9, 6\], not F32\[rows, 7\]"),
        ({"observation": np.zeros((9, 7), np.uint8)}, r"its observation is U8\[9, 7\], not F32"),
        ({"observation": np.zeros((8, 7), np.float32)}, r"its observation is F32\[8, 7\]"),
        ({"observation": np.full((9, 7), np.nan, np.float32)}, "an observation is not finite"),
        ({"action": np.full((9, 4), 0.5, np.float32)}, "is not the index of an option"),
        ({"action": np.full((9, 4), 2.0, np.float32)}, "an action lies outside"),
        ({"action": np.zeros((0, 4), np.float32), "observation": np.zeros((0, 7), np.float32)}, "it holds no step"),
    ],
)
def test_files_that_hold_something_else_are_refused(tmp_path, changed, said):
    """Shapes, types and numbers."""
    save_demonstrations(path := tmp_path / "demos.safetensors", some())
    assert load_demonstrations(path).metadata == {"policy": "mine"}
    save_demonstrations(path, some(**changed))
    with pytest.raises(PolicyError, match=f"holds no valid demonstrations: .*{said}"):
        load_demonstrations(path)


def test_damaged_files_are_refused(tmp_path):
    """A file that ends early, one of another kind, and none at all."""
    save_demonstrations(path := tmp_path / "demos.safetensors", some())
    whole = path.read_bytes()
    for damaged in (whole[:-5], b"{}", whole.replace(b"demonstrations 1", b"demonstrations 9")):
        path.write_bytes(damaged)
        with pytest.raises(PolicyError, match="holds no valid demonstrations"):
            load_demonstrations(path)
    with pytest.raises(PolicyError, match="cannot be read: No such file"):
        load_demonstrations(tmp_path / "none")


def test_a_heuristic_is_named_by_its_place():
    """In any environment; what is missing is named, and policies that ship keep their names."""
    assert run_policy("mytask.heuristics:Nearest", COVER) is not None
    with pytest.raises(PluginError, match=r"cannot be imported: AttributeError: .* no attribute 'None_'"):
        run_policy("mytask.heuristics:None_", COVER)
    with pytest.raises(PluginError, match="has no method reset; policies have reset and act"):
        run_policy("collections:Counter", COVER)
    with pytest.raises(PolicyError, match="there is no policy 'trained:nothing'"):
        run_policy("trained:nothing", preset("instant"))
