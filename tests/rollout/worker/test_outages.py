"""A simulator or robot that is away ends its episode and is waited for; a call that does not return is ended."""

import subprocess
import sys
import threading
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import pytest

from eia_sec.common.actors import TeamActors
from eia_sec.common.config import EnvConfig, ReplayConfig, RolloutConfig, RunConfig
from eia_sec.common.config.algorithms import EiaSecConfig
from eia_sec.common.errors import CancelledError, EnvironmentOutageError
from eia_sec.common.history.history import Timeout, read
from eia_sec.common.transitions import TERMINATED, TRANSITION, TRUNCATED
from eia_sec.rollout.envs import guard, watchdog
from eia_sec.rollout.envs.registry import environment_spec
from eia_sec.rollout.worker import outages
from eia_sec.rollout.worker.collector import Collector
from eia_sec.rollout.worker.outages import Outages

TOYS = str(Path(__file__).parents[1] / "envs")
CONFIG = RunConfig(
    env=EnvConfig("toy_faults:Away"),
    algorithm=EiaSecConfig(),
    rollout=RolloutConfig(environments=1, chunk_steps=12),
    replay=ReplayConfig(capacity=4096),
)


@pytest.fixture(autouse=True)
def _importable(monkeypatch):
    monkeypatch.syspath_prepend(TOYS)
    yield
    for name in ("toy_env", "toy_faults"):
        sys.modules.pop(name, None)


class Stop(threading.Event):
    """A stop signal whose pauses take no time."""

    def __init__(self):
        super().__init__()
        self.pauses = []

    def wait(self, timeout=None):
        self.pauses.append(timeout)
        return self.is_set()


def test_an_outage_truncates_the_episode_and_is_waited_for(capsys):
    """Its last step earns nothing, the pauses grow, and the next episode begins in the same chunk."""
    stop = Stop()
    away = Outages(stop)
    with closing(Collector(CONFIG, "w", 0, away)) as collector:
        actors = TeamActors.initial(collector.team, 4, 0)
        chunk = collector.collect(actors, 0.1, uniform=False)
        chunk.rows.check(collector.team)
    flag = chunk.rows.flag[(chunk.rows.flag & TRANSITION) > 0]
    assert [step for step, f in enumerate(flag) if f & TERMINATED] == [4, 11]
    assert [step for step, f in enumerate(flag) if f & TRUNCATED] == [6]
    assert [episode.steps for episode in chunk.episodes] == [5, 2, 5]
    assert not chunk.rows.reward[(chunk.rows.flag & TRANSITION) > 0][6].any()
    assert (stop.pauses, away.count, away.alarm) == ([1.0, 2.0], 1, "")
    assert "the environment is away: the arm is in emergency stop; outage 1." in capsys.readouterr().err


def test_a_worker_that_ends_does_not_wait_for_an_environment():
    """What it has collected before the outage is delivered, and after that there is nothing to collect."""
    stop = Stop()
    stop.set()
    with closing(Collector(CONFIG, "w", 0, Outages(stop))) as collector:
        actors = TeamActors.initial(collector.team, 4, 0)
        chunk = collector.collect(actors, 0.1, uniform=False)
        assert chunk.rows.steps == 7
        with pytest.raises(CancelledError):
            collector.collect(actors, 0.1, uniform=False)


@pytest.mark.parametrize("where", ["construction", "observation_space", "reset", "step"])
def test_the_trial_before_a_run_waits_for_an_environment(where, capsys):
    """Wherever it is away, each try is said with its pause, and in the end the spaces are known."""
    stop = Stop()
    config = replace(CONFIG, env=EnvConfig("toy_faults:AwayAt", f'{{"where": "{where}"}}'))
    sys.modules.pop("toy_faults", None)
    spec = environment_spec(config, trial=True, patience=Outages(stop))
    assert spec.team.agents == 3
    said = capsys.readouterr().err
    assert "the environment is away: no link to the arm; outage 1." in said
    if where != "step":
        assert stop.pauses == [1.0, 2.0]
        assert "the environment is still away after 2 tries; next in 2 s." in said
        assert "the environment is back." in said


def test_pauses_grow_up_to_a_minute_and_the_alarm_counts():
    """The alarm is the environment's sentence, with the number of outages."""
    stop = Stop()
    away = Outages(stop)
    away.begin("no link")
    for failed in range(1, 2000):
        away.pause(failed)
    assert stop.pauses[:3] == [1.0, 2.0, 4.0]
    assert max(stop.pauses) == outages.LONGEST_SECONDS
    assert away.alarm == "the environment is away: no link; outage 1."
    away.begin("no power")
    away.over()
    assert (away.count, away.alarm) == (2, "the environment is away: no power; outage 2.")
    away.over()
    assert away.alarm == ""


def test_who_has_no_patience_is_told():
    """An evaluation ends with the environment's own sentence."""
    with closing(Collector(CONFIG, "w", 0)) as collector, pytest.raises(EnvironmentOutageError, match="emergency stop"):
        collector.collect(TeamActors.initial(collector.team, 4, 0), 0.1, uniform=False)


def test_a_call_that_does_not_return_raises_an_alarm(monkeypatch):
    """The alarm names environment, method and time, and comes from another thread."""
    monkeypatch.setattr(watchdog, "PERIOD_SECONDS", 0.02)
    monkeypatch.setattr(watchdog, "ALARM_SECONDS", (0, 3600))
    said, heard = [], threading.Event()

    def speak():
        said.append(watchdog.call_alarm())
        heard.set()

    assert watchdog.call_alarm() == ""
    with closing(watchdog.Watchdog(0.0, speak)), guard.calling("a:b", "step()"):
        assert heard.wait(10.0)
    assert said[0] == "a:b has been in step() for 0 s."
    assert watchdog.call_alarm() == ""


@pytest.mark.slow
def test_a_call_is_ended_with_its_process_and_what_that_has_started():
    """After the limit the process says why and ends with code 1; so does a process that should end anyhow."""
    program = (
        "import time\n"
        "from eia_sec.rollout.envs import guard, watchdog\n"
        "watchdog.PERIOD_SECONDS = watchdog.STUCK_SECONDS = 0.05\n"
        "watchdog.Watchdog({}, lambda: None, lambda: {})\n"
        "with guard.calling('a:b', 'reset()'):\n"
        "    time.sleep(60)\n"
    )
    for limit, ends, said in ((0.2, False, "longer than env.step_timeout 0.2"), (0, True, "not waited for any longer")):
        done = subprocess.run(
            [sys.executable, "-c", program.format(limit, ends)],
            capture_output=True,
            text=True,
            timeout=50,
            check=False,
            start_new_session=True,
        )
        assert (done.returncode, "a:b has been in reset() for" in done.stderr) in {(1, True), (-15, True)}
        assert said in done.stderr


@pytest.mark.slow
def test_a_call_that_took_too_long_is_counted_before_the_process_ends(tmp_path):
    """The history of the worker keeps it, so that the next start reports it."""
    path = tmp_path / "rollout-0.jsonl"
    program = (
        "import sys, time\n"
        "from pathlib import Path\n"
        "from eia_sec.common.history.history import History, Start, Timeout\n"
        "from eia_sec.rollout.envs import guard, watchdog\n"
        "watchdog.PERIOD_SECONDS = 0.05\n"
        "history = History(Path(sys.argv[1]))\n"
        "history.add(Start('rollout', '0', 1))\n"
        "watchdog.Watchdog(0.1, lambda: None, timed_out=lambda: history.add(Timeout()))\n"
        "with guard.calling('a:b', 'step()'):\n"
        "    time.sleep(60)\n"
    )
    for times in (1, 2):
        subprocess.run([sys.executable, "-c", program, str(path)], timeout=50, check=False, start_new_session=True)
        assert sum(isinstance(record, Timeout) for record in read(path)[0]) == times
