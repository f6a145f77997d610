"""What a configuration says of served environments, and what is refused before any process starts."""

from dataclasses import replace

import pytest

from eia_sec.common.config import EnvConfig, RunConfig
from eia_sec.common.config.presets import preset
from eia_sec.common.errors import ConfigError, UsageError
from eia_sec.common.team import GroupSpec, TeamSpec
from eia_sec.deploy.options import base_configuration, require_env
from eia_sec.rollout.envs.registry import environment_spec, make_environments, spec_of_team

SITES = ["--env", "zenoh:site-*"]
TEAM = TeamSpec((GroupSpec("arm", 2, 3, 1),))


def test_a_worker_holds_one_served_environment_unless_more_are_asked_for() -> None:
    """Each may be a robot; other environments keep what the preset says."""
    assert base_configuration(SITES).rollout.environments == 1
    assert base_configuration(["--env", "mpe2:simple_spread_v3"]).rollout.environments == 8


@pytest.mark.parametrize("name", ["zenoh:", "zenoh:a/b", "zenoh:a b", "zenoh:$*", "zenoh:" + "a" * 64])
def test_a_name_that_no_environment_can_have_is_refused(name: str) -> None:
    """Slashes, spaces and Zenoh's own wildcards are in no name."""
    with pytest.raises(ConfigError, match="must be farm, module:name or zenoh:NAME"):
        EnvConfig(name)


def test_evaluations_of_elites_are_refused_and_the_way_out_is_named() -> None:
    """It would evaluate beside training; with scores from training itself, the same algorithm is taken."""
    config = preset("eia-sec").with_environment("zenoh:site-*")
    with pytest.raises(ConfigError, match=r"--elite\.farms 0"):
        spec_of_team(config, TEAM)
    scored = replace(config, elite=replace(config.elite, farms=0))
    assert scored.imitates
    assert spec_of_team(scored, TEAM).team == TEAM


def test_where_nothing_is_reached_a_sentence_says_which_commands_do() -> None:
    """Training inside one Python process has no listener."""
    for attempt in (environment_spec, lambda config: make_environments(config, 1)):
        with pytest.raises(ConfigError, match="reached from train, rollout and evaluate only"):
            attempt(RunConfig(env=EnvConfig("zenoh:site-a")))


def test_a_run_directory_moves_no_robot_that_the_command_line_does_not_name() -> None:
    """Any served environment may be named, and nothing else."""
    config = base_configuration(SITES)
    for named in (None, "mpe2:simple_spread_v3"):
        with pytest.raises(UsageError, match=r"add --env 'zenoh:site-\*'"):
            require_env(config, named)
    require_env(config, "zenoh:site-b")
