"""The gated recurrent unit and actors with memory: torch's numbers, and states that belong to whoever lets them act."""

import numpy as np
import pytest
import torch

from eia_sec.common.actors import TeamActors, imitate, layer_shapes, parameter_views
from eia_sec.common.errors import SchemaError
from eia_sec.common.gru import MOST_STATE, checked_memory, next_state
from eia_sec.common.team import GroupSpec, TeamSpec

TEAM = TeamSpec((GroupSpec("a", 2, 7, 2, choices=(2, 3)), GroupSpec("b", 3, 4, 2)))
HIDDEN = 6
ACTORS = [
    TeamActors.initial(TEAM, HIDDEN, 3, per_type=False, head="gaussian", shared=shared, memory="gru")
    for shared in (False, True)
]


def drawn(seed, *shape):
    return np.random.default_rng(seed).uniform(-1, 1, shape).astype(np.float32)


def cell_of(actors, kind, agent):
    """Return an actor as modules of torch: the first layer, the cell and the last layer."""
    group, flat = actors.team.groups[kind], actors.flat[kind]
    outputs = layer_shapes(0, HIDDEN, group.options or 2 * group.action_size)[-1][0]
    views = parameter_views(flat[agent % len(flat)][None], group.observation_size, HIDDEN, outputs, "gru")
    w1, b1, w, b, u, c, w3, b3 = (torch.from_numpy(view[0].copy()) for view in views)
    first, cell, last = torch.nn.Linear(*w1.shape), torch.nn.GRUCell(HIDDEN, HIDDEN), torch.nn.Linear(*w3.shape)
    with torch.no_grad():
        for parameter, wanted in zip(
            [*first.parameters(), *cell.parameters(), *last.parameters()],
            (w1.T, b1, w.T, u.T, b, c, w3.T, b3),
            strict=True,
        ):
            parameter.copy_(wanted)
    return first, cell, last


def test_the_unit_is_torchs_cell():
    """Several networks at once give the states of torch.nn.GRUCell to 1e-6."""
    cells = [torch.nn.GRUCell(HIDDEN, HIDDEN) for _ in range(3)]
    parts = [(c.weight_ih.T, c.bias_ih, c.weight_hh.T, c.bias_hh) for c in cells]
    unit = [np.stack([part.detach().numpy() for part in parameter]) for parameter in zip(*parts, strict=True)]
    x, state = 3.0 * drawn(0, 3, 20, HIDDEN), drawn(1, 3, 20, HIDDEN)
    found = next_state(x, state, *unit)
    for index, cell in enumerate(cells):
        wanted = cell(torch.from_numpy(x[index]), torch.from_numpy(state[index])).detach().numpy()
        np.testing.assert_allclose(found[index], wanted, atol=1e-6)


def test_states_stay_bounded_without_overflow():
    """After 2000 steps of enormous inputs every state is within its bound, and nothing overflows on the way."""
    unit = [1e4 * drawn(index, 1, *shape) for index, shape in enumerate([(4, 12), (12,), (4, 12), (12,)])]
    state = drawn(9, 1, 50, 4)
    with np.errstate(all="raise", under="ignore"):
        for step in range(2000):
            state = next_state(1e4 * drawn(step, 1, 50, 4), state, *unit)
    assert np.abs(state).max() <= MOST_STATE
    assert np.abs(state).max() > 0.99


@pytest.mark.parametrize("actors", ACTORS, ids=["separate", "shared"])
def test_actors_remember_as_torchs_cells_do(actors):
    """Over ten steps of four environments, outputs and states are those of one GRUCell for each agent."""
    state = actors.initial_state(4)
    seen = drawn(2, 10, 4, TEAM.observation_size)
    hidden = {(kind, i): torch.zeros(4, HIDDEN) for kind in range(2) for i in range(TEAM.groups[kind].count)}
    for row in seen:
        for kind, (_, own, outputs) in enumerate(actors.outputs(row, state)):
            for agent in range(TEAM.groups[kind].count):
                first, cell, last = cell_of(actors, kind, agent)
                with torch.no_grad():
                    x = torch.relu(first(torch.from_numpy(own[:, agent].copy())))
                    hidden[kind, agent] = cell(x, hidden[kind, agent])
                    wanted = last(hidden[kind, agent]).numpy()
                np.testing.assert_allclose(outputs[:, agent], wanted, atol=1e-5)
                place = agent + kind * TEAM.groups[0].count
                np.testing.assert_allclose(state[:, place], hidden[kind, agent].numpy(), atol=1e-5)
    assert np.abs(state).min(axis=(0, 2)).max() > 0.0


def test_what_was_seen_before_matters():
    """The same observation gives another action after another one, and the first one again from a state of 0."""
    actors = ACTORS[0]
    state, row, other = actors.initial_state(1), drawn(3, 1, TEAM.observation_size), drawn(4, 1, TEAM.observation_size)
    fresh = actors.act(row, state)[:, -6:]
    actors.act(other, state)
    later = actors.act(row, state)[:, -6:]
    assert np.abs(later - fresh).max() > 1e-3
    np.testing.assert_array_equal(actors.act(row, actors.initial_state(1))[:, -6:], fresh)


def test_actors_without_noise_remember_alike():
    """The noise-free form has a deterministic head, the same states, and the same actions."""
    actors = ACTORS[1]
    plain = actors.noise_free()
    assert (plain.head, plain.memory) == ("deterministic", "gru")
    states = [actors.initial_state(2) for _ in range(2)]
    for step in range(4):
        rows = drawn(step, 2, TEAM.observation_size)
        np.testing.assert_array_equal(plain.act(rows, states[0]), actors.act(rows, states[1]))
        np.testing.assert_array_equal(*states)


def test_agents_imitate_whole_actors():
    """At a rate of 1 an agent with memory becomes its elite: equal observations then give equal outputs."""
    actors = ACTORS[0].copy()
    imitate(actors.flat[1], elite=2, rate=1.0)
    state = actors.initial_state(1)
    for step in range(3):
        row = drawn(step, 1, TEAM.observation_size)
        TEAM.split_observations(row)[1][:] = drawn(step + 9, 4)
        outputs = [part[2] for part in actors.outputs(row, state)][1][0]
        np.testing.assert_array_equal(outputs, np.tile(outputs[2], (3, 1)))


@pytest.mark.parametrize("shape", [None, (2, 5, HIDDEN), (1, 4, HIDDEN), (1, 5, HIDDEN + 1)])
def test_a_state_that_does_not_fit_is_refused(shape):
    """Actors with memory take a state of their environments and agents; actors without take none."""
    state = None if shape is None else np.zeros(shape, np.float32)
    row = drawn(0, 1, TEAM.observation_size)
    with pytest.raises(SchemaError, match="take a state"):
        ACTORS[0].act(row, state)
    plain = TeamActors.initial(TEAM, HIDDEN, 3)
    assert plain.initial_state(1) is None
    if state is not None:
        with pytest.raises(SchemaError, match="take a state None"):
            plain.act(row, state)


def test_a_memory_has_a_name():
    """Another name than those of the kinds is refused."""
    assert checked_memory("gru") == "gru"
    with pytest.raises(SchemaError, match="no memory 'lstm'"):
        checked_memory("lstm")
