"""Farms whose UAVs see what a heuristic would do."""

import copy
from dataclasses import replace

import numpy as np
import pytest

from eia_sec.common.actions.adapters import Headings, Lattice, NineMoves
from eia_sec.common.config import RunConfig
from eia_sec.common.config.presets import preset
from eia_sec.common.errors import ConfigError, SimulationError
from eia_sec.common.farm import HEADING_SPEEDS, advice_columns, farm_environment, farm_team
from eia_sec.learner.trainers import make_trainer
from eia_sec.rollout.heuristics.advised import nearest_heading, nearest_move
from eia_sec.rollout.heuristics.farms import make_farms
from eia_sec.rollout.heuristics.registry import heuristic
from eia_sec.rollout.policies import ActorPolicy
from eia_sec.rollout.sim.batch import FarmBatch

DEFAULT = preset("default").farm


def advised(name, farm=DEFAULT, **control):
    """Return the farm with advice, and with other controls."""
    return replace(
        farm,
        observation=replace(farm.observation, advice=name),
        control=replace(farm.control, **control),
        world=replace(farm.world, steps=60, start_levels="random"),
    )


def advice_of(farms):
    """Return the advice that each type sees, [E, n_v, k] each."""
    views = farms.team.split_observations(farms.observation)
    return [view[..., part] for view, part in zip(views, advice_columns(farms.config), strict=True)]


def follow(farms):
    """Return the actions of UAVs that follow the options advised to them."""
    rows = []
    views = farms.team.split_observations(farms.observation)
    for group, view, marks in zip(farms.team.groups, views, advice_of(farms), strict=True):
        action = group.adapt(view, marks.argmax(axis=-1)[..., None].astype(np.float32))
        rows.append(action.reshape(len(view), -1))
    return np.concatenate(rows, axis=1).astype(np.float32)


@pytest.mark.parametrize("mirrored", [False, True])
def test_advised_velocities_are_those_of_the_heuristic(mirrored):
    """With velocities for actions, the advice is the heuristic's action along the UAV's own axes."""
    config = advised("tour", communication="velocity", monitoring="velocity", collection="velocity")
    config = replace(config, observation=replace(config.observation, mirrored=mirrored))
    farms, policy = make_farms(config, 2), heuristic("tour", config)
    for e in range(2):
        farms.reset(e, 1000 + e, 0)
        policy.reset(farms, e)
    while not farms.ended.any():
        action = policy.act(farms)
        seen = []
        for group, view, part in zip(
            farms.team.groups, farms.team.split_observations(farms.observation), advice_of(farms), strict=True
        ):
            signs = view[..., 2:4] if mirrored else 1.0
            seen.append((part * signs).reshape(2, group.count * 2))
        assert np.array_equal(np.concatenate(seen, axis=1), action)
        farms.step(action)


@pytest.mark.parametrize("name", ["horizon", "tour+centroid"])
def test_uavs_that_follow_marks_fly_exactly_as_the_heuristic(name):
    """Options are coarser than velocities, but the marked one stands for the heuristic's own velocity."""
    config = advised(name)
    farms, plain = make_farms(config, 2), FarmBatch(replace(config, observation=DEFAULT.observation), 2)
    policy = heuristic(name, plain.config)
    for e in range(2):
        farms.reset(e, 1000 + e, 0)
        plain.reset(e, 1000 + e, 0)
        policy.reset(plain, e)
    while not farms.ended.any():
        for marks in advice_of(farms):
            assert (marks.sum(axis=-1) == 1.0).all()
        farms.step(follow(farms))
        plain.step(policy.act(plain))
        assert np.array_equal(farms.position, plain.position)
        assert np.array_equal(farms.reward, plain.reward)
    assert all((marks == 0.0).all() for marks in advice_of(farms))  # nothing is advised after the last step


def test_another_option_is_flown_as_it_is():
    """Only the marked option stands for the advice."""
    config = advised("tour")
    farms, plain = make_farms(config, 1), FarmBatch(replace(config, observation=DEFAULT.observation), 1)
    random, compared = np.random.default_rng(0), 0
    for episode in range(20):
        farms.reset(0, 1000, episode)
        plain.reset(0, 1000, episode)
        action = []
        for group, view, marks in zip(
            farms.team.groups, farms.team.split_observations(farms.observation), advice_of(farms), strict=True
        ):
            other = (marks.argmax(axis=-1) + random.integers(1, group.choices[0], group.count)) % group.choices[0]
            action.append(group.adapt(view, other[..., None].astype(np.float32)).reshape(1, -1))
        row = np.concatenate(action, axis=1).astype(np.float32)
        apart = (row != follow(farms)).reshape(12, 2).any(axis=1)  # at the border, several options are one
        farms.step(row)
        plain.step(row)
        assert np.array_equal(farms.position[0, apart], plain.position[0, apart])
        compared += int(apart.sum())
    assert compared > 200


def test_a_fresh_policy_follows_the_advice():
    """The most likely option of untrained actors is the advised one, for all types."""
    run = replace(RunConfig(), farm=advised("lawnmower"))
    actors = make_trainer(run, farm_environment(run.farm).team).actors()
    farms, policy = make_farms(run.farm, 1), ActorPolicy(actors)
    farms.reset(0, 1000, 0)
    policy.reset(farms, 0)
    while not farms.ended.any():
        action = policy.act(farms)
        assert np.array_equal(action, follow(farms))
        farms.step(action)


def test_an_environment_is_advised_as_if_it_were_alone():
    """Advice depends neither on the rest of the batch nor on when the others begin anew; copies continue equally."""
    config = advised("horizon+search")
    both, alone = make_farms(config, 2), make_farms(config, 1)
    both.reset(0, 1001, 0)
    both.reset(1, 1000, 3)
    alone.reset(0, 1000, 3)
    for step in range(20):
        if step == 9:
            both.reset(0, 1002, 1)
            both, alone = copy.deepcopy((both, alone))
        action = follow(both)
        assert np.array_equal(action[1:], follow(alone))
        assert np.array_equal(both.observation[1], alone.observation[0])
        both.step(action)
        alone.step(action[1:])


def test_a_uav_that_is_gone_is_advised_nothing():
    """From its failure on its whole observation is 0."""
    config = advised("greedy")
    config = replace(config, failures=replace(config.failures, at="monitoring 1 at 5, communication 0 at 3"))
    farms = make_farms(config, 1)
    farms.reset(0, 1000, 0)
    for _ in range(8):
        farms.step(follow(farms))
    relays, monitors, _ = advice_of(farms)
    assert relays[0].sum(axis=-1).tolist() == [0, 1, 1, 1]
    assert monitors[0].sum(axis=-1).tolist() == [1, 0, 1, 1]
    assert not farms.team.split_observations(farms.observation)[1][0, 1].any()


def test_the_nearest_move():
    """A move leads one cell on along each axis where the velocity leaves the cell."""
    lattice = Lattice.spanning(0.025, 0.025)
    centre = np.array([[0.025, 0.025, 1, 1]], np.float32)  # the centre of cell (20, 20) of 40
    steps = NineMoves().adapt(centre, np.arange(9, dtype=np.float32)[:, None])
    for index, step in enumerate(steps):
        assert nearest_move(lattice, centre, 0.9 * step[None].astype(np.float64)).tolist() == [index]
    assert nearest_move(lattice, centre, np.array([[0.3, -0.3]])).tolist() == [4]


def test_the_nearest_heading():
    """Slow velocities are idling, and others the option of the nearest direction and speed."""
    headings = Headings(*HEADING_SPEEDS, 0.025)
    for index, velocity in enumerate(headings.velocities().astype(np.float64)):
        assert nearest_heading(headings, 1.01 * velocity) == index + 1
    assert nearest_heading(headings, np.array([0.041, 0.0])) == 0


def test_options_are_suggested_where_the_names_say():
    """Suggestions point at the marks, by their names."""
    spec = farm_environment(advised("horizon"))
    for group in spec.team.groups:
        names = spec.tensor_names[group.name].observation
        first = group.adapters[0].suggestion
        assert names[first].startswith("advice_")
        assert not names[first - 1].startswith("advice_")
    assert [group.adapters[0].suggestion for group in farm_team(DEFAULT).groups][::2] == [-1, -1]


@pytest.mark.parametrize("name", ["nobody", "static", "greedy+nobody"])
def test_advice_needs_a_heuristic_with_goals(name):
    """Names that no heuristic has, and heuristics without goals, are refused."""
    with pytest.raises(ConfigError, match="advice must be one of"):
        make_farms(advised(name), 1)


def test_the_simulator_alone_refuses_advice():
    """Nobody flies with an observation that is never written."""
    with pytest.raises(SimulationError, match="make_farms"):
        FarmBatch(advised("tour"), 1)
