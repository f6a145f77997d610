"""Plug-ins: what a package of a user's own adds, where it is recorded, and which sentence each mistake gets."""

import subprocess
import sys
from dataclasses import replace
from types import ModuleType

import numpy as np
import pytest
from mytask.env import Cover

import eia_sec
from eia_sec.common import plugins
from eia_sec.common.config import ALGORITHM_CONFIGS, RunConfig
from eia_sec.common.config.files import from_toml, method_of, read_saved, to_toml
from eia_sec.common.config.plugin_names import LOADED, PluginNames
from eia_sec.common.config.presets import preset
from eia_sec.common.errors import ConfigError, PluginError, PolicyError, UsageError
from eia_sec.deploy.cli import with_plugins, without_plugins
from eia_sec.deploy.options import base_configuration
from eia_sec.learner.registry import off_policy, on_policy
from eia_sec.rollout.evaluation import evaluate_run
from eia_sec.rollout.policies import run_policy
from tests.test_api import TINY

pytestmark = pytest.mark.usefixtures("nothing_stays_loaded")


def module(monkeypatch, **members):
    """Make a module named `mine` with these members."""
    found = ModuleType("mine")
    vars(found).update(members)
    monkeypatch.setitem(sys.modules, "mine", found)
    return found


def test_a_loss_of_ones_own_is_trained_on_policy():
    """Its options are part of the configuration, which names the plug-in; another penalty gives another policy."""
    runs = [
        eia_sec.train(
            "cover",
            algorithm="smooth",
            plugins=["mytask"],
            steps=80,
            settings=TINY | {"algorithm.penalty": penalty, "algorithm.epochs": 3},
        )
        for penalty in (2.0, 2.0, 50.0)
    ]
    assert runs[0].config.env.name == "mytask.env:Cover"
    assert runs[0].config.plugins == ("mytask",)
    first, again, other = (run.actors.digest() for run in runs)
    assert first == again != other


def test_a_loss_of_ones_own_is_trained_off_policy():
    """The critics' loss is the plug-in's: indifferent optimism is MADDPG, any other is not."""
    settings = {
        "algorithm.hidden": 8,
        "algorithm.batch": 16,
        "rollout.environments": 2,
        "rollout.chunk_steps": 20,
        "replay.capacity": 512,
        "replay.warmup_steps": 20,
        "farm.world.steps": 20,
    }

    def digest(name, **more):
        run = eia_sec.train(preset="eia-sec", algorithm=name, plugins=["mytask"], episodes=4, settings=settings | more)
        return run.actors.digest()

    plugins.load("mytask")
    assert digest("bold", **{"algorithm.optimism": 1.0}) == digest("maddpg")
    assert digest("bold") != digest("maddpg")


def test_a_heuristic_of_ones_own_is_evaluated():
    """Its name is a policy in any environment, and it does better than random actions."""
    plugins.load("mytask")
    config = preset("generic").with_environment("mytask.env:Cover")
    assert run_policy("nearest", config) is not None
    rewards = [eia_sec.evaluate(name, Cover, farms=range(1000, 1010)).total.reward for name in ("nearest", "random")]
    assert rewards[0] > rewards[1] + 3.0


def test_its_callbacks_are_called(monkeypatch):
    """A run that names the plug-in calls them; one that does not, does not."""
    seen = []

    class Seen(eia_sec.Callback):
        def on_progress(self, training):
            seen.append(training.environment_steps)

    module(monkeypatch, plugin=plugins.Plugin(callbacks=["mine:Seen"]), Seen=Seen)
    eia_sec.train(Cover, steps=80, settings=TINY, plugins=["mine"])
    assert seen == [40, 80]
    eia_sec.train(Cover, steps=80, settings=TINY)
    assert seen == [40, 80]


def test_a_saved_run_loads_nothing_that_was_not_named():
    """Its configuration is refused with the option that is missing, and reads back once the plug-in is loaded."""
    plugins.load("mytask")
    run = base_configuration(["--env", "mytask.env:Cover", "--algorithm", "smooth"])
    text = to_toml(run)
    assert run.plugins == ("mytask",)
    assert read_saved(text) == run
    assert method_of(run) == method_of(replace(run, plugins=PluginNames(("mytask", "another"))))
    LOADED.clear()
    with pytest.raises(ConfigError, match=r"uses the plug-in mytask; add --plugin mytask to run its code\."):
        read_saved(text)
    with pytest.raises(ConfigError, match="plugins must be a list of names, not 3"):
        from_toml("plugins = 3", RunConfig())


def test_naming_a_plugin_loads_no_torch():
    """A coordinator or a worker that names it loads what it needs alone."""
    code = "import sys, eia_sec.common.plugins as p; p.load('mytask'); print('torch' in sys.modules)"
    own = {"PYTHONPATH": ":".join(part for part in sys.path if part)}
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=own, check=True)
    assert found.stdout == "False\n"


def test_the_command_line_names_plugins_anywhere():
    """`--plugin` may stand anywhere behind the command, any number of times; short names are written out."""
    words = ["train", "--plugin", "mytask", "--env", "cover", "--plugin=other", "--seed", "1"]
    assert without_plugins(words) == (["train", "--env", "cover", "--seed", "1"], ["mytask", "other"])
    assert with_plugins(["train", "--env", "cover", "--env.name=cover"], ["mytask"]) == [
        *("train", "--env", "mytask.env:Cover", "--env.name=mytask.env:Cover")
    ]
    for wrong in (["train", "--plugin"], ["train", "--plugin", "--env"]):
        with pytest.raises(UsageError, match="--plugin needs the name"):
            without_plugins(wrong)


class Half:
    """Lacks a method."""

    def reset(self, environments, index):
        """Do nothing."""


@pytest.mark.parametrize(
    ("members", "said"),
    [
        ({}, "plug-in mine: plugin is nothing, and must be an eia_sec.Plugin"),
        ({"plugin": {"algorithms": {}}}, "plug-in mine: plugin is a dict"),
        ({"plugin": plugins.Plugin(algorithms={"ippo": plugins.PluginAlgorithm("a:b")})}, "the name ippo is taken"),
        ({"plugin": plugins.Plugin(environments={"farm": "a:b"})}, "the name farm is taken"),
        ({"plugin": plugins.Plugin(algorithms={"x": "a:b"})}, "algorithm x is a str, and must be an"),
        ({"plugin": plugins.Plugin(algorithms={"a b": plugins.PluginAlgorithm("a:b")})}, "'a b' is no name of 1 to 63"),
        ({"plugin": plugins.Plugin(algorithms={"x": plugins.PluginAlgorithm("a:b", int)})}, "its options are a type"),
        ({"plugin": plugins.Plugin(heuristics={"x": "mine"})}, "a heuristic is named as module:name, not 'mine'"),
    ],
)
def test_a_plugin_that_cannot_be_used_is_named(monkeypatch, members, said):
    """The sentence names the plug-in, what is wrong in it, and what was expected."""
    module(monkeypatch, **members)
    with pytest.raises(PluginError, match=said):
        plugins.load("mine")
    assert LOADED == []


def test_what_cannot_be_imported_or_made_is_named(monkeypatch):
    """A plug-in, a heuristic and a learner that are missing, and a class without a method."""
    with pytest.raises(PluginError, match="there is no plug-in nowhere: No module named 'nowhere'"):
        plugins.load("nowhere")
    own = plugins.Plugin(
        algorithms={"gone": plugins.PluginAlgorithm("mine:Gone"), "odd": plugins.PluginAlgorithm("mine:Half")},
        heuristics={"half": "mine:Half"},
        callbacks=["mine:Half"],
    )
    module(monkeypatch, plugin=own, Half=Half)
    plugins.load("mine")
    with pytest.raises(PluginError, match="plug-in mine: heuristic half: mine:Half has no method act"):
        plugins.heuristic("half")
    with pytest.raises(PluginError, match="plug-in mine: algorithm gone: mine:Gone cannot be imported: AttributeError"):
        on_policy("gone")
    with pytest.raises(PluginError, match=r"plug-in mine: Half must derive from .*Ppo, because"):
        on_policy("odd")
    with pytest.raises(PluginError, match=r"callback mine:Half is a Half; it must derive from eia_sec\.Callback"):
        plugins.callbacks(["mine"])


@pytest.mark.parametrize(
    ("found", "said"),
    [
        (lambda self, world: np.zeros((1, 2)), r"act returned \[1, 2\] numbers, and must return \[3, 2\]"),
        (lambda self, world: np.full((3, 2), np.nan), "act returned something that is no finite number"),
        (lambda self, world: np.full((3, 2), "left"), "act returned something that is no finite number"),
        (lambda self, world: "left", "act returned a str, and must return a ndarray"),
        (lambda self, world: 1 / 0, "act raised ZeroDivisionError: division by zero"),
    ],
)
def test_actions_of_a_heuristic_that_are_none_are_named(monkeypatch, found, said):
    """Whatever an environment would not take is a sentence about the heuristic."""
    module(monkeypatch, Wrong=type("Wrong", (), {"reset": lambda self, world, index: None, "act": found}))
    config = preset("generic").with_environment("mytask.env:Cover")
    with pytest.raises(PluginError, match=rf"heuristic mine:Wrong: {said}"):
        evaluate_run(config, run_policy("mine:Wrong", config), range(3), 1, name="")


def test_a_misspelt_heuristic_is_found():
    """The sentence names the one that was meant."""
    plugins.load("mytask")
    with pytest.raises(PolicyError, match=r"no policy 'nearst'; did you mean nearest\? Give random, a policy file"):
        run_policy("nearst", preset("generic").with_environment("mytask.env:Cover"))


@pytest.mark.parametrize(
    ("found", "said"),
    [
        (lambda self, ratio, advantage: 1 / 0, "surrogate raised ZeroDivisionError: division by zero"),
        (lambda self, ratio, advantage: 0.0, "surrogate returned a float, and must return a Tensor"),
    ],
)
def test_a_loss_that_fails_is_named(monkeypatch, found, said):
    """An exception in a user's method, and a result of another type, name plug-in, class and method."""
    from eia_sec.learner.on_policy.ippo import Ippo  # noqa: PLC0415  (torch loads only here)

    broken = type("Broken", (Ippo,), {"surrogate": found, "__module__": "mine"})
    own = plugins.Plugin(algorithms={"broken": plugins.PluginAlgorithm("mine:Broken")})
    module(monkeypatch, plugin=own, Broken=broken)
    with pytest.raises(PluginError, match=rf"plug-in mine: mine\.Broken\.{said}"):
        eia_sec.train(Cover, algorithm="broken", plugins=["mine"], steps=80, settings=TINY)
    with pytest.raises(PluginError, match="must derive from"):
        off_policy("broken")


def test_options_have_a_name_defaults_and_values():
    """An algorithm's options are those of its dataclass under the plug-in's name, and are read like all others."""
    plugins.load("mytask")
    options = ALGORITHM_CONFIGS["smooth"]()
    assert (options.name, options.penalty) == ("smooth", 2.0)
    config = preset("generic").with_algorithm("smooth")
    assert from_toml("algorithm.penalty = 3", config).algorithm.penalty == 3.0
    with pytest.raises(ConfigError, match=r"algorithm\.penalty must be a number"):
        from_toml("algorithm.penalty = true", config)


def test_a_runs_own_plugins_stay_with_it(monkeypatch):
    """A run begun again from its configuration names its plug-ins, as does one whose algorithm is a plug-in's."""
    seen = []

    class Seen(eia_sec.Callback):
        def on_progress(self, training):
            seen.append(training.environment_steps)

    module(monkeypatch, plugin=plugins.Plugin(callbacks=["mine:Seen"]), Seen=Seen)
    run = eia_sec.train(Cover, steps=80, settings=TINY, plugins=["mine"])
    again = eia_sec.train(run.config)
    assert again.config.plugins == ("mine",)
    assert seen == [40, 80, 40, 80]
    plugins.load("mytask")
    assert eia_sec.train(Cover, algorithm="smooth", steps=80, settings=TINY).config.plugins == ("mytask",)
    with pytest.raises(ConfigError, match=r"plugins is a list of names, \['mytask'\] for one"):
        eia_sec.train(Cover, plugins="mytask")


def test_a_policy_acts_in_an_environment_with_a_short_name(tmp_path):
    """Its actions are the environment's own, and a name that nobody has is refused."""
    run = eia_sec.train(Cover, steps=80, settings=TINY)
    run.policy.save(tmp_path / "cover.safetensors")
    with pytest.raises(ConfigError, match="must be module:name or an environment of this package"):
        eia_sec.load_policy(tmp_path / "cover.safetensors", "cover")
    policy = eia_sec.load_policy(tmp_path / "cover.safetensors", "cover", plugins=["mytask"])
    observations, _ = Cover().reset(seed=0)
    assert set(policy.act(observations)) == {"walker_0", "walker_1"}
    found = eia_sec.evaluate(policy, "cover", plugins=["mytask"], farms=[1000])
    assert found.total.steps == 20.0


class Slow(eia_sec.Callback):
    """Opens something when it is made."""

    made = 0

    def __init__(self):
        Slow.made += 1


def test_a_launcher_checks_callbacks_and_makes_none(monkeypatch):
    """The learner makes them; a class that is no callback is refused before."""
    module(monkeypatch, plugin=plugins.Plugin(callbacks=["mine:Slow"]), Slow=Slow)
    plugins.load("mine")
    plugins.check_callbacks(["mine"])
    assert Slow.made == 0
    sys.modules["mine"].Slow = Half
    with pytest.raises(PluginError, match="callback mine:Slow is a Half; it must derive"):
        plugins.check_callbacks(["mine"])


def test_a_heuristic_that_fails_is_named(monkeypatch):
    """An exception and another result name plug-in, heuristic and method; a policy of this package keeps its name."""

    class Odd:
        def reset(self, environments, index):
            raise KeyError("nothing")

        def act(self, environments):
            return [0.0]

    module(monkeypatch, plugin=plugins.Plugin(heuristics={"odd": "mine:Odd"}), Odd=Odd)
    with pytest.raises(PluginError, match="plug-in mine: heuristic odd: reset raised KeyError: 'nothing'"):
        eia_sec.evaluate("odd", Cover, farms=[1000], plugins=["mine"])
    with pytest.raises(PluginError, match="act returned a list, and must return a ndarray"):
        plugins.heuristic("odd").act(None)
    plugins._PLUGINS.clear()
    LOADED.clear()
    module(monkeypatch, plugin=plugins.Plugin(heuristics={"greedy": "mine:Odd"}), Odd=Odd)
    with pytest.raises(PluginError, match="plug-in mine: the name greedy is taken"):
        eia_sec.evaluate("greedy", Cover, farms=[1000], plugins=["mine"])


def test_a_plugin_that_lacks_a_package_exists(tmp_path, monkeypatch):
    """Only a plug-in that is missing itself is not there; one that imports something missing says what."""
    (tmp_path / "needy.py").write_text("import nowhere_at_all\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    with pytest.raises(PluginError, match=r"plug-in needy cannot be imported: .*'nowhere_at_all'"):
        plugins.load("needy")
    with pytest.raises(PluginError, match=r"there is no plug-in nowhere\.at\.all"):
        plugins.load("nowhere.at.all")


def test_errors_of_a_method_inside_another_are_named_once():
    """The method that raised is named, and not those that called it."""
    inner = plugins.guarded(lambda: 1 / 0, "inner", (object,))
    with pytest.raises(PluginError, match=r"^inner raised ZeroDivisionError"):
        plugins.guarded(inner, "outer", (object,))()
