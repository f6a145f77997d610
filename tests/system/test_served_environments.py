"""Environments that others serve over Zenoh, as real processes: they come, crash, return and refuse strangers."""

import json
import re
import shlex
import signal
import struct
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from eia_sec.common.config import EnvConfig
from eia_sec.common.errors import EnvironmentOutageError
from eia_sec.common.transport.bus import Bus
from eia_sec.common.transport.endpoint import Endpoint, free_endpoint
from eia_sec.deploy.monitor.audit import audit
from eia_sec.deploy.security import authority
from eia_sec.rollout.envs.base import Reach
from eia_sec.rollout.envs.pettingzoo_batch import PettingZooBatch
from eia_sec.rollout.remote.served import ServedEnvironments
from tests.security.conftest import YEAR, Identity
from tests.system.fleet import until

PAGE = Path(__file__).parents[2] / "docs" / "how-to" / "remote_environment.md"
SECOND = Path(__file__).parents[1] / "rollout" / "remote" / "second_environment.py"
SETTINGS = (
    *("--rollout.chunk-steps", "50", "--algorithm.iteration-steps", "200", "--algorithm.minibatch-steps", "50"),
    *("--algorithm.hidden", "16"),
)
Began = Callable[..., subprocess.Popen[str]]


@pytest.fixture
def began(tmp_path: Path, request: pytest.FixtureRequest) -> Began:
    """Start programs that are ended with the test; each has a log of its name."""

    def begin(log: str, *words: str, folder: Path | None = None) -> subprocess.Popen[str]:
        with (tmp_path / log).open("a") as output:
            process = subprocess.Popen([sys.executable, *words], stdout=output, stderr=output, text=True, cwd=folder)
        request.addfinalizer(lambda: (process.kill(), process.wait(10)))
        return process

    return begin


def toy(name: str, endpoint: object, *options: str) -> tuple[str, ...]:
    return ("-m", "tests.rollout.remote.toy_served", name, str(endpoint), *options)


def train(run: Path, endpoint: object, *options: str) -> tuple[str, ...]:
    named = ("--run-dir", str(run), "--endpoint", str(endpoint), "--env", "zenoh:site-*")
    return ("-m", "eia_sec.deploy.cli", "train", *named, *SETTINGS, *options)


def steps(run: Path) -> int:
    """Return the environment steps that the learner has recorded."""
    path = run / "metrics.jsonl"
    lines = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
    return max((json.loads(line).get("environment_steps", 0) for line in lines if line.endswith("}")), default=0)


def batch(bus: Bus, pattern: str, count: int) -> PettingZooBatch:
    served = ServedEnvironments(Reach(bus, "test/0"), pattern)
    return PettingZooBatch(EnvConfig(f"zenoh:{pattern}"), count, boxes=False, make=served.make)


def when_free(attempt: Callable[[], PettingZooBatch]) -> PettingZooBatch:
    found: list[PettingZooBatch] = []

    def tried() -> bool:
        try:
            found.append(attempt())
        except EnvironmentOutageError:
            return False
        return True

    until(tried, "a free environment")
    return found[0]


def test_training_goes_on_while_environments_come_crash_and_return(tmp_path: Path, began: Began) -> None:
    """Each kill costs a running episode, which is counted, and nothing else: unexplained 0, and the run finishes."""
    endpoint, run = free_endpoint(), tmp_path / "run"
    training = began("train", *train(run, endpoint, "--workers", "2", "--steps", "6000"))
    first = began("site-a", *toy("site-a", endpoint, "--pause", "0.002"))
    until(lambda: steps(run) >= 400, "training with one environment")
    began("site-b", *toy("site-b", endpoint, "--pause", "0.002"))
    for _ in range(2):
        before = steps(run)
        until(lambda before=before: steps(run) >= before + 600, "training with both")
        first.send_signal(signal.SIGKILL)
        first.wait(10)
        time.sleep(0.5)
        first = began("site-a", *toy("site-a", endpoint, "--pause", "0.002"))
    assert training.wait(200) == 0, (tmp_path / "train").read_text()
    found = audit(run)
    assert found.clean
    assert found.unexplained == []
    assert found.steps["accepted"] >= 6000
    logs = "".join((run / "logs" / f"rollout-{index}.log").read_text() for index in range(2))
    assert logs.count("the environment is away: ") >= 3  # one worker waited for site-b, and site-a was killed twice
    assert logs.count("the environment is back.") >= 3
    assert (tmp_path / "site-b").read_text().count("is taken by") >= 1


def test_a_run_resumes_and_is_evaluated_on_what_is_served_by_then(tmp_path: Path, began: Began) -> None:
    """A resume begins before any environment is there, waits for one, and goes on with another one than before."""
    endpoint, run = free_endpoint(), tmp_path / "run"
    training = began("train", *train(run, endpoint, "--steps", "3000"))
    site = began("site-a", *toy("site-a", endpoint, "--pause", "0.002"))
    until(lambda: steps(run) >= 600, "training")
    training.send_signal(signal.SIGINT)
    assert training.wait(60) == 0
    site.kill()
    again = began("again", *train(run, endpoint, "--steps", "3000", "--resume"))
    until(lambda: "no environment called site-* is served" in _log(run), "the worker to look for an environment")
    began("site-c", *toy("site-c", endpoint))
    assert again.wait(200) == 0, (tmp_path / "again").read_text()
    assert audit(run).clean
    words = ("-m", "eia_sec.deploy.cli", "evaluate", "--run-dir", str(run), "--env", "zenoh:site-c", "--json")
    evaluation = began("evaluation", *words, "--endpoint", str(endpoint), "--farms", "1000:1003")
    assert evaluation.wait(100) == 0, (tmp_path / "evaluation").read_text()
    assert '"steps": 25.0' in (tmp_path / "evaluation").read_text()


def _log(run: Path) -> str:
    path = run / "logs" / "rollout-0.log"
    return path.read_text() if path.exists() else ""


def test_a_second_implementation_speaks_from_the_page(tmp_path: Path, began: Began) -> None:
    """A program with zenoh and msgpack alone serves a task, whose numbers arrive as it sends them."""
    endpoint = free_endpoint()
    with Bus.listen(endpoint, "control") as bus:
        began("north", str(SECOND), "north-1", str(endpoint))
        with closing(when_free(lambda: batch(bus, "north-*", 1))) as environments:
            assert [group.choices for group in environments.team.groups] == [(2,), (2,)]
            for episode in range(3):
                environments.reset(0, 0, episode)
                for step in range(1, 11):
                    environments.step(np.array([[1.0, step % 2]], np.float32))
                    south = (step + 1) // 2
                    assert environments.observation.tolist() == [[step, step, south, step]]
                    assert environments.reward.tolist() == [[1.0, step % 2]]
                assert environments.terminated.tolist() == [True]
        with closing(when_free(lambda: batch(bus, "north-1", 1))) as environments:
            environments.reset(0, 0, 0)
            assert struct.pack("<4f", *environments.observation[0]) == bytes(16)


def test_copies_of_one_and_several_environments_move_together(tmp_path: Path, began: Began) -> None:
    """Four copies in two processes take the time of the two in one process, not of all four."""
    endpoint = free_endpoint()
    with Bus.listen(endpoint, "control") as bus:
        for name in ("site-a", "site-b"):
            began(name, *toy(name, endpoint, "--pause", "0.3", "--copies", "2"))
        with closing(when_free(lambda: batch(bus, "site-*", 4))) as environments:
            for index in range(4):
                environments.reset(index, 0, index)
            start = time.monotonic()
            for _ in range(4):
                environments.step(np.ones((4, 2), np.float32))
            seconds = time.monotonic() - start
        assert environments.time.tolist() == [4] * 4
        assert 2.4 <= seconds < 4.4  # two copies after one another, in two processes at once; 4.8 s one by one


def test_a_name_is_served_once(tmp_path: Path, began: Began) -> None:
    """A second process of the same name is refused in words, and its exit code is not 0."""
    endpoint = free_endpoint()
    with Bus.listen(endpoint, "control") as bus:
        began("first", *toy("site-a", endpoint))
        when_free(lambda: batch(bus, "site-a", 1)).close()
        second = began("second", *toy("site-a", endpoint))
        assert second.wait(40) != 0
        assert "another process serves an environment named site-a there" in (tmp_path / "second").read_text()


def test_the_page_is_run_as_it_stands(tmp_path: Path, began: Began) -> None:
    """Programs and commands of docs/how-to/remote_environment.md work, here on a free port and with few steps."""
    text, endpoint = PAGE.read_text(encoding="utf-8"), free_endpoint()
    programs = re.findall(r"```python\n(.*?)```", text, re.S)
    site, fast = (program.replace("tcp/127.0.0.1:7447", str(endpoint)) for program in programs[:2])
    lines = [line for block in re.findall(r"```sh\n(.*?)```", text, re.S) for line in block.splitlines()]
    train, resume, evaluate, copies = (
        shlex.split(line)[1:] for line in lines if line.startswith("eia-sec") and "zenoh:" in line and "tls" not in line
    )
    assert [words[0] for words in (train, resume, evaluate, copies)] == ["train", "train", "evaluate", "train"]

    def command(log: str, words: list[str], *more: str) -> subprocess.Popen[str]:
        return began(log, "-m", "eia_sec.deploy.cli", *words, "--endpoint", str(endpoint), *more, folder=tmp_path)

    for name, program in (("site.py", site), ("fast.py", fast)):
        (tmp_path / name).write_text(program)
    began("site", "site.py", folder=tmp_path)
    training = command("train", train, "--steps", "4000", *SETTINGS)
    until(lambda: steps(tmp_path / "runs/site") >= 400, "training")
    training.send_signal(signal.SIGINT)
    assert training.wait(60) == 0
    assert command("resume", resume, "--steps", "4000", *SETTINGS).wait(200) == 0, (tmp_path / "resume").read_text()
    assert command("evaluate", evaluate).wait(100) == 0, (tmp_path / "evaluate").read_text()
    began("fast", "fast.py", folder=tmp_path)
    copied = command("copies", copies, "--steps", "4000", "--algorithm.hidden", "16")
    assert copied.wait(200) == 0, (tmp_path / "copies").read_text()
    assert audit(tmp_path / "runs/fast").clean


def test_strangers_serve_nothing(tmp_path: Path, began: Began) -> None:
    """Without a certificate, with one of another authority or role, or off the list, an environment is never seen."""
    folder, other = tmp_path / "keys", tmp_path / "other"
    for each in (folder, other):
        authority.create(each)
    authority.issue(folder, Identity.parse("learner.learner"), ["127.0.0.1"], YEAR)
    for name in ("site-a", "site-b"):
        authority.issue(folder, Identity("environment", name), [], YEAR)
    authority.issue(folder, Identity.parse("rollout.site-d"), [], YEAR)
    authority.issue(other, Identity.parse("environment.site-c"), [], YEAR)
    authority.revoke(folder, Identity.parse("environment.site-b"))
    endpoint = Endpoint.parse(str(free_endpoint()), folder / "learner.learner")
    with Bus.listen(endpoint, "control") as bus:
        began("plain", *toy("site-p", f"tcp/127.0.0.1:{endpoint.port}"))
        began("unlisted", *toy("site-b", endpoint, "--tls", str(folder / "environment.site-b")))
        began("foreign", *toy("site-c", endpoint, "--tls", str(other / "environment.site-c")))
        wrong = began("wrong", *toy("site-d", endpoint, "--tls", str(folder / "rollout.site-d")))
        stolen = began("stolen", *toy("site-x", endpoint, "--tls", str(folder / "environment.site-a")))
        assert wrong.wait(30) != 0
        assert stolen.wait(30) != 0
        assert (
            "belongs to environment.site-a, but this process is environment.site-x" in (tmp_path / "stolen").read_text()
        )
        began("right", *toy("site-a", endpoint, "--tls", str(folder / "environment.site-a")))
        with closing(when_free(lambda: batch(bus, "*", 1))) as environments:
            environments.reset(0, 0, 0)
            with pytest.raises(EnvironmentOutageError, match="no environment called site-b is served"):
                batch(bus, "site-b", 1)
            served = ServedEnvironments(Reach(bus, "test/1"), "*")
            assert served._names() == ["site-a"]
