"""The public face: what `import eia_sec` offers."""

import math
import os
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from mytask.callbacks import Harder, Pruning
from mytask.env import Cover

import eia_sec
from eia_sec.common.config.files import with_values
from eia_sec.common.config.presets import preset
from eia_sec.common.errors import CallbackError, ConfigError, PolicyError, RunDirError
from eia_sec.common.policy_file import load_policy
from eia_sec.deploy.python.run import without_timeout

EXAMPLES = Path(__file__).parents[1] / "docs" / "examples"
SHORT = {"farm.world.steps": 20, "episodes": 2, "rollout.environments": 2, "rollout.chunk_steps": 20}
TINY = {
    "algorithm.hidden": 8,
    "algorithm.iteration_steps": 80,
    "algorithm.minibatch_steps": 40,
    "algorithm.epochs": 1,
    "rollout.environments": 2,
    "rollout.chunk_steps": 20,
}


class Noted(eia_sec.Callback):
    """Keeps what it saw."""

    def __init__(self):
        self.seen, self.ended = [], 0

    def on_progress(self, training):
        self.seen.append((training.environment_steps, training.updates, dict(training.metrics)))

    def on_end(self, training):
        self.ended += 1


def test_importing_it_loads_neither_torch_nor_the_simulator():
    """A bare import is cheap; the first use of a name loads what it needs."""
    code = "import sys, eia_sec; print(sorted({'torch', 'numba', 'numpy'} & set(sys.modules)), dir(eia_sec))"
    printed = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert printed.strip() == f"[] {sorted(eia_sec.__all__)}"


def test_an_unknown_name_is_an_attribute_error():
    """The lazy loading does not invent names."""
    with pytest.raises(AttributeError, match="no attribute 'tain'"):
        _ = eia_sec.tain


def test_a_policy_is_trained_saved_loaded_and_evaluated(tmp_path):
    """What comes back from the file scores what the trained policy scores, and a configuration is as good as a name."""
    run = eia_sec.train(preset="quick", settings=SHORT, run_dir=tmp_path / "run")
    run.policy.save(tmp_path / "policy.safetensors")
    loaded = eia_sec.load_policy(tmp_path / "policy.safetensors")
    assert loaded.actors.digest() == run.policy.actors.digest()
    found = eia_sec.evaluate(run.policy, preset="quick", settings=SHORT, farms=[1000, 1001])
    held = with_values(preset("quick"), SHORT)
    again = eia_sec.evaluate(tmp_path / "run" / "policy.safetensors", held, farms=[1000, 1001])
    assert found.total == again.total == run.evaluate(scenarios=2).total
    assert found.farms == (1000, 1001)
    low, high = found.interval
    assert low < found.total.reward < high


def test_one_scenario_says_nothing_about_the_others():
    """The interval of a single scenario is endless."""
    assert eia_sec.evaluate("static", settings=SHORT, farms=[1000]).interval == (-math.inf, math.inf)


def test_a_policy_acts_in_the_farm():
    """A shipped policy's actions by agent are steps of the farm."""
    policy, env = eia_sec.load_policy("trained"), eia_sec.make_env(settings={"farm.world.steps": 3})
    observations, _ = env.reset(seed=0)
    while env.agents:
        observations, rewards, *_ = env.step(policy.act(observations))
    assert len(rewards) == len(env.possible_agents)


def test_a_class_is_trained_in_a_thread_with_the_neutral_preset():
    """An environment of one's own needs neither name, preset nor main thread; its policy acts for its agents."""
    found, noted = [], Noted()

    def work():
        found.append(eia_sec.train(Cover, seed=3, steps=160, settings=TINY, callbacks=[noted]))

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    run = found[0]
    assert run.config.env.name == "mytask.env:Cover"
    assert run.config.algorithm.time_limit == "bootstrap"  # as the preset generic has it
    assert (run.config.seed, run.config.steps, run.config.episodes) == (3, 160, 0)
    assert [steps for steps, *_ in noted.seen] == [40, 80, 120, 160]
    assert noted.seen[-1][2]["charts/episodic_length"] == 20.0
    assert noted.ended == 1
    environment = Cover()
    observations, _ = environment.reset(seed=0)
    assert set(run.policy.act(observations)) == set(environment.agents)
    assert set(run.policy.act({"walker_1": observations["walker_1"]})) == {"walker_1"}
    assert run.evaluate(scenarios=3, sampled=True).total.reward != run.evaluate(scenarios=3).total.reward


def test_memory_is_the_policys():
    """A policy with memory acts on what it has observed before, until it is reset."""
    settings = TINY | {"algorithm.memory": "gru", "algorithm.sequence_steps": 20}
    policy = eia_sec.train(Cover, steps=80, settings=settings).policy
    environment = Cover()
    observations, _ = environment.reset(seed=1)
    before = policy._state.copy()
    policy.act(observations)
    assert not np.array_equal(policy._state, before)
    policy.reset()
    assert np.array_equal(policy._state, before)


def test_a_callback_stops_a_run():
    """A run that a callback stops keeps its policy and says why."""
    run = eia_sec.train(Cover, steps=4000, settings=TINY, callbacks=[Stop(400)])
    assert run.stopped == "seen enough"
    assert 400 <= run.environment_steps < 500


class Stop(eia_sec.Callback):
    """Stops a run after some steps."""

    def __init__(self, steps):
        self.steps = steps

    def on_progress(self, training):
        if training.environment_steps >= self.steps:
            training.stop("seen enough")


def test_a_callback_changes_the_environments_arguments():
    """Episodes that begin after a change have the new arguments; a change of the team is refused in a sentence."""
    sizes = []

    class Watched(Cover):
        def reset(self, seed=None, options=None):
            sizes.append(self.size)
            return super().reset(seed, options)

    globals()["Watched"], Watched.__qualname__ = Watched, "Watched"
    eia_sec.train(Watched, steps=160, settings=TINY, callbacks=[Larger(size=9)])
    assert sizes[-1] == 9
    assert 5 in sizes
    with pytest.raises(ConfigError, match="must keep the team"):
        eia_sec.train(Cover, steps=160, settings=TINY, callbacks=[Larger(agents=3)])


class Larger(eia_sec.Callback):
    """Changes arguments at once."""

    def __init__(self, **arguments):
        self.arguments = arguments

    def on_progress(self, training):
        training.set_arguments(**self.arguments)


def test_the_examples_callbacks_do_what_their_page_says():
    """One lengthens the line, the other ends a run that learns nothing."""

    class Fake(eia_sec.TrainingProgress):
        environment_steps = episodes = updates = 0
        progress, metrics, done = 0.6, {"charts/episodic_return": -16.0}, ()

        def stop(self, reason=""):
            self.done = (reason,)

        def set_arguments(self, **arguments):
            self.done = arguments

    bad, good = Fake(), Fake()
    Pruning().on_progress(bad)
    assert bad.done == ("no better than random actions",)
    good.metrics = {"charts/episodic_return": -5.0}
    Harder().on_progress(good)
    assert good.done == {"size": 8}


def test_mistakes_are_named(tmp_path):
    """A preset, a policy, an environment, a callback and a folder that do not fit are errors of one sentence."""
    with pytest.raises(ConfigError, match="there is no preset 'fast'"):
        eia_sec.train(preset="fast")
    with pytest.raises(PolicyError, match="nothing-here"):
        eia_sec.evaluate("nothing-here")
    with pytest.raises(ConfigError, match="make_env makes farms"):
        eia_sec.make_env(settings={"env.name": "mpe2:simple_spread_v3"})
    with pytest.raises(ConfigError, match="inside a function or is a lambda"):
        eia_sec.train(lambda: Cover(size=3))
    with pytest.raises(CallbackError, match=r"instance of a class derived from eia_sec\.Callback"):
        eia_sec.train(Cover, callbacks=[Stop])
    with pytest.raises(CallbackError, match=r"test_api\.Broken\.on_progress raised KeyError: 'nothing'"):
        eia_sec.train(Cover, steps=80, settings=TINY, callbacks=[Broken()])
    with pytest.raises(CallbackError, match="takes no arguments that change"):
        eia_sec.train(preset="quick", settings=SHORT, callbacks=[Larger(size=2)])
    with pytest.raises(PolicyError, match="acts for communication_0"):
        eia_sec.load_policy("trained").act({"somebody": [0.0]})


class Broken(eia_sec.Callback):
    """Raises."""

    def on_progress(self, training):
        raise KeyError("nothing")


@pytest.mark.slow
def test_what_a_script_defines_is_trained_there_and_nowhere_else(tmp_path):
    """A script's class trains in its own process; with workers, which cannot import it, one sentence says so."""
    script = tmp_path / "script.py"
    settings = repr(TINY)
    script.write_text(
        "import eia_sec\nfrom mytask.env import Cover\n\nclass Mine(Cover):\n    pass\n\n"
        f"print(eia_sec.train(Mine, steps=80, settings={settings}).environment_steps)\n"
        f"eia_sec.train(Mine, workers=1)\n"
    )
    searched = os.pathsep.join([str(EXAMPLES), os.environ.get("PYTHONPATH", "")])
    environment = {**os.environ, "PYTHONPATH": searched}
    done = subprocess.run(
        [sys.executable, str(script)], capture_output=True, text=True, cwd=tmp_path, env=environment, check=False
    )
    assert done.stdout == "80\n"
    assert "defined in a script or a notebook, which workers cannot import" in done.stderr


def test_a_run_directory_holds_the_run(tmp_path):
    """Configuration, metrics and policy are in the folder; a second run refuses it."""
    run = eia_sec.train(Cover, steps=80, settings=TINY, run_dir=tmp_path / "run")
    actors, metadata = load_policy(tmp_path / "run" / "policy.safetensors")
    assert actors.digest() == run.actors.digest()
    assert metadata["environment_steps"] == "80"
    assert (tmp_path / "run" / "metrics.jsonl").read_text().count('"kind": "episodes"') == 2
    with pytest.raises(RunDirError, match="already holds a run"):
        eia_sec.train(Cover, steps=80, settings=TINY, run_dir=tmp_path / "run")


class EndsBadly(eia_sec.Callback):
    """Raises when the run has ended."""

    def on_end(self, training):
        raise KeyError("nothing")


def test_a_callback_that_fails_at_the_end_costs_no_policy(tmp_path):
    """The policy and the run's end are on disk before `on_end`, and the folder is free again."""
    with pytest.raises(CallbackError, match=r"on_end raised KeyError"):
        eia_sec.train(Cover, steps=80, settings=TINY, callbacks=[EndsBadly()], run_dir=tmp_path / "run")
    assert load_policy(tmp_path / "run" / "policy.safetensors")[1]["environment_steps"] == "80"
    assert '"state": "finished"' in (tmp_path / "run" / "metrics.jsonl").read_text()
    with pytest.raises(RunDirError, match="already holds a run"):  # and is not in use
        eia_sec.train(Cover, steps=80, settings=TINY, run_dir=tmp_path / "run")


def test_other_machines_need_the_runs_name():
    """Two runs of one router must not have the same."""
    with pytest.raises(ConfigError, match="connect needs run"):
        eia_sec.train(Cover, connect="tcp/127.0.0.1:7447")


def test_the_callers_process_is_not_ended():
    """The limit of a call holds in workers; here it would end the program."""
    config = with_values(preset("generic").with_environment("mytask.env:Cover"), {"env.step_timeout": 3.0})
    assert without_timeout(config).env.step_timeout == 0.0
    slow = []

    class Sleepy(Cover):
        def reset(self, seed=None, options=None):
            if not slow:
                slow.append(time.sleep(1.6))
            return super().reset(seed, options)

    globals()["Sleepy"], Sleepy.__qualname__ = Sleepy, "Sleepy"
    run = eia_sec.train(Sleepy, steps=40, settings=TINY | {"env.step_timeout": 0.5})
    assert run.config.env.step_timeout == 0.5
