"""How many workers `eia-sec train` starts, and what it says of itself."""

from dataclasses import replace
from pathlib import Path

import pytest

from eia_sec.common.config import EnvConfig, RunConfig
from eia_sec.common.config.files import with_values
from eia_sec.common.config.plugin_names import PluginNames
from eia_sec.common.config.presets import preset
from eia_sec.common.environment import EnvironmentSpec
from eia_sec.common.errors import ConfigError
from eia_sec.common.team import GroupSpec, TeamSpec
from eia_sec.deploy.commands.training import train
from eia_sec.deploy.commands.training.train import TrainArguments, command_line, resume_command, worker_count


@pytest.mark.parametrize(
    ("name", "cores", "workers"),
    [("instant", 2, 1), ("long", 2, 2), ("long", 1, 1), ("long", 64, 2), ("connected", 2, 1), ("uneven", 2, 2)],
)
def test_a_slow_simulator_has_two_workers_where_there_are_cores(monkeypatch, name, cores, workers):
    """Two where UAVs see plans and there are two cores or more, else one."""
    monkeypatch.setattr(train, "allowed_cores", lambda: cores)
    assert worker_count(TrainArguments(settings=preset(name))) == workers


def test_what_else_decides_the_number_of_workers(monkeypatch, tmp_path):
    """Third-party environments are not ours to judge, and cores may be taken already."""
    monkeypatch.setattr(train, "allowed_cores", lambda: 2)
    third = with_values(preset("long"), {"env.name": "mpe2:simple_spread_v3"})
    assert worker_count(TrainArguments(settings=third)) == 1
    threaded = with_values(preset("long"), {"rollout.threads": 2})
    assert worker_count(TrainArguments(settings=threaded)) == 1
    assert worker_count(TrainArguments(settings=preset("long"), tls=tmp_path)) == 1
    (tmp_path / "rollout.1").mkdir()
    assert worker_count(TrainArguments(settings=preset("long"), tls=tmp_path)) == 2


def test_who_asks_for_a_number_of_workers_gets_it(monkeypatch):
    """Whatever the preset; lockstep has one, and numbers that cannot be are refused."""
    monkeypatch.setattr(train, "allowed_cores", lambda: 2)
    long = preset("long")
    assert worker_count(TrainArguments(workers=1, settings=long)) == 1
    assert worker_count(TrainArguments(workers=5)) == 5
    assert worker_count(TrainArguments(lockstep=True, settings=long)) == 1
    for number in (0, 1025):
        with pytest.raises(ConfigError, match="workers must be"):
            worker_count(TrainArguments(workers=number))


def test_the_report_says_how_many_workers_there_were():
    """Where the number was left to the machine, the command that is kept has it; one that was given stands once."""
    assert command_line(["--preset", "long"], TrainArguments(), 2) == [
        "eia-sec",
        "train",
        "--preset",
        "long",
        "--workers",
        "2",
    ]
    assert command_line(["--workers", "3"], TrainArguments(workers=3), 3) == ["eia-sec", "train", "--workers", "3"]


def test_the_hint_how_to_resume_names_what_no_configuration_holds(tmp_path):
    """A number of workers that was given, keys, shared memory, and the environment, which no file may choose."""
    farm, other = RunConfig(), replace(RunConfig(), env=EnvConfig("games:make", "{}"))
    begun = f"eia-sec train --run-dir {tmp_path} --resume"
    assert resume_command(TrainArguments(settings=farm), tmp_path) == begun
    assert resume_command(TrainArguments(workers=4, settings=farm), tmp_path) == f"{begun} --workers 4"
    keys = tmp_path / "keys"
    assert resume_command(TrainArguments(tls=keys, settings=farm), tmp_path) == f"{begun} --tls {keys}"
    shared = TrainArguments(shared_memory=True, settings=other)
    assert resume_command(shared, tmp_path) == f"{begun} --shared-memory --env games:make"


@pytest.mark.parametrize(
    ("called", "found", "shown"),
    [
        (".venv/bin/eia-sec", False, ".venv/bin/eia-sec"),
        (".venv/bin/eia-sec", True, "eia-sec"),
        ("script.py", False, "eia-sec"),
    ],
)
def test_commands_that_are_shown_can_be_typed(monkeypatch, called, found, shown):
    """After `make train` no folder of PATH has the program; a script of the user's is not it."""
    monkeypatch.setattr("sys.argv", [called])
    monkeypatch.setattr("shutil.which", lambda name: f"/usr/bin/{name}" if found else None)
    assert resume_command(TrainArguments(settings=RunConfig()), Path("run")) == f"{shown} train --run-dir run --resume"


def test_commands_that_are_shown_name_plugins():
    """`--plugin` was taken from the command line, and no configuration may choose what is loaded."""
    named = TrainArguments(workers=1, settings=replace(RunConfig(), plugins=PluginNames(("mytask", "other"))))
    assert command_line(["--seed", "1"], named, 1) == [
        *("eia-sec", "train", "--plugin", "mytask", "--plugin", "other", "--seed", "1")
    ]
    assert resume_command(named, Path("run")).endswith("--resume --workers 1 --plugin mytask --plugin other")


@pytest.mark.parametrize(("episodes", "said"), [(3, True), (4, False)])
@pytest.mark.parametrize("name", ["ippo", "eia-sec"])
def test_a_run_that_cannot_make_one_update_says_so(name, episodes, said):
    """Before it starts: episodes together have fewer steps than the first update needs."""
    environment = EnvironmentSpec(TeamSpec((GroupSpec("scout", 2, 4, 2),)), (1, 100))
    base = preset("eia-sec" if name == "eia-sec" else "instant")
    options = {"algorithm.iteration_steps": 400, "algorithm.minibatch_steps": 100}
    values = options if name == "ippo" else {"replay.warmup_steps": 399, "algorithm.batch": 32}
    config = with_values(base, {"episodes": episodes, **values})
    found = train.shortage(config, environment)
    assert ("at most 300 steps, and the first update needs 400" in found) == said
    assert bool(found) == said


def test_both_readers_are_named_in_any_environment(tmp_path):
    """With the run's folder, and with a certificate of their own where the run has TLS."""
    for name in ("farm", "mpe2:simple_spread_v3"):
        settings = RunConfig(env=EnvConfig(name))
        _, *lines = train._where_to_watch(TrainArguments(settings=settings), Path("my run"))
        assert lines == ["  eia-sec monitor 'my run'", "  eia-sec watch 'my run'   # in the browser"]
    _, *lines = train._where_to_watch(TrainArguments(tls=tmp_path), Path("run"))
    assert lines[0] == f"  eia-sec monitor run --tls {tmp_path}/monitor.NAME"
