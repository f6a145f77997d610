"""Whatever a user's environment returns, raises or sets, it is named, and the process goes on."""

import importlib
import math
import os
import signal
import subprocess
import sys
import warnings
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
import torch

from eia_sec.common.config import EnvConfig, RunConfig
from eia_sec.common.config.algorithms import IppoConfig
from eia_sec.common.errors import (
    ConfigError,
    ContractError,
    EnvironmentFaultError,
    EnvironmentOutageError,
    TerminatedError,
)
from eia_sec.common.transitions import LARGEST
from eia_sec.rollout.envs import guard
from eia_sec.rollout.envs.pettingzoo_batch import PettingZooBatch
from eia_sec.rollout.envs.registry import environment_spec


@pytest.fixture(autouse=True)
def _importable(monkeypatch):
    monkeypatch.syspath_prepend(str(Path(__file__).parent))
    yield
    for name in ("toy_env", "toy_faults", "toy_script"):
        sys.modules.pop(name, None)
    guard._theirs.clear()


def tried(name, **arguments):
    """Return what a trial of the environment says of it."""
    text = "{" + ", ".join(f'"{key}": {value}' for key, value in arguments.items()) + "}"
    return environment_spec(RunConfig(env=EnvConfig(name, text), algorithm=IppoConfig()), trial=True)


@pytest.mark.parametrize(
    ("what", "text"),
    [
        ("twice", r"possible_agents gave .*; PettingZoo asks for each agent's name once"),
        ("space", r"observation_space\('runner_0'\) gave \(2,\); PettingZoo asks for a gymnasium.spaces.Space"),
        ("observations alone", r"reset\(\) gave .*; PettingZoo asks for a pair of dictionaries"),
        ("unseen", r"reset\(\) returned no observation of agent keeper_0, which lives"),
        ("infos", r"reset\(\) gave .*'runner_1': None.*; PettingZoo asks for a dictionary as each agent's info"),
        ("four", r"step\(\) gave .*; PettingZoo asks for five dictionaries"),
        ("none", r"step\(\) gave None; PettingZoo asks for one number as the reward of agent keeper_0"),
        ("list", r"step\(\) gave array\(\[1.\]\); PettingZoo asks for one number as the reward of agent keeper_0"),
        ("huge", r"step\(\) returned a reward of 3e\+07 for agent keeper_0; the largest is 1e\+07: scale .* down"),
        ("long", r"step\(\) gave 10+.*; PettingZoo asks for one number as the reward of agent keeper_0"),
        ("nan", r"step\(\) returned a reward of nan for agent keeper_0; .*return a finite number"),
        ("rewardless", r"step\(\) gave {.*}; PettingZoo asks for a reward of agent keeper_0"),
        ("endless", r"step\(\) gave {.*}; PettingZoo asks for a termination of agent keeper_0"),
        ("texts", r"step\(\) gave 'False'; PettingZoo asks for True or False as the truncation of agent keeper_0"),
        ("flags", r"step\(\) gave array\(\[ True, False\]\); .* as the truncation of agent keeper_0"),
        ("alive twice", r"agents gave .*; PettingZoo asks for a list of the living ones among possible_agents"),
        ("nobody", r"agents gave \[\]; PettingZoo asks for at least one living agent after reset\(\)"),
        ("lists", r"possible_agents gave .*; PettingZoo asks for each agent's name once"),
        ("far", r"step\(\) returned an observation of agent runner_1 with 2.5e\+07 at index 1; .* 1e\+07: divide it"),
        ("infinite", r"step\(\) returned an observation of agent runner_1 with inf at index 1; .*return finite"),
        ("short", r"step\(\) returned the observation array\(\[0.\]\) of agent runner_1, but 1 numbers; .* Box"),
    ],
)
def test_a_broken_contract_is_one_sentence(what, text):
    """The sentence names module, method, what came, and what PettingZoo asks for."""
    with pytest.raises(ContractError, match=rf"^toy_faults:Wrong: {text}") as caught:
        tried("toy_faults:Wrong", what=f'"{what}"')
    assert "\n" not in str(caught.value)


def test_an_observation_that_is_too_large_names_its_agent():
    """The remedy is named, too."""
    with pytest.raises(ConfigError, match=r"agent keeper_0 has 164,430 numbers, .* images must be made smaller"):
        tried("toy_faults:Wrong", what='"pixels"')


@pytest.mark.parametrize(
    ("error", "text"),
    [
        (GeneratorExit(), r"step\(\) raised GeneratorExit: $"),
        (BaseException("base"), r"step\(\) raised BaseException: base$"),
        (ValueError("x" * 10**7), rf"step\(\) raised ValueError: x{{{guard.LONGEST}}}\.\.\.$"),
        (type("Mute", (Exception,), {"__str__": None})(), r"step\(\) raised Mute: \(its text raised TypeError\)$"),
    ],
)
def test_an_exception_of_any_shape_is_one_of_the_users(error, text):
    """What ends no process, has no text or one without end is shown like any other."""
    with pytest.raises(EnvironmentFaultError, match=text) as caught, guard.calling("a:b", "step()"):
        raise error
    assert len(str(caught.value)) < 4 * guard.LONGEST


@pytest.mark.parametrize("where", ["construction", "observation_space", "reset", "step"])
@pytest.mark.parametrize("exits", ["false", "true"])
def test_an_exception_keeps_the_users_traceback(where, exits):
    """The lines of the user's own code are shown, and none of this package's; an exit is such an exception."""
    with pytest.raises(EnvironmentFaultError) as caught:
        tried("toy_faults:Raising", where=f'"{where}"', exits=exits)
    text = str(caught.value)
    assert "toy_faults.py" in text
    assert "self.fail(" in text
    assert "guard.py" not in text
    last = text.splitlines()[-1]
    assert last.startswith("toy_faults:Raising: ")
    assert ("ended the program with exit code 0" if exits == "true" else "ValueError: no such gear") in last


def test_a_module_that_parses_arguments_sees_none_of_ours(capsys):
    """It ends with the module's own complaint and a sentence that says what imports may not do."""
    with pytest.raises(EnvironmentFaultError, match="import toy_script ended the program with exit code 2"):
        tried("toy_script:Env")
    assert "required: --level" in capsys.readouterr().err


def test_close_may_fail(capsys):
    """The other environments are closed all the same, and the failure is logged."""
    import toy_env  # noqa: PLC0415  # only importable inside the fixture

    batch = PettingZooBatch(EnvConfig("toy_faults:Raising", '{"where": "close"}'), 3)
    batch.close()
    assert toy_env.Relay.opened == toy_env.Relay.closed == 3
    assert capsys.readouterr().err.count("close() raised ValueError: no such gear") == 3


@pytest.mark.parametrize("after", [0, 1])
def test_a_user_who_ends_the_process_past_everything_is_named(after):
    """os._exit in the constructor or in a step becomes a sentence, and what was made is closed."""
    import toy_env  # noqa: PLC0415  # only importable inside the fixture

    method = r"step\(\)" if after else r"Leaving\(after=0\)"
    with pytest.raises(
        EnvironmentFaultError, match=rf"toy_faults:Leaving: {method} ended the program with exit code 7"
    ):
        tried("toy_faults:Leaving", after=after)
    assert toy_env.Relay.closed == after


@pytest.mark.slow
@pytest.mark.parametrize(("thread", "code", "said"), [(True, 1, "toy_faults:Leaving: a thread of it"), (None, 5, "")])
def test_a_thread_may_not_end_the_process_in_silence_and_a_fork_may(thread, code, said):
    """A thread's end is said before the process ends with code 1; a forked child's is its own matter."""
    program = (
        "import os, sys\n"
        "from eia_sec.rollout.envs import guard\n"
        "import toy_faults\n"
        "if {}:\n"
        "    guard.Guard('toy_faults:Leaving', toy_faults.Leaving, dict(thread=True))\n"
        "with guard.calling('a:b', 'step()'):\n"
        "    child = os.fork()\n"
        "    if not child:\n"
        "        os._exit(5)\n"
        "    sys.exit_code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])\n"
        "raise SystemExit(sys.exit_code)\n"
    )
    paths = os.pathsep.join([str(Path(__file__).parent), *filter(None, sys.path)])
    done = subprocess.run(
        [sys.executable, "-c", program.format(thread)],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
        env={**os.environ, "PYTHONPATH": paths},
    )
    assert done.returncode == code, done.stderr
    assert said in done.stderr


def test_environments_that_were_made_are_closed_when_a_later_one_fails(monkeypatch):
    """A batch that cannot be completed leaves nothing open."""
    import toy_env  # noqa: PLC0415  # only importable inside the fixture

    made = []

    def third_fails(self, *arguments, **keywords):
        made.append(self)
        assert len(made) < 3
        toy_env.Relay.opened += 1
        self.possible_agents = ["runner_0"]

    monkeypatch.setattr(toy_env.Relay, "__init__", third_fails)
    with pytest.raises(EnvironmentFaultError):
        PettingZooBatch(EnvConfig("toy_env:Relay"), 3)
    assert toy_env.Relay.opened == toy_env.Relay.closed == 2


def test_settings_of_the_process_are_the_users_inside_and_ours_outside():
    """Error state, default type, filters, folder, command line and signal handlers are as before after every call."""

    def settings():
        handlers = [signal.getsignal(number) for number in guard.SIGNALS]
        return np.geterr(), torch.get_default_dtype(), warnings.filters[:], os.getcwd(), sys.argv, handlers

    before = settings()
    with closing(PettingZooBatch(EnvConfig("toy_faults:Meddling"), 1)) as batch:
        assert settings() == before
        batch.reset(0, 1, 2)
        batch.step(np.zeros((1, 6), np.float32))
        assert settings() == before


@pytest.mark.parametrize("error", [KeyboardInterrupt, TerminatedError, EnvironmentOutageError])
def test_what_ends_this_process_passes_through(error):
    """Ctrl-C, SIGTERM and a declared outage are no mistakes of the environment's."""
    with pytest.raises(error), guard.calling("a:b", "step()"):
        raise error


def test_the_running_call_is_known():
    """Others can see since when a user's code has not returned."""
    assert guard.Guard.running is None
    with guard.calling("a:b", "step()"):
        assert guard.Guard.running is not None
        assert (guard.Guard.running.method, guard.Guard.running.seconds < 5.0) == ("step()", True)
    assert guard.Guard.running is None


def test_a_name_without_a_text_is_the_users_fault():
    """What sentences and pages call every agent is asked for where the user's code is guarded."""

    class Mute(str):
        def __str__(self):
            raise ValueError("no text")

    def make():
        environment = importlib.import_module("toy_env").Relay()
        environment.possible_agents = [Mute("runner_0")]
        return environment

    with pytest.raises(EnvironmentFaultError, match=r"make\(\) raised ValueError: no text$"):
        guard.Guard("a:make", make, {})


@pytest.mark.parametrize("numbers", [[1.0, 2, np.float32(3.0)], [np.float64(1.0), -LARGEST], []])
def test_plain_rewards_are_taken_as_they_are(numbers):
    """Floats of every width and whole numbers are rewards, up to the largest."""
    taken = an_environment()._rewards(dict(enumerate(numbers)))
    assert list(taken.values()) == numbers
    assert {*map(type, taken.values())} <= {float}


@pytest.mark.parametrize("odd", [math.nan, math.inf, np.float32(np.nan), -1.1e7, 10**400, np.ones(1), None, "1"])
@pytest.mark.parametrize("place", [0, 1, 2])
def test_one_odd_reward_among_others_is_named_wherever_it_is(odd, place):
    """The test of all rewards at once lets nothing through that an agent alone may not earn."""
    rewards = [1.0, 2.0]
    rewards.insert(place, odd)
    with pytest.raises(ContractError, match=f"agent {place}"):
        an_environment()._rewards(dict(enumerate(rewards)))


def an_environment():
    return guard.Guard("toy_env:Relay", importlib.import_module("toy_env").Relay, {})
