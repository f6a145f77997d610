"""Command lines: a user's mistake is one clear sentence and exit code 2."""

import os
from pathlib import Path

import pytest

from eia_sec.common.compiled_code import COMPILING
from eia_sec.common.config import EvaluationConfig, LearnerConfig, RunConfig
from eia_sec.common.config.files import to_toml
from eia_sec.common.config.presets import PRESETS
from eia_sec.common.errors import RunDirError, UsageError
from eia_sec.common.log import FORMAT
from eia_sec.common.team import GroupSpec, TeamSpec
from eia_sec.deploy.cli import COMMANDS, dispatch, without_log_format
from eia_sec.deploy.commands.fleet.keys import IssueArguments, KeysArguments
from eia_sec.deploy.commands.policies.fly import FlyArguments
from eia_sec.deploy.exit_codes import run_command
from eia_sec.deploy.local.run_directory import RunDirectory
from eia_sec.deploy.options import base_configuration, parse


def complaint(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    """Return what a command line is answered with, which must be one line and code 2."""
    assert run_command(lambda: dispatch(list(arguments))) == 2
    lines = capsys.readouterr().err.splitlines(keepends=True)
    error = "".join(line for line in lines if COMPILING not in line)  # which a change of the simulator causes
    assert error.startswith("eia-sec: ")
    assert error.count("\n") == 1
    return error


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["sail"], "unknown command 'sail'"),
        (["train", "--preset", "huge"], "no preset 'huge'"),
        (["train", "--sead", "1"], "--seed"),
        (["train", "--seed", "x"], "--seed"),
        (["train", "--episodes", "0"], "episodes and steps are both 0"),
        (["train", "--steps", "-1"], "steps must be"),
        (["train", "--farm.world.sensors", "0"], "sensors must be"),
        (["train", "--algorithm.epochs", "-3"], "epochs must be"),
        (["train", "--workers", "0"], "workers must be"),
        (["train", "--lockstep", "--workers", "2"], "exactly one worker"),
        (["train", "--config", "nowhere.toml"], "nowhere.toml"),
        (["train", "--endpoint", "tcp/0.0.0.0:7447"], "choose a loopback address"),
        (["train", "--algorithm.hindsight", "montoring=1.0"], "hindsight names 'montoring', but the types are"),
        (["learner", "--algorithm.discounts", "comunication=1.0"], "discounts names 'comunication'"),
        (["train", "--algorithm.entropy-scales", "x=0.1"], "entropy_scales names 'x'"),
        (["learner", "--algorithm.suggestion-logits", "colection=8"], "suggestion_logits names 'colection'"),
        (["train", "--preset", "quick", "--preset", "huge"], "no preset 'huge'"),
        (["learner", "--run", "a b"], "run 'a b'"),
        (["learner", "--listen", "nonsense"], "not an endpoint"),
        (["learner", "--listen", "tcp/0.0.0.0:7447"], "--insecure"),
        (["learner", "--listen", "tcp/h:1", "--connect", "tcp/h:1"], "not both"),
        (["learner", "--resume"], "--run-dir"),
        (["train", "--resume"], "--resume needs --run-dir"),
        (["learner", "--resume-if-any"], "--run-dir"),
        (["router", "--listen", "tcp/0.0.0.0:7447"], "--insecure"),
        (["router", "--listen", "tls/127.0.0.1:7447"], "--tls FOLDER"),
        (["up", "nowhere.toml"], "nowhere.toml cannot be read"),
        (["down", "--wait", "-1"], "wait must be"),
        (["status"], "fleet.toml cannot be read"),
        (["logs", "--lines", "0"], "lines must be"),
        (["fleet"], "check, keys, collect, move-"),
        (["fleet", "render", "swarm"], "'swarm'"),
        (["host", "fly"], "'fly'"),
        (["alive", "rollout"], "NAME"),
        (["alive", "ox", "a"], "not a role; the roles are"),
        (["alive", "rollout", "a/b"], "name 'a/b'"),
        (["rollout", "--connect", "tcp/127.0.0.1:9", "--patience", "0"], "nobody answers"),
        (["rollout", "--run", "a/b"], "run 'a/b'"),
        (["rollout", "--patience", "nan"], "patience must be"),
        (["elite", "--patience", "-1"], "patience must be"),
        (["elite", "--members"], "--members needs the members, each as RUN=ENDPOINT"),
        (["elite", "--members", "a=tcp/127.0.0.1:9", "a=tcp/127.0.0.1:8"], "--members names a more than once"),
        (["elite", "--members", "a=tcp/127.0.0.1:9", "--run", "a"], "leave --run out"),
        (["elite", "--connect", "tcp/127.0.0.1:9", "--members", "a=tcp/127.0.0.1:9"], "leave --connect out"),
        (["elite", "--members", "a=tcp/127.0.0.1:9", "--patience", "0"], "no member has answered in 0 s: a at tcp/"),
        (["learner", "--connect", "tcp/127.0.0.1:9", "--patience", "nan"], "patience must be"),
        (["elite", "--connect", "tcp/127.0.0.1:9", "--patience", "0"], "nobody answers"),
        (["monitor", "--connect", "tcp/127.0.0.1:9", "--patience", "0"], "nobody answers"),
        (["fly"], "nothing to fly"),
        (["fly", "--policy", "nowhere"], "cannot be read"),
        (["fly", "--policy", "trained:eia-sec", "--rate", "0"], "rate must be"),
        (["fly", "--policy", "trained:eia-sec", "--vehicle", "uav-7"], "NAME=AGENT"),
        (["fly", "--policy", "trained:eia-sec", "--vehicle", "uav-7=monitoring_9"], "no agent 'monitoring_9'"),
        (["fly", "--policy", "trained:eia-sec", "--vehicle", "a=monitoring_0", "b=monitoring_0"], "the same agent"),
        (["fly", "--policy", "trained:eia-sec", "--listen", "tcp/0.0.0.0:7447"], "--insecure"),
        (["fly", "--policy", "trained:eia-sec", "--connect", "tcp/127.0.0.1:9", "--patience", "0"], "nobody answers"),
        (["simulator", "--connect", "tcp/127.0.0.1:9", "--patience", "0.1"], "nobody answers"),
        (["watch", "--connect", "tcp/127.0.0.1:9", "--patience", "0"], "nobody answers"),
        (["watch", "--host", "0.0.0.0"], "--insecure"),
        (["watch", "--port", "70000"], "port must be"),
        (["watch", "--worker", "a/b"], "worker 'a/b'"),
        (["evaluate"], "--policy"),
        (["evaluate", "--policy", "best"], "no policy 'best'"),
        (["evaluate", "--policy", "static", "--farms", "5:5"], "names no farm"),
        (["evaluate", "--policy", "static", "--farms", f"0:{'9' * 5000}"], "--farms must be A:B"),
        (["train", "--env", "mpe2:simple_spread_v3", "--farm.observation.plan", "12"], "no effect with mpe2:simple_sp"),
        (["evaluate", "--run-dir", "nowhere"], "there is no directory nowhere"),
        (["train", "--farm-file", "nowhere.csv"], "nowhere.csv"),
        (["train", "--farm_file=nowhere.shp"], "must end in .csv"),
        (["learner", "--farm-file", "nowhere.json"], "nowhere.json"),
        (["train", "--farm.world.sites", "1"], "--farm.world.sites"),
        (["train", "--learner.device", "tpu"], "device must be cpu"),
        (["train", "--learner.device", "cuda:999"], "learner.device is cuda:999"),
        (["learner", "--learner.device", "cuda:999", "--run-dir", "run"], "learner.device is cuda:999"),
        (["train", "--algorithm.start-policy", "all=nobody"], "'nobody' is neither a policy that ships"),
        (
            ["learner", "--algorithm.start-policy", "all=trained:eia-sec", "--run-dir", "run"],
            "fits no type of this run",
        ),
        (["farm"], "show, save, check"),
        (["farm", "plough"], "plough"),
        (["farm", "check"], "FILE"),
        (["farm", "check", "nowhere.csv"], "nowhere.csv"),
        (["farm", "save", "--out", "farm.txt"], "must end in .csv"),
        (["farm", "save", "--farm", "-1"], "farm must be"),
        (["farm", "save", "--density", "odd"], "must be one of irregular, uniform, "),
        (["farm", "save", "--longitude", "0"], "--longitude has no effect on farm.csv"),
        (["farm", "save", "--out", "FARM.CSV", "--latitude", "48"], "--latitude has no effect on FARM.CSV"),
        (["simulator", "--vehicle", "monitoring_1=monitoring_0"], "would both be the vehicle monitoring_1"),
        (["farm", "save", "--set", "farm.world.sensors=5000"], "do not fit"),
        (["farm", "save", "--set", "farm.stress.growth=5"], "farm.stress.growth is no option any more"),
        (["evaluate", "--policy", "static", "--set", "farm.relay.hop_range=9"], "while farm.relay.base is empty"),
        (["farm", "show", "--out", "nowhere/farm.png"], "cannot be written"),
    ],
)
def test_mistakes_are_one_sentence(
    arguments: list[str], said: str, capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The sentence names what is wrong, and nothing was started."""
    monkeypatch.chdir(tmp_path)
    assert said in complaint(capsys, *arguments)


def test_a_run_that_no_message_holds_leaves_no_folder(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A learner that is refused has made nothing that a mended command would run into."""
    monkeypatch.chdir(tmp_path)
    command = ("--run-dir", "run", "--algorithm.hidden", "4096")
    for name in ("learner", "train"):
        assert "lower algorithm.hidden" in complaint(capsys, name, *command)
        assert list(tmp_path.iterdir()) == []


def test_another_configuration_is_refused(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    """A run directory of another configuration is named with the difference."""
    (tmp_path / "config.toml").write_text(to_toml(RunConfig(seed=7)), encoding="utf-8")
    error = complaint(capsys, "train", "--run-dir", str(tmp_path), "--seed", "8")
    assert "another configuration" in error
    assert "seed" in error


TEAM = TeamSpec((GroupSpec("scout", 2, 4, 2),))


def test_more_episodes_need_a_new_run(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    """A run cannot be lengthened, and the sentence says how to go on from its policy."""
    RunDirectory(tmp_path / "run").prepare(RunConfig(), resume=False)
    error = complaint(capsys, "train", "--run-dir", str(tmp_path / "run"), "--resume", "--episodes", "13000")
    assert "a run cannot be lengthened; begin another one as its policy" in error
    assert f"--algorithm.start-policy all={tmp_path}/run/policy.safetensors" in error


def test_what_a_resumed_run_may_change(tmp_path: Path) -> None:
    """Settings of the learner's process and of the evaluation at the end; the folder then holds the new ones."""
    held, wanted = RunConfig(seed=7), RunConfig(seed=7, learner=LearnerConfig(threads=2), evaluation=EvaluationConfig())
    directory = RunDirectory(tmp_path / "run")
    directory.prepare(held, resume=False)
    with pytest.raises(RunDirError, match=r"learner\.threads"):
        directory.prepare(wanted, resume=False)
    directory.prepare(wanted, resume=True)
    assert directory.configuration() == held
    directory.adopt(wanted, TEAM)
    assert directory.configuration() == wanted
    with pytest.raises(RunDirError, match="seed"):
        directory.prepare(RunConfig(seed=8), resume=True)


def test_a_folder_of_somebody_else_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What may not be read or written is one sentence, at each of the steps; damaged metrics are no end of a run."""
    directory = RunDirectory(tmp_path)
    directory.prepare(RunConfig(), resume=False)

    def refuse(*arguments: object, **options: object) -> None:
        raise PermissionError(13, "Permission denied")

    for place, name, step in (
        (Path, "exists", lambda: directory.prepare(RunConfig(), resume=True)),
        (os, "open", lambda: directory.lock("x")),
    ):
        with monkeypatch.context() as patch:
            patch.setattr(place, name, refuse)
            with pytest.raises(RunDirError, match="Permission denied"):
                step()
    (tmp_path / "metrics.jsonl").write_bytes(b"\xff\xfe\n")
    assert not directory.finished()


def test_resuming_what_never_ran_is_refused(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    """A folder without a run cannot be resumed, and a folder with other things in it is not taken over."""
    assert "no run to resume" in complaint(capsys, "train", "--run-dir", str(tmp_path / "new"), "--resume")
    (tmp_path / "thesis.tex").write_text("precious", encoding="utf-8")
    assert "not a run directory" in complaint(capsys, "train", "--run-dir", str(tmp_path))


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_explains_itself(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    """`--help` of each command ends with code 0 and describes its options."""
    with pytest.raises(SystemExit) as stop:
        dispatch([name, "--help"])
    assert stop.value.code == 0
    named = {
        "farm": "check",
        "keys": "issue",
        "audit": "--json",
        "router": "--listen",
        "replay": "--against",
        "record": "--out",
        "benchmark": "--algorithms",
        "measure": "--job",
        "bridge": "px4",
    }
    named |= dict.fromkeys(("up", "down", "restart", "status", "logs"), "FLEET") | {
        "fleet": "render",
        "host": "--folder",
    }
    assert named.get(name, "--run") in capsys.readouterr().out


def test_the_overview_names_every_command(capsys: pytest.CaptureFixture[str]) -> None:
    """`eia-sec --help` lists what there is."""
    assert dispatch(["--help"]) == 0
    printed = capsys.readouterr().out
    assert all(name in printed for name in COMMANDS)


def test_the_last_of_several_values_counts(tmp_path: Path) -> None:
    """Options that decide where to begin are read as the parser reads all others; `None` takes one back."""
    (tmp_path / "one.toml").write_text("episodes = 77\n")
    (tmp_path / "two.toml").write_text("seed = 5\n")
    files = [f"--config={tmp_path / name}.toml" for name in ("one", "two")]
    found = base_configuration(["--preset", "quick", *files, "--preset", "instant"])
    assert (found.episodes, found.seed) == (PRESETS["instant"].episodes, 5)
    assert base_configuration([*files, "--config", "None"]) == PRESETS["inertial"]


def test_a_mistake_in_a_file_names_the_file(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    """There may be several files, so a wrong key alone does not say where it stands."""
    (tmp_path / "mine.toml").write_text("[algorithm]\nhiden = 3\n")
    said = complaint(capsys, "train", "--config", str(tmp_path / "mine.toml"))
    assert str(tmp_path / "mine.toml") in said
    assert "hiden" in said


def test_lists_that_are_given_several_times_are_one_list() -> None:
    """The parser alone would keep the last one, so that a vehicle or a host is left out in silence."""
    lists = parse(FlyArguments, ["--vehicle", "a=monitoring_0", "--rate", "5", "--vehicle=b=monitoring_1"], "fly")
    assert (lists.vehicle, lists.rate) == (("a=monitoring_0", "b=monitoring_1"), 5.0)
    keys = parse(KeysArguments, ["issue", "learner", "x", "--host", "one", "two", "--host", "three"], "keys")
    assert isinstance(keys.task, IssueArguments)
    assert keys.task.host == ("one", "two", "three")


def test_a_history_is_a_file(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    """A worker leaves a folder that is named for its history as it is."""
    (tmp_path / "kept").write_text("x")
    assert "is no file" in complaint(capsys, "rollout", "--history", str(tmp_path), "--patience", "0")
    assert (tmp_path / "kept").read_text() == "x"


def test_file_goes_over_preset(tmp_path: Path) -> None:
    """A file replaces the preset's values and leaves the others."""
    path = tmp_path / "mine.toml"
    path.write_text("episodes = 77\n", encoding="utf-8")
    config = base_configuration(["--preset", "quick", f"--config={path}"])
    assert config.episodes == 77
    assert config.algorithm == base_configuration(["--preset", "quick"]).algorithm


@pytest.mark.parametrize("words", [["--log-format", "json"], ["--log_format=json"]])
def test_the_log_format_is_an_option_of_every_command(words: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """It is taken out of the command line wherever it stands, and processes inherit it."""
    monkeypatch.setenv(FORMAT, "text")
    assert without_log_format(["train", *words, "--seed", "1"]) == ["train", "--seed", "1"]
    assert os.environ[FORMAT] == "json"


@pytest.mark.parametrize("words", [["--log-format", "yaml"], ["--log-format"], ["--log-format="]])
def test_another_log_format_is_refused(words: list[str]) -> None:
    """It is one of two."""
    with pytest.raises(UsageError, match="text or json"):
        without_log_format(["train", *words])


def test_environments_but_the_farm_have_a_preset_of_their_own(tmp_path: Path) -> None:
    """Where no preset is named, it follows from the environment, by the command line or by a file."""
    path = tmp_path / "run.toml"
    path.write_text('[env]\nname = "toy_env:Relay"\n[algorithm]\nhidden = 16\n')
    generic = PRESETS["generic"]
    for arguments in (["--env", "toy_env:Relay"], ["--env.name=toy_env:Relay"], ["--config", str(path)]):
        found = base_configuration(arguments)
        assert (found.steps, found.rollout) == (generic.steps, generic.rollout)
    quick = base_configuration(["--env", "toy_env:Relay", "--preset", "quick"])
    assert (quick.episodes, quick.rollout) == (PRESETS["quick"].episodes, PRESETS["quick"].rollout)
    assert base_configuration(["--env", "farm"]) == base_configuration([]) == PRESETS["inertial"]
    given = base_configuration(["--env", "toy_env:Relay", "--episodes", "30"])
    assert (given.episodes, given.steps) == (30, 0)


NOBODY = ["--connect", "tcp/127.0.0.1:9", "--patience", "2.6"]


@pytest.mark.parametrize(
    "arguments",
    [
        ["alive", "rollout", "a", *NOBODY],
        ["elite", *NOBODY],
        ["simulator", *NOBODY],
        ["bridge", "mavlink", "--vehicle", "uav-7=monitoring_0", *NOBODY],
        ["fly", "--policy", "trained:eia-sec", *NOBODY],
    ],
    ids=lambda arguments: arguments[0],
)
def test_whoever_waits_for_a_listener_says_so(capsys: pytest.CaptureFixture[str], arguments: list[str]) -> None:
    """Nobody waits in silence for longer than two seconds."""
    run_command(lambda: dispatch(arguments))
    told = capsys.readouterr()
    assert "waiting for a listener at tcp/127.0.0.1:9" in told.err
    assert "nobody answers" in told.out + told.err
