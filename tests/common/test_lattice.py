"""Steering by a lattice, beside a plain loop, and what it promises."""

import itertools
import math

import numpy as np
import pytest

from common.config import ControlConfig, FarmConfig, ObservationConfig, WorldConfig
from common.errors import ConfigError, SchemaError
from common.lattice import GAIN, Lattice, fewest
from common.team import SIGNS, GroupSpec, TeamSpec, farm_team
from rollout.sim.batch import FarmBatch

FIELD = 400.0
SQUARE = Lattice.spanning(10.0 / FIELD, 10.0 / FIELD)


def plain(lattice, place, action):
    """One axis after the other, in metres and double precision."""
    velocity = []
    for at, wish, count, reach in zip(
        place, action, (lattice.columns, lattice.rows), (lattice.reach_x, lattice.reach_y), strict=True
    ):
        share = (at + 1) / 2
        cell = min(max(math.floor(share * count + 1e-4), 0), count - 1)
        step = 0 if abs(wish) * GAIN <= 0.5 else int(math.copysign(1, wish))
        goal = (min(max(cell + step, 0), count - 1) + 0.5) / count
        velocity.append(min(1.0, max(-1.0, (goal - share) / reach)))
    return velocity


@pytest.mark.parametrize("lattice", [SQUARE, Lattice.spanning(0.03, 0.4), Lattice(1, 7, 2.0, 0.2)])
def test_velocities_are_those_of_a_plain_loop(lattice):
    """Random places and actions, the outermost ones and corners included."""
    draw = np.random.default_rng(0)
    place, action = draw.uniform(-1, 1, (2, 500, 2)).astype(np.float32)
    corners = np.array(list(itertools.product((-1.0, 0.0, 1.0), repeat=2)), np.float32)
    place, action = np.concatenate([place, corners]), np.concatenate([action, corners[::-1]])
    found = lattice.steer(place, action)
    assert found.dtype == np.float32
    expected = [plain(lattice, p, a) for p, a in zip(place.tolist(), action.tolist(), strict=True)]
    np.testing.assert_allclose(found, expected, atol=2e-5)


def test_on_a_place_every_action_leads_to_the_next_place_or_none():
    """Nine actions from a place in the middle: its eight neighbours and itself, reached in one step."""
    start = np.array([205.0, 115.0])
    place = (2 * start / FIELD - 1).astype(np.float32)
    for wish in itertools.product((-1, 0, 1), repeat=2):
        velocity = SQUARE.steer(place, np.array(wish, np.float32))
        np.testing.assert_allclose(start + 10.0 * velocity, start + 10.0 * np.array(wish), atol=1e-3)


def test_noise_below_a_third_of_the_range_changes_nothing():
    """Clear decisions survive it; undecided ones do not."""
    draw = np.random.default_rng(1)
    place = draw.uniform(-1, 1, (300, 2)).astype(np.float32)
    clear = draw.choice([-0.99, 0.0, 0.99], (300, 2)).astype(np.float32)
    noise = draw.uniform(-0.33, 0.33, (300, 2)).astype(np.float32)
    np.testing.assert_array_equal(SQUARE.steer(place, clear), SQUARE.steer(place, np.clip(clear + noise, -1, 1)))
    undecided = np.full((300, 2), 0.34, np.float32)
    assert (SQUARE.steer(place, undecided) != SQUARE.steer(place, np.clip(undecided + noise, -1, 1))).any()


def test_a_farms_monitors_reach_the_lattice_and_never_leave_the_field():
    """Whatever the actors say: on the lattice soon, as staying once is enough, and no boundary violation."""
    config = FarmConfig(control=ControlConfig(communication="lattice", monitoring="lattice", collection="lattice"))
    farms, draw = FarmBatch(config, 3), np.random.default_rng(2)
    for index in range(3):
        farms.reset(index, index, 5)
    for step in range(80):
        action = draw.uniform(-1, 1, (3, farms.team.action_size)).astype(np.float32)
        farms.step(farms.team.steer(farms.observation, action))
        if step > 40:
            off = (farms.position[..., :2] - 5.0) / 10.0
            np.testing.assert_allclose(off, np.rint(off), atol=1e-3)
    assert all(farms.summary(index).metrics["boundary"] == 0 for index in range(3))


def test_only_those_with_a_lattice_are_steered():
    """The others' actions pass as they are, and a team without lattices hands the very array on."""
    team = farm_team(FarmConfig())
    assert [group.lattice is not None for group in team.groups] == [False, True, False]
    draw = np.random.default_rng(3)
    seen = draw.uniform(-1, 1, (2, team.observation_size)).astype(np.float32)
    action = draw.uniform(-1, 1, (2, team.action_size)).astype(np.float32)
    before, steered = action.copy(), team.steer(seen, action)
    np.testing.assert_array_equal(action, before)
    for group, own, given, taken in zip(
        team.groups, team.split_observations(seen), team.split_actions(action), team.split_actions(steered), strict=True
    ):
        wanted = given if group.lattice is None else group.lattice.steer(own[..., :2], given)
        np.testing.assert_array_equal(taken, wanted)
    plain_team = farm_team(FarmConfig(control=ControlConfig(monitoring="velocity")))
    assert plain_team.steer(seen, action) is action
    assert plain_team.digest != team.digest


@pytest.mark.parametrize("control", ["velocity", "lattice"])
def test_the_mirrored_command_along_axes_of_their_own(control):
    """Back, stay and on follow the signs in a real farm, from place to place where there is a lattice."""
    steering = ControlConfig(communication=control, monitoring=control, collection=control)
    config = FarmConfig(observation=ObservationConfig(mirrored=True), control=steering)
    farms, draw = FarmBatch(config, 4), np.random.default_rng(4)
    field, monitors = np.array([config.world.field_x, config.world.field_y]), slice(4, 8)
    for index in range(4):
        farms.reset(index, index, 7)
    for _ in range(5):
        before = farms.position.copy()
        middle = np.broadcast_to(field / 2.0, before.shape).copy()
        middle[:, monitors] = (before[:, monitors] // 20.0) * 20.0 + 10.0
        signs = np.where(before < middle, -1.0, 1.0)
        seen = farms.team.split_observations(farms.observation)
        np.testing.assert_array_equal(np.concatenate([own[..., SIGNS] for own in seen], axis=1), signs)
        wish = draw.choice([-0.8, 0.0, 0.8], signs.shape)
        action = wish.reshape(4, -1).astype(np.float32)
        farms.step(farms.team.steer(farms.observation, action))
        if control == "velocity":
            wanted = before + 10.0 * signs * wish
        else:
            cell = np.floor(before / 10.0 + 1e-3)
            wanted = 10.0 * (np.clip(cell + signs * np.sign(wish), 0, field / 10.0 - 1.0) + 0.5)
            wanted = before + np.clip(wanted - before, -10.0, 10.0)
        np.testing.assert_allclose(farms.position, np.clip(wanted, 0.0, field), atol=2e-3)


def test_no_sign_makes_a_command_larger():
    """Whatever stands where the signs belong: it only says which way an axis points."""
    team, draw = farm_team(FarmConfig(observation=ObservationConfig(mirrored=True))), np.random.default_rng(5)
    seen = draw.uniform(-4, 4, (50, team.observation_size)).astype(np.float32)
    action = draw.uniform(-1, 1, (50, team.action_size)).astype(np.float32)
    assert np.abs(team.steer(seen, action)).max() <= 1.0
    own, taken = team.split_observations(seen)[0], team.split_actions(team.steer(seen, action))[0]
    given = team.split_actions(action)[0]
    np.testing.assert_array_equal(taken, np.where(own[..., SIGNS] < 0.0, -given, given))


@pytest.mark.parametrize(("reach", "cells"), [(0.025, 40), (0.0250001, 40), (0.3, 4), (1.0, 1), (5.0, 1)])
def test_the_fewest_cells_within_reach(reach, cells):
    """So many fill the field, each no wider than a step."""
    assert fewest(reach) == cells
    assert 1.0 / cells <= reach + 1e-9


def test_a_lattice_follows_the_field_and_the_speed():
    """Half the speed along y: twice the rows."""
    world = WorldConfig(field_x=300.0, speed_y_max=5.0)
    lattice = farm_team(FarmConfig(world=world)).groups[1].lattice
    assert (lattice.columns, lattice.rows) == (30, 80)


def test_descriptions_come_back_and_false_ones_are_refused():
    """A team with lattices survives the wire; what is none is one SchemaError."""
    team = farm_team(FarmConfig())
    assert TeamSpec.from_dict(team.to_dict()) == team
    good, missing = ["m", 2, 5, 2], float("nan")
    for bad in (
        [9, 9, 0.1],
        [float("inf"), 9, 0.1, 0.1],
        [0, 9, 0.1, 0.1],
        [9, 2**21, 0.1, 0.1],
        [9, 9, 0.0, 0.1],
        [9, 9, missing, 0.1],
    ):
        with pytest.raises(SchemaError):
            TeamSpec.from_dict({"groups": [[*good, bad]]})
    with pytest.raises(SchemaError):
        TeamSpec.from_dict({"groups": [[*good, [40, 40, 0.1, 0.1], 1]]})
    mirrored = farm_team(FarmConfig(observation=ObservationConfig(mirrored=True)))
    assert TeamSpec.from_dict(mirrored.to_dict()) == mirrored
    for bad in ([None], [None, False], [None, 1], [None, True, True], [[40, 40, 0.1, 0.1], "yes"]):
        with pytest.raises(SchemaError):
            TeamSpec.from_dict({"groups": [[*good, *bad]]})
    with pytest.raises(ConfigError, match="cannot be mirrored"):
        GroupSpec("walker", 1, 3, 2, mirrored=True)
    with pytest.raises(ConfigError, match="cannot steer"):
        GroupSpec("walker", 1, 5, 3, SQUARE)
