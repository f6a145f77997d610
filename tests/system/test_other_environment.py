"""A PettingZoo environment through the real processes: trained to the end, resumed, and only by workers that may."""

import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from eia_sec.common.config import EnvConfig, RunConfig
from eia_sec.common.config.files import to_toml
from tests.system.fleet import Processes

RELAY = """
episodes = 120
[env]
name = "toy_env:Relay"
[algorithm]
hidden = 16
batch = 32
[elite]
cycle = 20
farms = 2
[replay]
capacity = 1024
warmup_steps = 64
updates_per_step = 0.5
slack_steps = 200
[rollout]
environments = 3
chunk_steps = 7
[learner]
publish_seconds = 0.05
[evaluation]
farms = 3
"""
DOORS = """
episodes = 300
[env]
name = "toy_choices:Doors"
arguments = '{"masks": "info"}'
[algorithm]
name = "ippo"
hidden = 16
iteration_steps = 64
minibatch_steps = 32
[rollout]
environments = 4
chunk_steps = 16
[learner]
publish_seconds = 0.05
[evaluation]
farms = 3
"""
TOYS = str(Path(__file__).parents[1] / "rollout" / "envs")
WHERE = os.pathsep.join([str(Path.cwd() / "src"), str(Path.cwd()), TOYS])
"""Where processes find this checkout and the toys."""


def test_trained_to_the_end_and_evaluated(tmp_path: Path) -> None:
    """`eia-sec train --env` ends with a report; the policy earns more than random actions do."""
    config, run_dir = tmp_path / "relay.toml", tmp_path / "run"
    config.write_text(RELAY.replace('name = "toy_env:Relay"', "").replace("episodes = 120", "episodes = 300"))
    command = [sys.executable, "-m", "eia_sec.deploy.cli", "train", "--preset", "eia-sec", "--env", "toy_env:Relay"]
    done = subprocess.run(
        [*command, "--config", str(config), "--run-dir", str(run_dir), "--algorithm.actor-rate", "0.001"],
        env={**os.environ, "PYTHONPATH": WHERE},
        capture_output=True,
        text=True,
        timeout=200,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    outcome = json.loads((run_dir / "evaluation.json").read_text())
    trained, *_, chance = (result["reward"] for result in outcome["evaluations"])
    assert set(trained) == {"mean", "runner", "keeper"}
    assert trained["mean"] > chance["mean"] + 0.3
    assert (run_dir / "curves.png").is_file()
    status = [json.loads(line) for line in (run_dir / "metrics.jsonl").read_text().splitlines()]
    ledger = [record for record in status if record["kind"] == "status"][-1]["ledger"]
    assert (ledger["unexplained"], ledger["lost"], ledger["rejected"]) == (0, 0, 0)
    events = [record for record in status if record["kind"] == "imitation"]
    assert set(events[0]["elites"]) == {"runner", "keeper"}


def test_choices_masks_and_boxes_are_trained_together(tmp_path: Path) -> None:
    """On-policy training of a mixed team with action masks ends with a better policy, which can be exported."""
    config, run_dir = tmp_path / "doors.toml", tmp_path / "run"
    config.write_text(DOORS)
    environment = {**os.environ, "PYTHONPATH": WHERE}
    for command in (["train", "--env", "toy_choices:Doors", "--config", str(config)], ["export"]):
        done = subprocess.run(
            [sys.executable, "-m", "eia_sec.deploy.cli", *command, "--run-dir", str(run_dir)],
            env=environment,
            capture_output=True,
            text=True,
            timeout=200,
            check=False,
        )
        assert done.returncode == 0, done.stdout + done.stderr
    outcome = json.loads((run_dir / "evaluation.json").read_text())
    trained, *_, chance = (result["reward"] for result in outcome["evaluations"])
    assert trained["mean"] > chance["mean"] + 1.0
    assert {path.stem for path in (run_dir / "export").glob("*.onnx")} == {
        "walker-0",
        "walker-1",
        "painter-0",
        "porter-0",
    }


def test_a_worker_loads_no_environment_that_it_was_not_given(
    processes: Processes, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The configuration comes over the network, so what it names is loaded only where the command line names it too."""
    processes.config.write_text(RELAY)
    monkeypatch.setenv("PYTHONPATH", WHERE)
    processes.learner()
    processes.worker()
    assert processes.wait("rollout-0") == 2
    assert "a worker loads it only if started with --env toy_env:Relay" in processes.log("rollout-0")


def test_a_run_directory_does_not_decide_whose_code_is_run(tmp_path: Path) -> None:
    """What a run directory names is loaded only where the command line names it too."""
    witness = tmp_path / "witness"
    env = EnvConfig(name="os:system", arguments=json.dumps({"command": f"touch {witness}"}))
    (tmp_path / "config.toml").write_text(to_toml(replace(RunConfig(), env=env)))
    for command in (["evaluate", "--policy", "random"], ["train", "--resume"]):
        done = subprocess.run(
            [sys.executable, "-m", "eia_sec.deploy.cli", *command, "--run-dir", str(tmp_path)],
            capture_output=True,
            text=True,
            timeout=60,
            check=False,
        )
        assert done.returncode == 2
        assert "--env os:system" in done.stderr
        assert not witness.exists()


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--env", "toy_choices:Doors"], "toy_choices:Doors has discrete actions (walker, porter), which eia-sec"),
        (["--farm.control.monitoring", "moves"], "farm has discrete actions (monitoring), which eia-sec"),
    ],
)
def test_discrete_actions_are_refused_before_anything_is_made(
    tmp_path: Path, arguments: list[str], sentence: str
) -> None:
    """An algorithm that cannot train them says so in one sentence and leaves no run directory."""
    done = subprocess.run(
        [
            sys.executable,
            "-m",
            "eia_sec.deploy.cli",
            "train",
            "--preset",
            "eia-sec",
            *arguments,
            "--run-dir",
            str(tmp_path / "run"),
        ],
        env={**os.environ, "PYTHONPATH": WHERE},
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert done.returncode == 2
    assert sentence in " ".join(done.stderr.split())
    assert "Traceback" not in done.stderr
    assert not (tmp_path / "run").exists()


def trained(tmp_path: Path, name: str, *more: str, seconds: float = 200) -> subprocess.CompletedProcess[str]:
    """Return the end of a short training in an environment of the toys."""
    config = tmp_path / "doors.toml"
    config.write_text(DOORS.replace('name = "toy_choices:Doors"\narguments = \'{"masks": "info"}\'', ""))
    run_dir = ["--run-dir", str(tmp_path / "run")]
    return subprocess.run(
        [sys.executable, "-m", "eia_sec.deploy.cli", "train", "--env", name, "--config", str(config), *run_dir, *more],
        env={**os.environ, "PYTHONPATH": WHERE},
        capture_output=True,
        text=True,
        timeout=seconds,
        check=False,
    )


@pytest.mark.parametrize(
    ("name", "sentence"),
    [
        ("toy_script:Env", "import toy_script ended the program with exit code 2"),
        ("toy_faults:Raising", "toy_faults:Raising: step() raised ValueError: no such gear"),
    ],
)
def test_what_an_environment_does_wrong_is_said_before_anything_is_made(
    tmp_path: Path, name: str, sentence: str
) -> None:
    """The trial finds it, and the user's own lines are shown."""
    done = trained(tmp_path, name)
    assert done.returncode == 2
    assert sentence in done.stderr
    assert 'File "' in done.stderr
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("code", [0, 5])
def test_a_library_that_ends_the_process_is_named_before_anything_is_made(tmp_path: Path, code: int) -> None:
    """The C library's own exit raises nothing in Python; even its code 0 is no success."""
    done = trained(tmp_path, "toy_faults:Exiting", "--env.arguments", f'{{"after": 2, "code": {code}}}')
    assert done.returncode == 2
    assert f"toy_faults:Exiting ended its process in a trial of a few steps, with exit code {code}" in done.stderr
    assert not (tmp_path / "run").exists()


def test_numbers_beyond_the_limit_end_a_run_with_their_name(tmp_path: Path) -> None:
    """Where they come late, worker and training end with a sentence about agent, index, value, limit and remedy."""
    done = trained(tmp_path, "toy_faults:Late")
    last = done.stderr.splitlines()[-1]
    assert done.returncode == 2
    assert last.startswith("eia-sec: toy_faults:Late: step() returned an observation of agent runner_0")
    assert "with -4e+08 at index 1; the largest is 1e+07: divide it by its scale in the environment." in last
