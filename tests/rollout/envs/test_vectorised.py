"""Environments that step as one batch are a batch like any other, a user's own as those of VMAS and JaxMARL."""

import importlib.util
import sys
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from eia_sec.common.actors import TeamActors
from eia_sec.common.config import EnvConfig, RunConfig
from eia_sec.common.config.algorithms import IppoConfig
from eia_sec.common.errors import ConfigError, ContractError, EnvironmentFaultError, SimulationError
from eia_sec.rollout.envs.registry import change_arguments, environment_spec, make_environments
from eia_sec.rollout.envs.vectorised import SHIPPED, VectorisedBatch
from eia_sec.rollout.worker.collector import Collector


@pytest.fixture(autouse=True)
def _importable(monkeypatch):
    monkeypatch.syspath_prepend(str(Path(__file__).parent))
    yield
    sys.modules.pop("toy_vectorised", None)


def counters(arguments="{}", environments=2, **others):
    return VectorisedBatch(EnvConfig("toy_vectorised:Counters", arguments, **others), environments, 3)


ACTION = np.array([[-1.0, 0.0, 1.0, -0.5, 2.0]] * 2, np.float32)


def begun(*arguments, **others):
    batch = counters(*arguments, **others)
    for index in range(len(batch.time)):
        batch.reset(index, 4, index)
    return batch


def test_agents_form_types_and_get_actions_of_their_own_spaces():
    """Rows are ordered by type, whatever the order of the environment's agents, which get arrays of the whole batch."""
    batch = begun()
    assert [(g.name, g.count, g.observation_size, g.choices) for g in batch.team.groups] == [
        ("walker", 2, 2, ()),
        ("keeper", 1, 2, (3,)),
    ]
    assert batch.names == ("walker_0", "walker_1", "keeper_0")
    batch.step(ACTION)
    (taken,) = batch._made.actions
    np.testing.assert_array_equal(taken["walker_0"], [[0.0, 2.0]] * 2)
    np.testing.assert_array_equal(taken["walker_1"], [[1.0, 0.0]] * 2)
    np.testing.assert_array_equal(taken["keeper_0"], [3, 3])
    assert (taken["walker_0"].dtype, taken["keeper_0"].dtype.kind) == (np.float64, "i")
    np.testing.assert_array_equal(batch.reward, [[0.0, 3.0, 4.0]] * 2)
    assert batch._made.threads == 3


def test_observations_are_those_of_now():
    """After a reset, too, in which the other environments keep theirs."""
    batch = begun()
    start = batch.observation.copy()
    batch.step(ACTION)
    np.testing.assert_array_equal(batch.observation[:, 1::2], 1.0)
    batch.reset(1, 4, 9)
    np.testing.assert_array_equal(batch.observation[:, 1::2], [[1.0] * 3, [0.0] * 3])
    np.testing.assert_array_equal(batch.observation[0, ::2], start[0, ::2])


def test_who_has_ended_stands_still_until_its_reset():
    """It earns nothing, keeps its last observation, and the others go on."""
    batch = begun('{"last": 2}')
    batch.step(ACTION)
    batch.reset(1, 0, 0)
    batch.step(ACTION)
    assert (batch.ended.tolist(), batch.terminated.tolist()) == ([True, False], [True, False])
    last = batch.observation[0].copy()
    batch.step(ACTION)
    assert (batch.ended.tolist(), batch.terminated.tolist()) == ([True, True], [True, True])
    np.testing.assert_array_equal(batch.reward, [[0.0] * 3, [0.0, 3.0, 4.0]])
    np.testing.assert_array_equal(batch.observation[0], last)
    assert batch.time.tolist() == [2, 2]
    summary = batch.summary(0)
    assert (summary.farm, summary.episode, summary.steps, summary.reward) == (4, 0, 2, (0.0, 6.0, 8.0))
    assert summary.infos == {"clock": 1.5}
    with pytest.raises(SimulationError, match="after its episode ended"):
        batch.step(ACTION)


@pytest.mark.parametrize(
    ("arguments", "steps", "terminated", "length"),
    [("{}", 0, True, 3), ('{"cut": true}', 0, False, 3), ("{}", 2, False, 2)],
)
def test_terminated_and_truncated_are_distinguished(arguments, steps, terminated, length):
    """A limit of the environment's own or of the run is no terminal state."""
    batch = begun(arguments, steps=steps)
    while not batch.ended.all():
        batch.step(ACTION)
    assert (batch.terminated.tolist(), batch.time.tolist()) == ([terminated] * 2, [length] * 2)


@pytest.mark.parametrize(
    ("wrong", "error", "text"),
    [
        ("space", ConfigError, r"the observation of agent walker_0 of toy_vectorised:Counters is no Box but Discrete"),
        ("unseen", ContractError, r"observe\(\) gave .*; Vectorised asks for observations of agent walker_1, one for"),
        ("rewards", ContractError, r"step\(\) gave array.*; .* rewards of agent keeper_0 of shape \[2\], one for each"),
        ("flags", ContractError, r"step\(\) gave \[0, 0\]; Vectorised asks for terminations, one for each of its 2 en"),
        ("nan", ContractError, r"observe\(\) returned observations with nan in environment 0, column 0 of a row; the"),
        ("far", ContractError, r"observe\(\) returned observations with 1e\+08 in environment 0, column 0 of a row; "),
        ("raises", EnvironmentFaultError, r"toy_vectorised:Counters: step\(\) raised ValueError: no such gear"),
    ],
)
def test_a_broken_contract_is_one_sentence(wrong, error, text):
    """It names the method, what came, and what was asked for."""
    with pytest.raises(error, match=text):  # noqa: PT012  # the mistakes show in different steps
        batch = begun(f'{{"wrong": "{wrong}"}}')
        for _ in range(2):
            assert np.isfinite(batch.observation).all()
            batch.step(ACTION)


@pytest.mark.parametrize(("name", "steps"), [("toy_vectorised:Counters", 6), ("mytask.race:Race", 100)])
def test_a_worker_collects_from_it_and_the_same_seeds_give_the_same_chunk(name, steps):
    """The registry finds it by its name, the example's as any other; a trial before a run takes some steps."""
    config = RunConfig(env=EnvConfig(name), algorithm=IppoConfig())
    config = replace(config, rollout=replace(config.rollout, environments=3, chunk_steps=steps))
    team, chunks = environment_spec(config, trial=True).team, []
    for _ in range(2):
        with closing(Collector(config, "w", 0)) as collector:
            chunks.append(collector.collect(TeamActors.initial(team, 8, 0, head="gaussian"), 0.0, uniform=False))
    assert len(chunks[0].episodes) >= 6
    for part in ("observation", "action", "reward", "flag"):
        np.testing.assert_array_equal(getattr(chunks[0].rows, part), getattr(chunks[1].rows, part))


def test_arguments_do_not_change_while_it_runs():
    """All environments share one simulation."""
    with pytest.raises(ConfigError, match="that do not step as one batch take arguments that change"):
        change_arguments(counters(), "{}")


@pytest.mark.parametrize("name", SHIPPED)
def test_a_missing_extra_is_named(name, monkeypatch):
    """The sentence says what to install."""
    monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(ConfigError, match=rf'{name}:x needs {name}: pip install "eia-sec\[{name}\]"'):
        make_environments(RunConfig(env=EnvConfig(f"{name}:x"), algorithm=IppoConfig()), 1)


SCENARIOS = [
    ("vmas:simple_spread", "{}", [(3, 14, ())], 100),
    ("vmas:simple_spread", '{"continuous_actions": false, "max_steps": 6}', [(3, 14, (9,))], 6),
    ("jaxmarl:MPE_simple_spread_v3", "{}", [(3, 18, (5,))], 25),
    ("jaxmarl:MPE_simple_spread_v3", '{"action_type": "Continuous", "max_steps": 6}', [(3, 18, ())], 6),
]


@pytest.mark.parametrize(("name", "arguments", "team", "steps"), SCENARIOS)
def test_shipped_environments_step_as_one_batch(name, arguments, team, steps):
    """An episode is a function of its seeds and actions, whatever else is in its batch, and a time limit truncates."""
    if importlib.util.find_spec(name.partition(":")[0]) is None:
        pytest.skip("the extra is not installed")
    seen = []
    for seeds in ([5, 6], [5], [8, 5, 7]):
        batch = VectorisedBatch(EnvConfig(name, arguments), len(seeds), 1)
        assert [(g.count, g.observation_size, g.choices) for g in batch.team.groups] == team
        for index, seed in enumerate(seeds):
            batch.reset(index, 1, seed)
        place, rows = seeds.index(5), []
        drawn = np.random.default_rng(0).uniform(-1.0, 4.0, (steps, batch.team.action_size)).astype(np.float32)
        for action in drawn:
            rows.append(batch.observation[place].copy())
            batch.step(np.tile(action, (len(seeds), 1)))
        assert (batch.ended.tolist(), batch.terminated.tolist()) == ([True] * len(seeds), [False] * len(seeds))
        assert (batch.reward[place] != 0.0).all()
        seen.append(np.array(rows))
    np.testing.assert_allclose(seen[1], seen[0], atol=1e-4)
    np.testing.assert_allclose(seen[2], seen[0], atol=1e-4)


@pytest.mark.parametrize("name", SHIPPED)
def test_an_unknown_scenario_is_refused_with_those_that_are_known(name):
    """One sentence."""
    if importlib.util.find_spec(name) is None:
        pytest.skip("the extra is not installed")
    with pytest.raises(ConfigError, match=r"has no .* 'nowhere'; it has .*simple_spread"):
        VectorisedBatch(EnvConfig(f"{name}:nowhere"), 1, 1)
