"""What an environment states about itself, and what generic code makes of it."""

import json
from dataclasses import replace

import pytest

from eia_sec.common.config import EnvConfig, RunConfig
from eia_sec.common.environment import EnvironmentSpec
from eia_sec.common.errors import ConfigError
from eia_sec.common.farm import METRIC_NAMES, farm_environment, farm_of, require_farm
from eia_sec.common.team import GroupSpec, TeamSpec
from eia_sec.deploy.monitor.environment_labels import LENGTH, plotted, type_label

FARM = farm_environment(RunConfig().farm)


def test_a_farm_names_every_number_of_every_type():
    """Each type has as many names as its observation and the farm's action have numbers, all of them different."""
    for group in FARM.team.groups:
        names = FARM.tensor_names[group.name]
        assert len(set(names.observation)) == group.observation_size
        assert len(names.action) == len(names.action_scale) == group.environment_action_size


def test_metrics_have_text_in_the_unit_of_their_heading():
    """Energy is recorded in J and shown in kJ; the others are shown as they are."""
    shown = {metric.name: metric.text(1234.5678) for metric in FARM.episode_metrics}
    assert tuple(shown) == METRIC_NAMES
    assert (shown["aoi"], shown["collisions"], shown["energy_j"]) == ("1234.57", "1234.6", "1")


def test_a_view_labels_what_the_learner_sends():
    """Labels survive a metric message; without any, a view shows the length of episodes and whole names."""
    values = {"environment": json.loads(json.dumps(FARM.labels()))}
    assert [(curve.name, curve.label, curve.digits) for curve in plotted(values)] == [
        ("aoi", "AoI", 2),
        ("vdf", "VDF", 2),
    ]
    assert [type_label(values, group.name) for group in FARM.team.groups] == ["c", "m", "d"]
    plain = EnvironmentSpec(TeamSpec((GroupSpec("runner", 1, 2, 2),)), (1, 25))
    for values in ({}, {"environment": plain.labels()}):
        assert plotted(values) == [LENGTH]
        assert type_label(values, "runner") == "runner"


@pytest.mark.parametrize("labels", [1, [], {"episode_metrics": [1]}, {"episode_metrics": [{"plotted": True}]}])
def test_malformed_labels_are_an_error_that_a_view_knows(labels):
    """A view counts such a message as unreadable and goes on."""
    with pytest.raises((TypeError, ValueError, LookupError, AttributeError)):
        plotted({"environment": labels})


def test_only_the_farm_is_a_farm():
    """What only the farm can do is refused elsewhere in the caller's own sentence."""
    other = replace(RunConfig(), env=EnvConfig(name="some.module:env"))
    assert farm_of(RunConfig()) == require_farm(RunConfig(), "") == RunConfig().farm
    assert farm_of(other) is None
    with pytest.raises(ConfigError, match=r"^this is about some\.module:env\.$"):
        require_farm(other, "this is about {}.")
