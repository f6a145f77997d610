"""The registry of algorithms, the shared options, and what a name switches on."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch

from eia_sec.common.config import EiaSecConfig, EliteConfig, RunConfig
from eia_sec.common.config.algorithms import ALGORITHMS, switched
from eia_sec.common.imitation import ImitationSchedule
from eia_sec.deploy.commands.training.train import TrainArguments
from eia_sec.deploy.options import base_configuration, parse
from eia_sec.learner.checkpoint.trainer_state import random_state, restored_random
from eia_sec.learner.off_policy.algorithm import Algorithm
from eia_sec.learner.off_policy.engine import Engine
from eia_sec.learner.on_policy.ppo import Ppo
from eia_sec.learner.registry import OFF_POLICY, ON_POLICY
from tests.learner.off_policy.test_engine import CHOOSERS, TEAM, batches, same_state
from tests.learner.off_policy.variants import variant

ROOT = Path(__file__).resolve().parents[3]
SMALL = EiaSecConfig(hidden=8, batch=16, actor_rate=2e-3, critic_rate=5e-3)


def test_every_line_of_the_registry_is_a_class_with_a_file_and_a_row():
    """Every algorithm has a class of the family of its options, a file of its own, and a row in the documentation."""
    page = (ROOT / "docs" / "reference" / "algorithms.md").read_text()
    registered = {**OFF_POLICY, **ON_POLICY}
    files = {name: f"{'/'.join(method.__module__.split('.')[1:])}.py" for name, method in registered.items()}
    assert len(set(files.values())) == len(files)
    assert set(ALGORITHMS) == set(registered)
    for family, base in ((OFF_POLICY, Algorithm), (ON_POLICY, Ppo)):
        assert all(issubclass(method, base) for method in family.values())
    for name, file in files.items():
        assert f"| `{name}` | `{file}` |" in page, f"make docs adds the row of {name}"


@pytest.mark.parametrize(
    ("name", "sections", "joint"),
    [
        ("eia-sec", ("replay", "exploration", "elite"), False),
        ("maddpg", ("replay", "exploration"), True),
        ("matd3", ("replay", "exploration"), True),
        ("masac", ("replay", "exploration"), True),
        ("vdn", ("replay",), False),
        ("qmix", ("replay",), False),
    ],
)
def test_a_name_decides_which_parts_there_are(name, sections, joint):
    """Only EIA-SEC has an ensemble and imitates, unless switched off; only the baselines' critics are joint."""
    config = switched(EiaSecConfig(), name)
    assert (config.name, config.sections, config.joint_critics) == (name, sections, joint)
    assert config.uses_ensemble == ("elite" in sections)
    assert not variant(config, name, ensemble=False).uses_ensemble
    run = RunConfig(algorithm=config)
    assert ImitationSchedule.of(run).is_due(0, 10) == ("elite" in sections)
    if "elite" in sections:
        assert not ImitationSchedule.of(replace(run, elite=EliteConfig(enabled=False))).is_due(0, 10)


@pytest.mark.parametrize("words", [["--algorithm", "matd3"], ["--algorithm=matd3"], ["--algorithm.name", "matd3"]])
def test_the_command_line_names_an_algorithm(words):
    """The short form beside options of the section, as the long form."""
    defaults = TrainArguments(settings=base_configuration(words))
    config = parse(TrainArguments, [*words, "--algorithm.hidden", "32"], "train", defaults).settings
    assert (config.algorithm.name, config.algorithm.hidden) == ("matd3", 32)


@pytest.mark.parametrize("name", OFF_POLICY)
def test_a_state_put_into_a_fresh_engine_goes_on_alike(name):
    """An engine that takes another's tensors and generator does the same updates from there, bit for bit."""
    config = variant(SMALL, name)
    team = TEAM if config.continuous_actions else CHOOSERS
    one, other = Engine(config, team, 3), Engine(config, team, 4)
    first, second = batches(team, config, 2, torch.float32)
    one.update(first)
    for tensor_name, tensor in other.tensors().items():
        tensor.copy_(one.tensors()[tensor_name])
    other.random = restored_random(random_state(one.random))
    one.update(second)
    assert not same_state(one, other)
    other.update(second)
    assert same_state(one, other)


@pytest.mark.parametrize(("name", "period"), [("eia-sec", 1), ("maddpg", 1), ("matd3", 2), ("masac", 1)])
def test_actors_step_once_a_period(name, period):
    """The actors change in the last update of every period, and in no other."""
    config = variant(SMALL, name)
    assert OFF_POLICY[name].actor_period(config) == period
    engine = Engine(config, TEAM, 0)
    steps = []
    for batch in batches(TEAM, config, 2 * period, torch.float32):
        before = engine.algorithm.actors.networks.flat.detach().clone()
        engine.update(batch)
        steps.append(not torch.equal(engine.algorithm.actors.networks.flat.detach(), before))
    assert steps == 2 * [*[False] * (period - 1), True]
