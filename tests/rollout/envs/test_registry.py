"""What generic code learns of an environment before anything flies in it."""

import subprocess
import sys
from contextlib import closing
from dataclasses import replace

import pytest

from eia_sec.common.config.presets import PRESETS, preset
from eia_sec.common.errors import ConfigError
from eia_sec.rollout.envs.registry import environment_spec, make_environments


@pytest.mark.parametrize("name", PRESETS)
def test_the_description_is_that_of_the_environments(name):
    """It is found without them, and is the same."""
    config = preset(name)
    with closing(make_environments(config, 1)) as environments:
        assert environment_spec(config) == environments.spec


def test_farms_that_cannot_be_made_are_not_described():
    """The same sentence says why."""
    config = preset("long")
    slow = replace(config.farm.world, speed_x_max=0.01, speed_y_max=0.01)
    refusing = replace(config, farm=replace(config.farm, world=slow))
    with pytest.raises(ConfigError) as refused:
        make_environments(refusing, 1)
    with pytest.raises(ConfigError) as refused_too:
        environment_spec(refusing)
    assert str(refused_too.value) == str(refused.value)


def test_a_description_loads_no_simulator_and_no_heuristic():
    """Commands that only need it start sooner."""
    program = (
        "import sys\n"
        "from eia_sec.common.config.presets import preset\n"
        "from eia_sec.rollout.envs.registry import environment_spec\n"
        "from eia_sec.rollout.start_policy import start_parameters\n"
        "config = preset('long')\n"
        "start = start_parameters(config, environment_spec(config).team)\n"
        "loaded = {'eia_sec.rollout.heuristics.registry', 'eia_sec.rollout.sim.batch'} & set(sys.modules)\n"
        "sys.exit(not start or bool(loaded))"
    )
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == 0
