"""Compiled choices are those of numpy: options, log-probabilities and velocities."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from eia_sec.common.actors import TeamActors
from eia_sec.common.config.presets import preset
from eia_sec.common.farm import farm_team
from eia_sec.common.team import GroupSpec, TeamSpec
from eia_sec.rollout.worker.action_sampler import ActionSampler

BORDER = (-1.0, -0.9995, -0.975, -0.95, 0.0, 0.95, 0.975, 0.9995, 1.0)
"""Places at the border, at cells' borders and between them, where rounding decides which cell it is."""
TEAMS = {name: farm_team(preset(name).farm) for name in ("instant", "long", "battery")}


def drawn(team: TeamSpec, rows: int, draw: np.random.Generator) -> np.ndarray:
    """Return rows of observations with places and signs as the simulator has them."""
    found = draw.normal(size=(rows, team.observation_size)).astype(np.float32)
    for own in team.split_observations(found):
        place = draw.uniform(-1.0, 1.0, own[..., :2].shape)
        own[..., :2] = np.where(draw.random(place.shape) < 0.3, draw.choice(BORDER, place.shape), place)
        own[..., 2:4] = draw.choice([-1.0, 1.0], place.shape)
    return found


def acting(team: TeamSpec, scale: float, draw: np.random.Generator, *, shared: bool) -> TeamActors:
    """Return actors whose logits have about this scale."""
    actors = TeamActors.initial(team, 8, int(draw.integers(1 << 30)), shared=shared, head="gaussian")
    flat = tuple(np.float32(scale) * draw.standard_normal(own.shape, np.float32) for own in actors.flat)
    return replace(actors, flat=flat)


@pytest.mark.parametrize("shared", [True, False], ids=["shared", "separate"])
@pytest.mark.parametrize("name", TEAMS)
@given(
    seed=st.integers(0, 2**32), scale=st.sampled_from([0.01, 0.3, 1.0, 30.0]), edge=st.sampled_from([None, 0.0, 1.0])
)
def test_they_are_the_choices_of_numpy(name, shared, seed, scale, edge):
    """Velocities are the very same; options too, unless the draw is at a border; log-probabilities but for rounding."""
    team, draw = TEAMS[name], np.random.default_rng(seed)
    actors, seen = acting(team, scale, draw, shared=shared), drawn(team, 5, draw)
    uniform = draw.random((5, team.action_size), np.float32)
    if edge is not None:
        uniform[:] = np.nextafter(np.float32(edge), np.float32(0)) if edge else 0.0
    action, log_probability, velocity = ActionSampler(team).sample(actors, seen, uniform, uniform, None)
    np.testing.assert_array_equal(velocity, team.adapt(seen, action))
    wanted, stated = actors.sample(seen, uniform, uniform)
    near = np.zeros(action.shape, bool)
    for moved in (np.float32(1e-5), np.float32(-1e-5)):
        near |= actors.sample(seen, uniform, np.clip(uniform + moved, 0.0, 1.0))[0] != wanted
    alike = action == wanted
    assert (alike | near).all()
    np.testing.assert_allclose(log_probability[alike], stated[alike], rtol=1e-4, atol=1e-5)


def test_actors_with_memory_remember():
    """The state of their unit moves on once for each choice."""
    team, draw = TEAMS["instant"], np.random.default_rng(4)
    actors = TeamActors.initial(team, 8, 1, shared=True, head="gaussian", memory="gru")
    seen, uniform = drawn(team, 1, draw), draw.random((1, team.action_size), np.float32)
    own, other = np.zeros((2, 1, team.agents, 8), np.float32)
    choices = ActionSampler(team)
    for _ in range(3):
        np.testing.assert_array_equal(
            choices.sample(actors, seen, uniform, uniform, own)[0], actors.sample(seen, uniform, uniform, other)[0]
        )
        np.testing.assert_array_equal(own, other)
    assert own.any()


def test_draws_decide_as_often_as_options_are_likely():
    """Among 4,000 agents that see the same, each option's share is its probability."""
    team, draw = TEAMS["instant"], np.random.default_rng(3)
    actors = acting(team, 0.5, draw, shared=True)
    seen = np.tile(drawn(team, 1, draw), (4000, 1))
    uniform = draw.random((4000, team.action_size), np.float32)
    action, log_probability, _ = ActionSampler(team).sample(actors, seen, uniform, uniform, None)
    for agent in range(team.agents):
        options, counts = np.unique(action[:, agent], return_counts=True)
        for option, count in zip(options, counts, strict=True):
            likely = np.exp(log_probability[action[:, agent] == option, agent][0])
            assert abs(count / 4000 - likely) < 4.5 * np.sqrt(likely * (1 - likely) / 4000) + 1e-6


def test_other_teams_are_left_to_numpy():
    """Continuous actions, masks, several branches, and one type of three that does not fit."""
    whole = TEAMS["instant"]
    assert ActionSampler(whole).compiled
    assert not ActionSampler(farm_team(preset("study").farm)).compiled
    for group in (
        GroupSpec("x", 1, 8, 2),
        GroupSpec("x", 1, 8, 1, choices=(3,)),
        GroupSpec("x", 1, 8, 2, choices=(2, 3)),
        replace(whole.groups[1], name="x", choices=()),
        replace(whole.groups[1], name="x", choices=(12,)),
    ):
        assert not ActionSampler(TeamSpec((*whole.groups, group))).compiled
    moves, lattice, mirrored = whole.groups[1].adapters
    for adapters in ((moves,), (moves, mirrored), (moves, mirrored, lattice), (moves, lattice, mirrored, mirrored)):
        assert not ActionSampler(TeamSpec((replace(whole.groups[1], adapters=adapters),))).compiled
