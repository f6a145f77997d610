"""PettingZoo environments with discrete actions: branches, starts, masks, and teams that mix them with boxes."""

import sys
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from gymnasium import spaces
from hypothesis import given
from hypothesis import strategies as st

from eia_sec.common.actors import TeamActors
from eia_sec.common.config import ControlConfig, EiaSecConfig, EnvConfig, FarmConfig, IppoConfig, RunConfig
from eia_sec.common.config.action_kinds import continuous_algorithms, discrete_algorithms
from eia_sec.common.errors import ConfigError, ContractError, PolicyError
from eia_sec.common.team import TeamSpec
from eia_sec.rollout.envs.pettingzoo_actions import RowActions, choices_of
from eia_sec.rollout.envs.pettingzoo_batch import PettingZooBatch
from eia_sec.rollout.envs.registry import environment_spec, make_environments
from eia_sec.rollout.evaluation import evaluate_run
from eia_sec.rollout.heuristics.random import RandomPolicy
from eia_sec.rollout.policies import ActorPolicy, SampledPolicy, fitted
from eia_sec.rollout.worker.collector import run_noise_free_episodes

ORDER = ("walker_0", "walker_1", "painter_0", "porter_0")
"""The agents of the environment Doors in row order."""


@pytest.fixture(autouse=True)
def _importable(monkeypatch):
    monkeypatch.syspath_prepend(str(Path(__file__).parent))
    yield
    sys.modules.pop("toy_choices", None)


def doors(masks="none", count=1):
    batch = PettingZooBatch(EnvConfig("toy_choices:Doors", arguments=f'{{"masks": "{masks}"}}'), count, boxes=False)
    for index in range(count):
        batch.reset(index, 0, index)
    return batch


def parts(batch):
    """Return the observations of each type in the first environment."""
    return dict(zip([g.name for g in batch.team.groups], batch.team.split_observations(batch.observation), strict=True))


def test_each_number_of_a_choice_is_a_branch():
    """Discrete has one branch, MultiDiscrete several; boxes of the same team stay as they are."""
    groups = {group.name: group for group in doors().team.groups}
    assert (groups["walker"].choices, groups["walker"].action_size, groups["walker"].count) == ((4,), 1, 2)
    assert (groups["porter"].choices, groups["porter"].action_size) == ((2, 3), 2)
    assert (groups["painter"].choices, groups["painter"].action_size) == ((), 1)
    assert not any(group.masked for group in groups.values())


def test_starts_and_kinds_are_the_environments_own():
    """Discrete gets an int, MultiDiscrete an array of its type; indices out of range are clipped."""
    batch = doors()
    batch.step(np.array([[2.0, 0.0, 0.5, 1.0, 2.0]], np.float32))
    batch.step(np.array([[9.0, -3.0, -1.0, 0.0, 1.0]], np.float32))
    first, second = batch._environments[0].wrapped.actions
    assert (first["walker_0"], first["walker_1"]) == (5, -1)
    assert type(first["walker_0"]) is int
    assert first["porter_0"].tolist() == [6, 10**12 + 2]
    assert first["porter_0"].dtype == np.int64
    np.testing.assert_allclose(first["painter_0"], [2.5])
    assert (second["walker_0"], second["walker_1"]) == (6, -1)
    assert batch.reward[0].tolist() == [3.0, 0.0, -2.0, 1.0]


@given(
    nvec=st.lists(st.integers(1, 50), min_size=1, max_size=6),
    shift=st.integers(-(10**12), 10**12),
    numbers=st.lists(st.floats(-100.0, 100.0, width=32), min_size=6, max_size=6),
)
def test_whatever_actors_say_the_environment_gets_an_action_of_its_space(nvec, shift, numbers):
    """Any finite numbers become an action of Discrete, MultiDiscrete and Box."""
    found = {
        "one": spaces.Discrete(nvec[0], start=shift),
        "many": spaces.MultiDiscrete(nvec, start=[shift] * len(nvec)),
        "grid": spaces.MultiDiscrete(np.array([nvec, nvec])),
        "box": spaces.Box(-3.0, 5.0, (2, 1), np.float32),
    }
    actions = RowActions(found)
    size = 3 * len(nvec) + 3
    row = actions.in_range(np.resize(np.array(numbers, np.float32), (1, size)))[0]
    taken = actions.by_agent(row, found.keys())
    assert all(space.contains(taken[name]) for name, space in found.items())
    wanted = np.clip(np.rint(np.float32(numbers[0])), 0, nvec[0] - 1)
    assert taken["one"] == int(wanted) + shift
    assert choices_of(found["grid"]) == (*nvec, *nvec)


@pytest.mark.parametrize("masks", ["observation", "info"])
def test_masks_end_the_observation(masks):
    """Both conventions of PettingZoo give the same rows, for several branches too, and the Box has none."""
    batch = doors(masks)
    assert [(g.name, g.masked, g.observation_size) for g in batch.team.groups] == [
        ("walker", True, 6),
        ("painter", False, 2),
        ("porter", True, 7),
    ]
    batch._environments[0].wrapped.legal = {"walker_1": [0, 1, 0, 1], "porter_0": [0, 1, 1, 0, 0]}
    batch.step(np.zeros((1, 5), np.float32))
    seen = parts(batch)
    np.testing.assert_array_equal(seen["walker"][0], [[1, 1, 1, 1, 1, 1], [1, 1, 0, 1, 0, 1]])
    np.testing.assert_array_equal(seen["porter"][0], [[1, 1, 0, 1, 1, 0, 0]])


@pytest.mark.parametrize("masks", ["observation", "info"])
def test_a_branch_without_a_legal_option_has_them_all(masks):
    """Such a mask says nothing; other branches keep theirs."""
    batch = doors(masks)
    batch._environments[0].wrapped.legal = {"walker_0": [0, 0, 0, 0], "porter_0": [0, 0, 0, 1, 0]}
    batch.step(np.zeros((1, 5), np.float32))
    np.testing.assert_array_equal(parts(batch)["walker"][0, 0, 2:], [1, 1, 1, 1])
    np.testing.assert_array_equal(parts(batch)["porter"][0, 0, 2:], [1, 1, 0, 1, 0])


@pytest.mark.parametrize("masks", ["observation", "info", "none"])
def test_who_has_left_sees_zeros_and_may_choose_anything(masks):
    """The absorbing state's mask allows everything; the episode goes on for the others."""
    batch = doors(masks)
    batch._environments[0].wrapped.legal = {"walker_0": [1, 0, 0, 0]}
    for _ in range(3):
        batch.step(np.zeros((1, 5), np.float32))
    walkers = parts(batch)["walker"][0]
    np.testing.assert_array_equal(walkers[:, :2], 0.0)
    assert walkers[:, 2:].all()
    assert not batch.ended[0]
    batch.step(np.zeros((1, 5), np.float32))
    assert batch.terminated[0]


def test_a_mask_of_another_length_is_refused():
    """One sentence names the agent and both lengths."""
    batch = doors("info")
    batch._environments[0].wrapped.legal = {"walker_0": [1, 0]}
    with pytest.raises(ContractError, match=r"the action mask array\(\[1, 0\].* of agent walker_0; .* its 4 actions"):
        batch.step(np.zeros((1, 5), np.float32))


def test_agents_that_differ_in_their_choices_are_different_types():
    """A type's agents share networks, so a common prefix is split by observation, choices and mask."""
    config = EnvConfig("toy_choices:Doors", arguments='{"masks": "info"}', types={"w": "all", "p": "all"})
    team = PettingZooBatch(config, 1, boxes=False).team
    assert [(g.name, g.count) for g in team.groups] == [
        ("all-6of4-masked", 2),
        ("all-2x1", 1),
        ("all-7of2.3-masked", 1),
    ]


def test_the_first_environment_is_reset_only_where_infos_may_hold_masks():
    """Boxes and masks in observations need no look into infos."""
    for masks, resets in (("observation", 1), ("info", 2), ("none", 2)):
        assert doors(masks)._environments[0].wrapped.resets == resets


def test_an_environment_with_a_choice_follows_the_algorithm():
    """Off-policy algorithms get boxes, others what the environment has; the user's argument decides over both."""
    config = RunConfig(env=EnvConfig("toy_choices:flexible"), algorithm=EiaSecConfig())
    assert not any(group.choices for group in environment_spec(config).team.groups)
    choosing = RunConfig(env=config.env, algorithm=IppoConfig())
    assert {group.name for group in environment_spec(choosing).team.groups if group.choices} == {"walker", "porter"}
    asked = EnvConfig("toy_choices:flexible", arguments='{"continuous_actions": true}')
    spec = environment_spec(RunConfig(env=asked, algorithm=IppoConfig()))
    assert not any(group.choices for group in spec.team.groups)


@pytest.mark.parametrize(
    "config",
    [
        RunConfig(env=EnvConfig("toy_choices:Doors"), algorithm=EiaSecConfig()),
        RunConfig(
            env=EnvConfig("toy_choices:flexible", arguments='{"continuous_actions": false}'), algorithm=EiaSecConfig()
        ),
        RunConfig(
            farm=FarmConfig(control=ControlConfig(monitoring="moves", collection="headings")), algorithm=EiaSecConfig()
        ),
    ],
)
def test_discrete_actions_and_an_algorithm_without_them_are_refused(config):
    """One sentence names the types and the algorithms that can; flying such an environment needs no algorithm."""
    with pytest.raises(ConfigError, match=r"has discrete actions \(\w+(, \w+)+\), which eia-sec cannot train; .*ippo"):
        environment_spec(config)
    with closing(make_environments(config, 1)) as environments:
        assert any(group.choices for group in environments.team.groups)


def test_continuous_actions_and_an_algorithm_without_them_are_refused():
    """One sentence names the types and the algorithms that can."""
    asked = EnvConfig("toy_choices:flexible", arguments='{"continuous_actions": true}')
    for name in ("vdn", "qmix"):
        config = RunConfig(env=asked).with_algorithm(name)
        with pytest.raises(
            ConfigError, match=rf"has continuous actions \(walker, .*, which {name} cannot train; .*masac"
        ):
            environment_spec(config)
        with pytest.raises(ConfigError, match=rf"Doors has continuous actions \(painter\), which {name} cannot train"):
            environment_spec(RunConfig(env=EnvConfig("toy_choices:Doors")).with_algorithm(name))


def test_which_algorithms_choose():
    """Algorithms with actors off policy need boxes, those of options' values none."""
    assert {"vdn", "qmix"} <= set(discrete_algorithms()) - set(continuous_algorithms())
    assert not set(discrete_algorithms()) & {"eia-sec", "maddpg", "matd3", "masac"}
    assert {"ippo", "mappo"} <= set(discrete_algorithms())


@pytest.mark.parametrize("masks", ["observation", "info"])
def test_random_actions_are_legal_and_reach_every_legal_option(masks):
    """The random policy draws among the options that the mask allows, and boxes as before."""
    batch, policy = doors(masks), RandomPolicy()
    taken = []
    for episode in range(60):
        batch.reset(0, 0, episode)
        batch._environments[0].wrapped.legal = {"walker_0": [0, 1, 1, 0], "porter_0": [1, 0, 1, 0, 1]}
        policy.reset(batch, 0)
        batch.step(policy.act(batch))
        batch.step(policy.act(batch))
        taken.append(batch._environments[0].wrapped.actions[-1])
    assert {action["walker_0"] for action in taken} == {4, 5}
    assert {action["walker_1"] for action in taken} == {-1, 0, 1, 2}
    assert {tuple(action["porter_0"] - [5, 10**12]) for action in taken} == {(0, 0), (0, 2)}
    assert len({float(action["painter_0"][0]) for action in taken}) == 60


@pytest.mark.parametrize("shared", [False, True])
def test_actors_fly_such_environments(shared):
    """Noise-free episodes and evaluations work with one row of parameters and with one for each agent."""
    config = RunConfig(
        env=EnvConfig("toy_choices:Doors", arguments='{"masks": "info"}'), algorithm=IppoConfig(hidden=4)
    )
    actors = TeamActors.initial(environment_spec(config).team, 4, 0, shared=shared)
    reward, steps = run_noise_free_episodes(config, actors, (0, 1), (5, 6))
    assert reward.shape == (2, 4, 4)
    assert steps.tolist() == [4, 4]
    found = evaluate_run(config, ActorPolicy(actors), (7, 8), 1, name="actors").to_dict()
    assert set(found["reward"]) == {"mean", "walker", "porter", "painter"}


def test_drawn_actions_do_not_depend_on_the_batch():
    """An episode's draws follow from its seeds; they differ from the likeliest actions and from episode to episode."""
    config = RunConfig(
        env=EnvConfig("toy_choices:Doors", arguments='{"masks": "info"}'), algorithm=IppoConfig(hidden=4)
    )
    actors = TeamActors.initial(environment_spec(config).team, 4, 0, head="gaussian")
    together = evaluate_run(config, SampledPolicy(actors), (7, 8), 3, name="drawn")
    alone = evaluate_run(config, SampledPolicy(actors), (8,), 3, name="drawn")
    assert together.per_farm[1] == alone.per_farm[0]
    assert together.per_farm != evaluate_run(config, ActorPolicy(actors), (7, 8), 3, name="likeliest").per_farm


def test_actors_fit_only_their_own_choices():
    """The sentence says what both sides choose from."""
    masked = doors("info").team
    actors = TeamActors.initial(masked, 4, 0)
    assert fitted(actors, TeamSpec.from_dict(masked.to_dict())) is actors
    with pytest.raises(
        PolicyError, match=r"6 inputs \(4 options, a mask\).*this environment has.*2 inputs \(4 options\)"
    ):
        fitted(actors, doors().team)


def test_mpe_is_discrete_by_itself():
    """simple_spread has five moves, or boxes for an off-policy algorithm."""
    batch = PettingZooBatch(EnvConfig("mpe2:simple_spread_v3"), 1, boxes=False)
    assert [(g.count, g.choices, g.masked) for g in batch.team.groups] == [(3, (5,), False)]
    batch.reset(0, 1, 5)
    batch.step(np.array([[0.0, 4.0, 2.0]], np.float32))
    assert [(g.count, g.choices) for g in PettingZooBatch(EnvConfig("mpe2:simple_spread_v3"), 1).team.groups] == [
        (3, ())
    ]
