"""An environment that holds a process of its own: however a command ends, that process is gone."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from eia_sec.deploy.monitor.audit import audit
from tests.system.fleet import until
from tests.system.test_other_environment import DOORS, WHERE

SIMULATED = "toy_faults:Simulated"


class Command:
    """A command of `eia-sec` in the environment, whose processes bear a mark of their own."""

    def __init__(self, folder: Path, *arguments: str, toml: str = DOORS) -> None:
        self.mark = f"toy-{os.getpid()}-{time.monotonic_ns()}"
        self.run_dir, self._log = folder / "run", folder / f"{arguments[0]}.log"
        (folder / "toy.toml").write_text(
            toml.replace('name = "toy_choices:Doors"\narguments = \'{"masks": "info"}\'', "")
        )
        named = [
            *([] if arguments[0] == "evaluate" else ["--run-dir", str(self.run_dir)]),
            "--config",
            str(folder / "toy.toml"),
        ]
        with self._log.open("w") as output:
            self.process = subprocess.Popen(
                [sys.executable, "-m", "eia_sec.deploy.cli", *arguments, *named],
                env={**os.environ, "PYTHONPATH": WHERE, "TOY_MARK": self.mark},
                stdout=output,
                stderr=output,
            )

    def ended(self, seconds: float = 200.0) -> tuple[int, str]:
        """Return the exit code and the output."""
        return self.process.wait(seconds), self._log.read_text()

    def simulators(self) -> list[int]:
        """Return the processes that environments of this command have started."""
        found = []
        for path in Path("/proc").glob("[0-9]*/cmdline"):
            try:
                words = path.read_bytes().split(b"\0")
            except OSError:
                continue
            if self.mark.encode() in words:
                found.append(int(path.parent.name))
        return found

    def kill(self) -> None:
        """End whatever is left."""
        for number in [*self.simulators(), *([self.process.pid] if self.process.poll() is None else [])]:
            os.kill(number, signal.SIGKILL)


Begun = Callable[..., Command]


@pytest.fixture
def begun(tmp_path: Path, request: pytest.FixtureRequest) -> Begun:
    """Begin commands whose processes are gone when the test is over."""

    def begin(*arguments: str, toml: str = DOORS) -> Command:
        command = Command(tmp_path, *arguments, toml=toml)
        request.addfinalizer(command.kill)
        return command

    return begin


def test_nothing_is_left_of_a_whole_run_and_its_evaluation(begun: Begun) -> None:
    """Trial, learner, worker and report each close what they opened."""
    training = begun("train", "--env", SIMULATED, "--episodes", "60", "--evaluation.farms", "2")
    code, output = training.ended()
    assert code == 0, output
    assert training.simulators() == []
    assert (training.run_dir / "evaluation.json").is_file()


def test_ctrl_c_leaves_no_process_and_no_step_behind(begun: Begun) -> None:
    """A worker that is interrupted early in a long chunk delivers the steps that it has."""
    slow = DOORS.replace("chunk_steps = 16", "chunk_steps = 5000").replace("= 64", "= 40000")
    training = begun("train", "--env", SIMULATED, "--env.arguments", '{"pause": 0.02}', "--no-report", toml=slow)
    until(lambda: len(training.simulators()) == 4, "a simulator for each environment of the worker")
    time.sleep(5.0)
    training.process.send_signal(signal.SIGINT)
    code, output = training.ended()
    assert code == 0, output
    assert training.simulators() == []
    found = audit(training.run_dir)
    assert found.clean
    assert 0 < found.steps["accepted"] == found.produced < 20_000


@pytest.mark.parametrize(
    ("option", "reason"),
    [
        (["--lockstep"], "because a lockstep run repeats whole chunks"),
        (["--algorithm.memory", "gru", "--algorithm.sequence-steps", "20"], "because networks with memory learn"),
    ],
    ids=["lockstep", "memory"],
)
def test_ctrl_c_names_and_counts_the_steps_that_nobody_can_take(begun: Begun, option: list[str], reason: str) -> None:
    """Where chunks must be whole, the chunk in progress is lost: the command says so, and the audit counts it."""
    slow = DOORS.replace("chunk_steps = 16", "chunk_steps = 5000").replace("= 64", "= 40000")
    pause = ["--env.arguments", '{"pause": 0.02}', "--no-report"]
    training = begun("train", "--env", SIMULATED, *pause, *option, toml=slow)
    until(lambda: len(training.simulators()) == 4, "a simulator for each environment of the worker")
    time.sleep(8.0)
    training.process.send_signal(signal.SIGINT)
    code, output = training.ended()
    assert code == 0, output
    assert reason in output
    found = audit(training.run_dir)
    assert found.clean
    assert 0 < found.steps["lost"] == found.produced < 20_000


def test_workers_that_crash_or_hang_are_replaced_and_leave_nothing(begun: Begun) -> None:
    """What a killed worker's environments had started is ended with it; a hanging call ends after the time limit."""
    for arguments, said in (
        ('{"crash": 40}', "rollout-0 ended with signal 9; restarting it"),
        ('{"hang": 40}', "s, longer than env.step_timeout 3; this process ends."),
    ):
        training = begun("train", "--env", SIMULATED, "--env.arguments", arguments, "--env.step-timeout", "3")
        code, output = training.ended()
        assert code == 1, output
        assert said in output
        assert ("took longer than env.step_timeout; workers were replaced." in output) == ("hang" in arguments)
        assert "all workers failed" in output
        assert training.simulators() == []
        (training.run_dir).rename(training.run_dir.with_name(f"run-{training.mark}"))


def test_a_run_whose_workers_end_as_if_they_were_done_is_ended(begun: Begun) -> None:
    """A library that exits with code 0 leaves a learner that trains with nobody; the command says so and fails."""
    arguments = ["--env", "toy_faults:Exiting", "--env.arguments", '{"after": 40, "code": 0}']
    code, output = begun("train", *arguments).ended()
    assert code == 1, output
    assert "all workers have ended with exit code 0, and the run is not finished" in output


def test_an_evaluation_that_is_ended_closes_its_environments(begun: Begun) -> None:
    """SIGTERM and Ctrl-C reach it inside a step."""
    for number, code in ((signal.SIGTERM, 143), (signal.SIGINT, 130)):
        evaluation = begun(
            "evaluate",
            "--env",
            SIMULATED,
            "--set",
            "env.arguments='{\"pause\": 0.1}'",
            "--policy",
            "random",
            "--farms",
            "1000:5000",
        )
        until(lambda command=evaluation: len(command.simulators()) == 32, "simulators")
        time.sleep(1.0)
        evaluation.process.send_signal(number)
        assert evaluation.ended()[0] == code
        assert evaluation.simulators() == []
