"""Action adapters: the lattice beside a plain loop, mirrored axes on a farm, and their descriptions."""

import itertools
import json
import math
from dataclasses import replace

import numpy as np
import pytest

from eia_sec.common.actions.adapters import (
    GAIN,
    SIGNS,
    Lattice,
    MirroredAxes,
    fewest,
)
from eia_sec.common.actions.descriptions import adapter_from_dict, adapter_to_dict
from eia_sec.common.config import ControlConfig, FarmConfig, ObservationConfig, WorldConfig
from eia_sec.common.config.presets import preset
from eia_sec.common.errors import ConfigError, SchemaError
from eia_sec.common.farm import farm_team, lattice_of
from eia_sec.common.team import GroupSpec, TeamSpec
from eia_sec.rollout.sim.batch import FarmBatch

FIELD = 400.0
PLAIN = preset("eia-sec").farm
"""A farm with continuous actions."""
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
        cell, inset = min(max(cell + step, 0), count - 1), lattice.inset
        goal = min(max(share, (cell + inset) / count), (cell + 1 - inset) / count)
        velocity.append(min(1.0, max(-1.0, (goal - share) / reach)))
    return velocity


@pytest.mark.parametrize(
    "lattice",
    [
        SQUARE,
        Lattice.spanning(0.03, 0.4),
        Lattice(1, 7, 2.0, 0.2),
        replace(SQUARE, inset=0.36),
        Lattice(9, 7, 0.05, 0.2, 0.01),
    ],
)
def test_velocities_are_those_of_a_plain_loop(lattice):
    """Random places and actions, the outermost ones and corners included."""
    draw = np.random.default_rng(0)
    place, action = draw.uniform(-1, 1, (2, 500, 2)).astype(np.float32)
    corners = np.array(list(itertools.product((-1.0, 0.0, 1.0), repeat=2)), np.float32)
    place, action = np.concatenate([place, corners]), np.concatenate([action, corners[::-1]])
    found = lattice.velocity(place, action)
    assert found.dtype == np.float32
    expected = [plain(lattice, p, a) for p, a in zip(place.tolist(), action.tolist(), strict=True)]
    np.testing.assert_allclose(found, expected, atol=2e-5)


@pytest.mark.parametrize("lattice", [replace(SQUARE, inset=0.36), Lattice(9, 7, 0.12, 0.15, 0.2)])
def test_with_an_inset_a_step_ends_inside_the_selected_cell_and_is_never_longer(lattice):
    """An agent inside its own cell arrives, others do unless full speed is too slow; the cell's centre is no nearer."""
    draw, inset = np.random.default_rng(6), lattice.inset
    count, reach = np.array([lattice.columns, lattice.rows]), np.array([lattice.reach_x, lattice.reach_y])
    cell = draw.integers(0, count, (2000, 2))
    offset = draw.uniform(0.001, 0.999, cell.shape)
    place = (2.0 * (cell + offset) / count - 1.0).astype(np.float32)
    action = draw.uniform(-1, 1, cell.shape).astype(np.float32)
    selected = np.clip(cell + np.where(abs(action) * GAIN <= 0.5, 0, np.sign(action)), 0, count - 1)
    velocity = lattice.velocity(place, action)
    ends = cell + offset + velocity.astype(np.float64) * reach * count - selected
    within = (ends >= inset - 1e-4) & (ends <= 1.0 - inset + 1e-4)
    started = (offset >= inset) & (offset <= 1.0 - inset)
    assert within[started | (abs(velocity) < 1.0)].all()
    assert not within.all(), "some agents were too far for one step"
    centre = replace(lattice, inset=0.5).velocity(place, action)
    assert (abs(velocity) <= abs(centre)).all()
    assert (abs(velocity) < abs(centre)).mean() > 0.2
    stays = (selected == cell) & (offset >= inset + 1e-4) & (offset <= 1.0 - inset - 1e-4)
    assert (velocity[stays] == 0.0).all()
    assert (centre[stays] != 0.0).any()


@pytest.mark.parametrize("inset", [0.0, 0.009, 0.51, 1.0, -0.36, math.inf, math.nan])
def test_an_inset_outside_the_cell_is_refused(inset):
    """Nothing below 0.01 and nothing beyond the centre, in a lattice and in a farm's configuration."""
    with pytest.raises(ConfigError, match=r"^inset must be between 0\.01 and 0\.5, "):
        replace(SQUARE, inset=inset)
    for name in ("monitoring_inset", "collection_inset"):
        with pytest.raises(ConfigError, match=rf"^{name} must be between 0\.01 and 0\.5, "):
            ControlConfig(**{name: inset})


def test_on_a_place_every_action_leads_to_the_next_place_or_none():
    """Nine actions from a place in the middle: its eight neighbours and itself, reached in one step."""
    start = np.array([205.0, 115.0])
    place = (2 * start / FIELD - 1).astype(np.float32)
    for wish in itertools.product((-1, 0, 1), repeat=2):
        velocity = SQUARE.velocity(place, np.array(wish, np.float32))
        np.testing.assert_allclose(start + 10.0 * velocity, start + 10.0 * np.array(wish), atol=1e-3)


def test_noise_below_a_third_of_the_range_changes_nothing():
    """Clear decisions survive it; undecided ones do not."""
    draw = np.random.default_rng(1)
    place = draw.uniform(-1, 1, (300, 2)).astype(np.float32)
    clear = draw.choice([-0.99, 0.0, 0.99], (300, 2)).astype(np.float32)
    noise = draw.uniform(-0.33, 0.33, (300, 2)).astype(np.float32)
    np.testing.assert_array_equal(SQUARE.velocity(place, clear), SQUARE.velocity(place, np.clip(clear + noise, -1, 1)))
    undecided = np.full((300, 2), 0.34, np.float32)
    assert (SQUARE.velocity(place, undecided) != SQUARE.velocity(place, np.clip(undecided + noise, -1, 1))).any()


def test_a_farms_monitors_reach_the_lattice_and_never_leave_the_field():
    """Whatever the actors say: on the lattice soon, as staying once is enough, and no boundary violation."""
    config = FarmConfig(control=ControlConfig(communication="lattice", monitoring="lattice", collection="lattice"))
    farms, draw = FarmBatch(config, 3), np.random.default_rng(2)
    for index in range(3):
        farms.reset(index, index, 5)
    for step in range(80):
        action = draw.uniform(-1, 1, (3, farms.team.action_size)).astype(np.float32)
        farms.step(farms.team.adapt(farms.observation, action))
        if step > 40:
            off = (farms.position[..., :2] - 5.0) / 10.0
            np.testing.assert_allclose(off, np.rint(off), atol=1e-3)
    assert all(farms.summary(index).metrics["boundary"] == 0 for index in range(3))


@pytest.mark.parametrize("inset", [0.5, 0.36])
@pytest.mark.parametrize(("control", "on", "back"), [("lattice", [0, 1], [0, -1]), ("moves", [5], [3])])
def test_monitors_that_weave_fly_twice_the_inset_in_each_step(control, on, back, inset):
    """Between two cells of 10 m this is 10 m for an inset of 0.5, and 7.2 m for 0.36."""
    seen = replace(PLAIN.observation, mirrored=False)
    steering = replace(PLAIN.control, monitoring=control, monitoring_inset=inset)
    farms = FarmBatch(replace(PLAIN, observation=seen, control=steering), 2)
    for index in range(2):
        farms.reset(index, index, 5)
    for step in range(10):
        before, action = farms.position[:, 4:8].copy(), np.zeros((2, farms.team.action_size), np.float32)
        farms.team.split_actions(action)[1][:] = back if step % 2 else on
        farms.step(farms.team.adapt(farms.observation, action))
        if step > 2:
            way = np.broadcast_to([0.0, 20.0 * inset], before.shape)
            np.testing.assert_allclose(np.abs(farms.position[:, 4:8] - before), way, atol=1e-3)


def test_only_those_with_a_lattice_are_steered():
    """The others' actions pass as they are, and a team without lattices hands the very array on."""
    study = preset("study").farm
    team = farm_team(study)
    assert [bool(group.adapters) for group in team.groups] == [False, True, False]
    draw = np.random.default_rng(3)
    seen = draw.uniform(-1, 1, (2, team.observation_size)).astype(np.float32)
    action = draw.uniform(-1, 1, (2, team.action_size)).astype(np.float32)
    before, steered = action.copy(), team.adapt(seen, action)
    np.testing.assert_array_equal(action, before)
    for group, own, given, taken in zip(
        team.groups, team.split_observations(seen), team.split_actions(action), team.split_actions(steered), strict=True
    ):
        wanted = group.adapters[0].velocity(own[..., :2], given) if group.adapters else given
        np.testing.assert_array_equal(taken, wanted)
    plain_team = farm_team(replace(study, control=replace(study.control, monitoring="velocity")))
    assert plain_team.adapt(seen, action) is action
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
        farms.step(farms.team.adapt(farms.observation, action))
        if control == "velocity":
            wanted = before + 10.0 * signs * wish
        else:
            cell = np.floor(before / 10.0 + 1e-3)
            wanted = 10.0 * (np.clip(cell + signs * np.sign(wish), 0, field / 10.0 - 1.0) + 0.5)
            wanted = before + np.clip(wanted - before, -10.0, 10.0)
        np.testing.assert_allclose(farms.position, np.clip(wanted, 0.0, field), atol=2e-3)


def test_no_sign_makes_a_command_larger():
    """Whatever stands where the signs belong: it only says which way an axis points."""
    team, draw = farm_team(PLAIN), np.random.default_rng(5)
    seen = draw.uniform(-4, 4, (50, team.observation_size)).astype(np.float32)
    action = draw.uniform(-1, 1, (50, team.action_size)).astype(np.float32)
    assert np.abs(team.adapt(seen, action)).max() <= 1.0
    own, taken = team.split_observations(seen)[0], team.split_actions(team.adapt(seen, action))[0]
    given = team.split_actions(action)[0]
    np.testing.assert_array_equal(taken, np.where(own[..., SIGNS] < 0.0, -given, given))


@pytest.mark.parametrize(("reach", "cells"), [(0.025, 40), (0.0250001, 40), (0.3, 4), (1.0, 1), (5.0, 1)])
def test_the_fewest_cells_within_reach(reach, cells):
    """So many fill the field, each no wider than a step."""
    assert fewest(reach) == cells
    assert 1.0 / cells <= reach + 1e-9


@pytest.mark.parametrize(
    ("reach", "parts", "cells"),
    [(0.025, 20, 40), (0.0327, 16, 32), (0.0327, 15, 45), (0.05, 20, 20), (0.3, 20, 4), (0.0250001, 40, 40)],
)
def test_equally_many_cells_in_each_part(reach, parts, cells):
    """None is wider than a step; parts narrower than a step do not count."""
    assert fewest(reach, parts) == cells
    assert 1.0 / cells <= reach + 1e-9
    assert cells % parts == 0 or reach * parts > 1.0


def test_a_lattice_lies_alike_in_all_plots():
    """On a field whose sides are no multiples of a step, every plot has its points in the same places."""
    world = WorldConfig(field_x=339.9, field_y=306.1, plots_x=17, plots_y=16)
    lattice = lattice_of(world)
    assert (lattice.columns, lattice.rows) == (34, 32)
    depth = world.field_y / world.plots_y
    within = ((np.arange(lattice.rows) + 0.5) * world.field_y / lattice.rows).reshape(world.plots_y, -1) % depth
    np.testing.assert_allclose(within, np.tile([depth / 4, 3 * depth / 4], (16, 1)))


def test_a_lattice_follows_the_field_and_the_speed():
    """Half the speed along y: twice the rows."""
    world = WorldConfig(field_x=300.0, plots_x=15, speed_y_max=5.0)
    lattice = farm_team(replace(PLAIN, world=world)).groups[1].adapters[0]
    assert (lattice.columns, lattice.rows) == (30, 80)


LATTICE = {"kind": "lattice", "columns": 40, "rows": 40, "reach_x": 0.025, "reach_y": 0.025, "inset": 0.5}
MIRRORED = {"kind": "mirrored axes"}
GROUP = {
    "name": "m",
    "count": 2,
    "observation_size": 5,
    "action_size": 2,
    "adapters": [LATTICE, MIRRORED],
    "choices": [],
    "masked": False,
}


def test_an_inset_is_part_of_a_lattice():
    """It comes back from a description, and teams that differ in it have different digests."""
    lattice = adapter_from_dict(LATTICE)
    assert adapter_to_dict(lattice) == LATTICE
    nearer = adapter_from_dict({**LATTICE, "inset": 0.36})
    assert nearer == replace(lattice, inset=0.36)
    groups = [{**GROUP, "adapters": [adapter_to_dict(each)]} for each in (lattice, nearer)]
    assert len({TeamSpec.from_dict({"groups": [group]}).digest for group in groups}) == 2


def test_a_team_with_adapters_survives_the_wire():
    """Adapters come back as they were, in their order, which matters for the digest."""
    team = TeamSpec.from_dict(json.loads(json.dumps({"groups": [GROUP]})))
    (group,) = team.groups
    assert group.adapters == (Lattice(40, 40, 0.025, 0.025), MirroredAxes())
    assert TeamSpec.from_dict(json.loads(json.dumps(team.to_dict()))) == team
    other = TeamSpec((replace(group, adapters=group.adapters[::-1]),))
    assert TeamSpec.from_dict(other.to_dict()) == other
    assert len({team.digest, other.digest, TeamSpec((replace(group, adapters=()),)).digest}) == 3


@pytest.mark.parametrize(
    "adapters",
    [
        None,
        ["lattice"],
        [{}],
        [{"kind": "other"}],
        [{"kind": ["lattice"]}],
        [{**LATTICE, "columns": 0}],
        [{**LATTICE, "columns": 2**21}],
        [{**LATTICE, "columns": 40.0}],
        [{**LATTICE, "rows": True}],
        [{**LATTICE, "reach_x": 0}],
        [{**LATTICE, "reach_x": float("nan")}],
        [{**LATTICE, "reach_y": "far"}],
        [{**LATTICE, "inset": 0.6}],
        [{**LATTICE, "inset": "0.36"}],
        [{**LATTICE, "more": 1}],
        [{**MIRRORED, "more": 1}],
        [{key: value for key, value in LATTICE.items() if key != "rows"}],
        [{key: value for key, value in LATTICE.items() if key != "inset"}],
    ],
)
def test_false_descriptions_of_adapters_are_refused(adapters):
    """Whatever a file or a peer says instead of an adapter is one SchemaError."""
    with pytest.raises(SchemaError):
        TeamSpec.from_dict({"groups": [{**GROUP, "adapters": adapters}]})


@pytest.mark.parametrize(
    "group",
    [
        ["m", 2, 5, 2],
        {},
        {key: value for key, value in GROUP.items() if key != "masked"},
        {**GROUP, "count": "2"},
        {**GROUP, "count": 2.0},
        {**GROUP, "count": 10**400},
        {**GROUP, "more": 2},
        {**GROUP, "action_size": 3},
        {**GROUP, "observation_size": 3},
        "m",
    ],
)
def test_false_descriptions_of_a_type_are_refused(group):
    """Lists, and maps with one mistake each."""
    with pytest.raises(SchemaError):
        TeamSpec.from_dict({"groups": [group]})


@pytest.mark.parametrize("name", ["", "../../pwn", "/etc/x", "a/b", ".hidden", "a\0b", "a\x1b[2J", "x" * 64])
def test_a_types_name_can_stand_in_a_path(name):
    """Exported files are named after the type, so its name has no separators or control characters."""
    with pytest.raises(SchemaError, match="a type of agent"):
        TeamSpec.from_dict({"groups": [{**GROUP, "name": name}]})


def test_adapters_refuse_agents_that_they_do_not_fit():
    """A lattice needs a position and two outputs, mirrored axes signs as well."""
    with pytest.raises(ConfigError, match="mirrored axes need"):
        GroupSpec("walker", 1, 3, 2, (MirroredAxes(),))
    with pytest.raises(ConfigError, match="a lattice needs"):
        GroupSpec("walker", 1, 5, 3, (SQUARE,))


def test_observations_from_outside_are_checked_by_the_adapters_that_read_them():
    """Signs that are none are named; a lattice takes any position."""
    observation = np.array([0.5, 0.5, 1.0, -1.0, 0.0], np.float32)
    assert not MirroredAxes().complaint(observation)
    observation[3] = 0.5
    assert "signs" in MirroredAxes().complaint(observation)
    assert not SQUARE.complaint(observation)
