"""The adapters of discrete controls: nine moves become steps on the lattice, headings velocities."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from eia_sec.common.actions.adapters import Headings, MirroredAxes, NineMoves
from eia_sec.common.actions.descriptions import adapter_from_dict, adapter_to_dict
from eia_sec.common.actors import TeamActors
from eia_sec.common.config import ControlConfig, FarmConfig, ObservationConfig, WorldConfig
from eia_sec.common.config.presets import preset
from eia_sec.common.errors import ConfigError, SchemaError
from eia_sec.common.farm import HEADING_SPEEDS, farm_environment, farm_team
from eia_sec.common.team import GroupSpec, TeamSpec
from eia_sec.rollout.sim.batch import FarmBatch
from eia_sec.rollout.sim.layout import make_layout
from tests.rollout.sim.properties.strategies import placed

HEADINGS = Headings(*HEADING_SPEEDS, 0.025)
PLACES = st.floats(-1.0, 1.0, width=32)


def test_nine_moves_are_all_pairs_of_steps():
    """Index 3 (x + 1) + y + 1 is the step (x, y)."""
    steps = NineMoves().adapt(np.zeros((9, 2), np.float32), np.arange(9, dtype=np.float32)[:, None])
    assert steps.tolist() == [list(pair) for pair in itertools.product((-1.0, 0.0, 1.0), repeat=2)]


def test_a_suggestion_lies_in_the_observation():
    """A suggestion is part of the description, and must lie in the observation."""
    assert adapter_from_dict(adapter_to_dict(NineMoves(7))) == NineMoves(7)
    GroupSpec("a", 1, 16, 1, (NineMoves(7),), (9,))
    with pytest.raises(ConfigError, match="too short for the suggested move"):
        GroupSpec("a", 1, 15, 1, (NineMoves(7),), (9,))


def test_hints_for_fresh_relays_lie_in_the_observation():
    """They are part of the description, and refused beyond the observation's end."""
    hinted = replace(HEADINGS, potential=7, time_left=2)
    assert adapter_from_dict(adapter_to_dict(hinted)) == hinted != HEADINGS
    GroupSpec("a", 1, 16, 1, (hinted,), (25,))
    for potential, time_left in ((8, 2), (7, 16), (7, -1)):
        with pytest.raises(ConfigError, match="too short for the potential"):
            GroupSpec("a", 1, 16, 1, (replace(HEADINGS, potential=potential, time_left=time_left),), (25,))


def test_hints_of_moves_lie_in_the_observation():
    """The same holds for what moves are worth and what harm they do."""
    hinted = NineMoves(worth=7, harm=0)
    assert adapter_from_dict(adapter_to_dict(hinted)) == hinted
    GroupSpec("a", 1, 16, 1, (hinted,), (9,))
    for worth, harm in ((8, 0), (7, 8), (7, -1)):
        with pytest.raises(ConfigError, match="too short for the worth and the harm"):
            GroupSpec("a", 1, 16, 1, (NineMoves(worth=worth, harm=harm),), (9,))


def test_uavs_with_a_task_are_hinted_at_what_moves_serve():
    """Served units are worth it, and the way to others is the harm, where both are seen."""
    default = preset("instant").farm
    names = farm_environment(default).tensor_names
    for group in farm_team(default).groups[1:]:
        seen, moves = names[group.name].observation, group.adapters[0]
        assert seen[moves.worth] == "units_2_move_-1_-1"
        assert seen[moves.harm] == "risk_any_move_-1_-1"
    for lacking in ({"units": 0}, {"closing": False}):
        farm = replace(default, observation=replace(default.observation, **lacking))
        moves = farm_team(farm).groups[2].adapters[0]
        assert (moves.worth, moves.harm) == (-1, -1)


def test_relays_are_hinted_at_what_lowers_their_service_distance():
    """Where they see it, and where their reward is charged with it."""
    default = preset("instant").farm
    names = farm_environment(default).tensor_names["communication"].observation
    relays = farm_team(default).groups[0].adapters[0]
    assert names[relays.potential : relays.potential + 9] == tuple(
        f"service_move_{x}_{y}" for x in (-1, 0, 1) for y in (-1, 0, 1)
    )
    assert names[relays.time_left] == "left_25"
    for farm in (
        replace(default, observation=replace(default.observation, service=False)),
        replace(default, observation=replace(default.observation, phases=False)),
    ):
        relays = farm_team(farm).groups[0].adapters[0]
        assert (relays.potential, relays.time_left) == (-1, -1)


@given(x=PLACES, y=PLACES)
def test_headings_are_eight_ways_at_three_speeds(x, y):
    """A plain loop in double precision gives the same velocities; idle agents fly along x at the idle speed."""
    place = np.tile(np.array([x, y], np.float32), (25, 1))
    found = HEADINGS.adapt(place, np.arange(25, dtype=np.float32)[:, None])
    assert abs(found[0, 0]) == np.float32(HEADINGS.idle)
    assert found[0, 1] == 0.0
    speeds = (HEADINGS.slow, HEADINGS.medium, HEADINGS.fast)
    wanted = [(v * math.cos(j * math.pi / 4), v * math.sin(j * math.pi / 4)) for v in speeds for j in range(8)]
    np.testing.assert_allclose(found[1:], wanted, atol=1e-6)


@pytest.mark.parametrize("mirrored", [False, True])
def test_idle_agents_stay_where_they_are(mirrored):
    """A thousand steps of idling lead nowhere, at the edges of the field too, and never beyond them."""
    control = ControlConfig(communication="headings")
    world = WorldConfig(communication_uavs=64, steps=1000)
    farms = FarmBatch(FarmConfig(world=world, control=control, observation=ObservationConfig(mirrored=mirrored)), 1)
    start = np.random.default_rng(3).uniform(0.0, 400.0, (world.uavs, 2))
    start[:4, 0] = 0.0, 400.0, 0.2, 399.8
    with placed(make_layout(farms.config, 0), start):
        farms.reset(0, 0, 0)
    first, adapted = farms.position.copy(), np.zeros(farms.team.action_size, np.float32)
    for _ in range(1000):
        farms.step(farms.team.adapt(farms.observation, adapted[None]))
        moved = np.abs(farms.position - first)[0, :64]
        assert moved.max() < 2.5 * HEADINGS.idle * world.speed_x_max
    assert farms.summary(0).metrics["boundary"] == 0


@pytest.mark.parametrize("mirrored", [False, True])
def test_moves_fly_from_place_to_place(mirrored):
    """A move leads as the lattice does for the same step, and nobody runs against the field's edge."""
    control = ControlConfig(communication="moves", monitoring="moves", collection="moves")
    config = FarmConfig(control=control, observation=ObservationConfig(mirrored=mirrored))
    lattice = ControlConfig(communication="lattice", monitoring="lattice", collection="lattice")
    steered = farm_team(FarmConfig(control=lattice, observation=config.observation))
    farms, draw = FarmBatch(config, 3), np.random.default_rng(2)
    for index in range(3):
        farms.reset(index, index, 5)
    for _ in range(60):
        option = draw.integers(0, 9, (3, farms.team.action_size)).astype(np.float32)
        step = np.stack([option // 3 - 1, option % 3 - 1], axis=-1).reshape(3, -1)
        velocity = farms.team.adapt(farms.observation, option)
        np.testing.assert_array_equal(velocity, steered.adapt(farms.observation, step))
        farms.step(velocity)
    assert all(farms.summary(index).metrics["boundary"] == 0 for index in range(3))


def test_rows_of_the_environment_are_wider_than_those_of_the_actors():
    """One index in replay, two numbers for the farm; the split follows the environment's width."""
    team = farm_team(FarmConfig(control=ControlConfig("velocity", "headings", "velocity")))
    assert (team.action_size, team.environment_action_size) == (20, 24)
    rows = np.random.default_rng(0).uniform(-1, 1, (5, team.observation_size)).astype(np.float32)
    actions = TeamActors.initial(team, 8, 0).environment_actions(rows)
    parts = team.split_environment_actions(actions)
    assert [part.shape for part in parts] == [(5, 4, 2)] * 3
    np.testing.assert_array_equal(np.concatenate([part.reshape(5, -1) for part in parts], axis=1), actions)


@pytest.mark.parametrize("adapters", [(NineMoves(),), (HEADINGS,), (HEADINGS, MirroredAxes())])
def test_descriptions_come_back(adapters):
    """Adapters of choices survive the wire in their order."""
    options = adapters[0].options
    team = TeamSpec((GroupSpec("a", 2, 5, 1, adapters, (options,)),))
    assert TeamSpec.from_dict(team.to_dict()) == team


def test_impossible_adapters_are_refused():
    """Choices are one index, headings need a place, and speeds are shares."""
    with pytest.raises(ConfigError, match="chosen by one index"):
        GroupSpec("a", 1, 5, 2, (NineMoves(),), (9, 9))
    with pytest.raises(ConfigError, match="headings need x and y"):
        GroupSpec("a", 1, 1, 1, (HEADINGS,), (25,))
    with pytest.raises(ConfigError, match="fast"):
        Headings(0.1, 0.2, 0.3, 1.5, 0.025)
    described = TeamSpec((GroupSpec("a", 2, 5, 1, (HEADINGS,), (25,)),)).to_dict()
    described["groups"][0]["adapters"][0]["idle"] = "slow"
    with pytest.raises(SchemaError):
        TeamSpec.from_dict(described)
