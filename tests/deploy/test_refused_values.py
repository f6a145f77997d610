"""Values that would make a command wait for ever or do nothing are refused in one sentence, exit code 2."""

from pathlib import Path

import pytest

from eia_sec.common.config import EnvConfig, RunConfig
from eia_sec.common.config.files import to_toml
from eia_sec.deploy.cli import dispatch
from eia_sec.deploy.exit_codes import run_command
from tests.deploy.test_cli import complaint

FLY = ("fly", "--policy", "trained:eia-sec")
NOBODY = ("--connect", "tcp/127.0.0.1:9", "--patience", "0.1")
FLEET = '[learner]\nhost = "a"\n[hosts.a]\nhost = "local"\nworkers = {}\n'


@pytest.mark.parametrize("value", ["nan", "-1", "inf"])
@pytest.mark.parametrize("command", [("alive", "learner", "learner"), ("watch",), (*FLY, "--connect", "tcp/h:1")])
def test_a_patience_that_never_ends_is_refused(
    command: tuple[str, ...], value: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """No comparison with such a number ever says that the time is up."""
    assert f"patience must be between 0.0 and 1000000000.0, not {float(value)}" in complaint(
        capsys, *command, f"--patience={value}"
    )


@pytest.mark.parametrize("value", ["nan", "-3"])
def test_a_flight_of_impossible_length_is_refused(value: str, capsys: pytest.CaptureFixture[str]) -> None:
    """It would end at once and look like a success."""
    assert "seconds must be between" in complaint(capsys, *FLY, f"--seconds={value}")


@pytest.mark.parametrize("value", ["0", "-5"])
def test_a_simulation_without_steps_is_refused(value: str, capsys: pytest.CaptureFixture[str]) -> None:
    """It would report a flight of no steps as a success."""
    assert f"steps must be above 0, not {value}" in complaint(capsys, "simulator", f"--steps={value}", *NOBODY)


@pytest.mark.parametrize(
    ("vehicles", "said"),
    [
        (("uav=monitorng_0",), "there is no agent 'monitorng_0'; the farm's are communication_0, "),
        (("a=monitoring_0", "b=monitoring_0"), "two vehicles have the same agent"),
    ],
)
def test_the_simulator_refuses_vehicles_without_an_agent_of_their_own(
    vehicles: tuple[str, ...], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """As the flight node does; the vehicle would otherwise fly under its agent's name."""
    assert said in complaint(capsys, "simulator", "--vehicle", *vehicles, *NOBODY)


@pytest.mark.parametrize("follow", [(), ("--follow",)])
def test_logs_of_a_process_that_the_fleet_lacks_are_refused(
    follow: tuple[str, ...], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The sentence names the processes that there are, and of many only the first."""
    path = tmp_path / "fleet.toml"
    path.write_text(FLEET.format(1))
    words = ("logs", str(path), *follow, "--process", "keeper", "nope")
    there = "keeper, learner.learner, elite.coordinator, rollout.a-0"
    assert f"has no process 'nope'; it has {there}." in complaint(capsys, *words)
    path.write_text(FLEET.format(20))
    error = complaint(capsys, *words)
    assert f"{there}, " in error
    assert error.endswith(" and 15 more.\n")


def test_logs_of_the_keeper_and_of_a_process_are_shown(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Names that the fleet has are no mistake, also before anything was started."""
    path = tmp_path / "fleet.toml"
    path.write_text(FLEET.format(1))
    assert run_command(lambda: dispatch(["logs", str(path), "--process", "keeper", "rollout.a-0"])) == 0
    assert capsys.readouterr().err == ""


def test_an_evaluation_that_no_memory_holds_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    """Farms and episodes are limited together."""
    words = ("evaluate", "--policy", "static", "--farms", "5:7", "--episodes")
    assert "2 farms with 1,000,000,000,000 episodes each are too many" in complaint(capsys, *words, "1000000000000")
    assert "at most 1,000,000 episodes" in complaint(capsys, *words, "500001")


def test_a_replay_of_another_environment_is_refused_for_what_it_is(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The sentence does not advise an option that the command lacks."""
    (tmp_path / "config.toml").write_text(to_toml(RunConfig(env=EnvConfig("mpe2:simple_spread_v3"))))
    error = complaint(capsys, "replay", str(tmp_path))
    assert "this run is about mpe2:simple_spread_v3; only the farm can be replayed." in error
    assert "--env" not in error
