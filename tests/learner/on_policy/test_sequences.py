"""Networks with memory go through sequences as actors go through steps, and gradients go back as far as an episode."""

import numpy as np
import pytest
import torch

from eia_sec.common.config import LearnerConfig
from eia_sec.common.transitions import TRANSITION, TRUNCATED
from eia_sec.learner.networks.recurrent import RecurrentStack
from eia_sec.learner.networks.sequences import SequenceLayout, Sequences
from eia_sec.learner.on_policy.experience import split
from eia_sec.learner.on_policy.iteration_states import IterationStates
from eia_sec.learner.on_policy.trainer import OnPolicyTrainer
from eia_sec.learner.on_policy.updates import Updates
from tests.learner.on_policy.recurrent_runs import ENDS, LENGTH, played, remembered_chunk, with_memory
from tests.learner.on_policy.small_runs import ALGORITHMS, TEAM

INPUTS, HIDDEN = 3, 4


def stack_of(count):
    stack = RecurrentStack(count, INPUTS, HIDDEN, 2)
    stack.draw(1.0, [(0, "test", index) for index in range(count)])
    return stack


def sequences_of(keep, networks):
    state = torch.rand(keep.shape[1], networks, HIDDEN, generator=torch.Generator().manual_seed(1))
    return Sequences(keep, state)


@pytest.mark.parametrize("count", [1, 3])
def test_a_sequence_is_its_steps_one_after_another(count):
    """Going through six steps at once gives what six single steps give, states of 0 where episodes begin included."""
    stack, keep = stack_of(count), torch.ones(6, 5)
    keep[3, 1] = keep[0, 2] = keep[5, 4] = 0.0
    x, sequences = torch.randn(6, 5, 3, INPUTS), sequences_of(keep, 3)
    whole = stack.unroll(x.flatten(0, 1), sequences)
    state = sequences.state
    for step in range(6):
        state = state * keep[step][:, None, None]
        found = stack.unroll(x[step], Sequences(torch.ones(1, 5), state))
        state = found.state
        torch.testing.assert_close(whole.outputs.view(6, 5, 3, 2)[step], found.outputs)
        torch.testing.assert_close(whole.state.view(6, 5, 3, HIDDEN)[step], state)


@pytest.mark.parametrize("count", [1, 2])
def test_gradients_flow_back_through_time_to_the_beginning_of_the_episode(count):
    """The last output of a sequence depends on every earlier input of its episode, and on none before it."""
    stack, keep = stack_of(count), torch.ones(6, 2)
    keep[2, 1] = 0.0
    x = torch.randn(6, 2, 2, INPUTS, requires_grad=True)
    sequences = sequences_of(keep, 2)
    sequences.state.requires_grad_()
    outputs = stack(x.flatten(0, 1), sequences).view(6, 2, 2, 2)
    outputs[5].sum().backward()
    reached = x.grad.abs().sum(dim=(2, 3)) > 0
    assert reached.tolist() == [[True, False]] * 2 + [[True, True]] * 4
    assert (sequences.state.grad.abs().sum(dim=(1, 2)) > 0).tolist() == [True, False]


def test_networks_of_equal_weights_are_equal_shared_or_not():
    """One network for two agents and two copies of it compute the same."""
    shared, separate = stack_of(1), stack_of(2)
    separate.load(np.repeat(shared.export(), 2, axis=0))
    x, sequences = torch.randn(8, 2, INPUTS), sequences_of(torch.ones(4, 2), 2)
    torch.testing.assert_close(shared(x, sequences), separate(x, sequences))


def test_rough_products_leave_states_whole():
    """With inputs of bfloat16, outputs and states are float32 and near those of float32; gradients are finite."""
    stack, sequences = stack_of(2), sequences_of(torch.ones(20, 3), 2)
    x = torch.randn(60, 2, INPUTS).to(torch.bfloat16)
    exact, rough = stack.unroll(x.float(), sequences), stack.unroll(x, sequences)
    assert {part.dtype for part in rough} == {torch.float32}
    torch.testing.assert_close(rough.state, exact.state, atol=0.05, rtol=0.0)
    rough.outputs.square().sum().backward()
    assert all(bool(torch.isfinite(layer).all()) and bool(layer.any()) for layer in stack.layers_of(stack.flat.grad))


def test_sequences_hold_the_steps_in_order():
    """Every step is in one sequence, after the step before; an episode begins where the segment before has ended."""
    actors = OnPolicyTrainer(with_memory(), TEAM).actors()
    rows = remembered_chunk(actors, 0).rows
    layout = SequenceLayout(rows, LENGTH)
    assert layout.rows.shape == (LENGTH, 8)
    assert sorted(layout.rows.reshape(-1).tolist()) == np.flatnonzero(rows.flag & TRANSITION).tolist()
    first = [layout.rows[:, number].tolist() for number in range(0, 8, 2)]
    assert first == [[0, 1, 2, 3, 4], [5, 6, 8, 9, 10], [11, 12, 13, 14, 15], [16, 17, 19, 20, 21]]
    begins = np.argwhere(layout.keep == 0.0).tolist()
    assert begins == [[0, 3], [2, 2], [2, 6]]
    groups = list(layout.in_order())
    assert np.concatenate([block for _, blocks in groups for block in blocks]).tolist() == list(range(8))


def test_groups_of_environments_are_all_environments(monkeypatch):
    """Where rows are many, environments are taken in several groups, with the same states and values."""
    trainer = OnPolicyTrainer(with_memory("eia-ppo"), TEAM)
    rows = remembered_chunk(trainer.actors(), 1, ENDS * 3).rows
    found = []
    for most in (4096, 2 * LENGTH):
        monkeypatch.setattr("eia_sec.learner.networks.sequences.LARGEST_BATCH", most)
        updates = Updates(trainer.config.on_policy, TEAM, 5, LearnerConfig())
        states = IterationStates(trainer.config.on_policy, TEAM, rows, updates.values, "cpu")
        assert len(list(states.layout.in_order())) == (1 if most == 4096 else 3)
        value = states.begin(updates.policies, torch.from_numpy(rows.observation))
        found.append((torch.from_numpy(value), states.actors, states.values))
    for one, other in zip(*found, strict=True):
        torch.testing.assert_close(one, other)


@pytest.mark.parametrize("name", ALGORITHMS)
@pytest.mark.parametrize("shared_until", [1.0, 0.0])
def test_the_learner_finds_the_states_of_the_workers(name, shared_until):
    """States before all sequences, and log-probabilities of all steps, are those of the actors that acted."""
    config = with_memory(name, shared_until=shared_until)
    updates = Updates(config.on_policy, TEAM, 5, LearnerConfig())
    actors = updates.policies.actors()
    rows = remembered_chunk(actors, 2).rows
    states = IterationStates(config.on_policy, TEAM, rows, updates.values, "cpu")
    states.begin(updates.policies, torch.from_numpy(rows.observation))
    for number in range(states.layout.count):
        environment, first = number % 2, int(states.layout.rows[0, number])
        before, state = slice((0, 23)[environment], first), rows.state[environment : environment + 1].copy()
        played(actors, rows.observation[before], rows.flag[before], state, np.random.default_rng(0))
        np.testing.assert_allclose(states.actors[number].numpy(), state[0], atol=1e-5)
    places, sequences = states.rows_and_sequences(np.arange(states.layout.count))
    observation = torch.from_numpy(rows.observation[places])
    for kind, (own, action) in enumerate(
        zip(split(TEAM, observation), TEAM.split_actions(rows.action[places]), strict=True)
    ):
        agents = TEAM.agent_slices()[kind]
        known = torch.from_numpy(rows.log_probability[places][:, agents])
        policy = updates.policies.evaluate(kind, own, torch.from_numpy(action.copy()), sequences[kind][0])
        torch.testing.assert_close(policy.log_probability, known, atol=1e-5, rtol=1e-5)


def test_values_begin_each_chunk_with_nothing():
    """V in a chunk that begins inside an episode is that of an episode that begins there; a last row has one, too."""
    config = with_memory()
    updates = Updates(config.on_policy, TEAM, 5, LearnerConfig())
    rows = remembered_chunk(updates.policies.actors(), 3, (((20, TRUNCATED),),)).rows
    states = IterationStates(config.on_policy, TEAM, rows, updates.values, "cpu")
    value = states.begin(updates.policies, torch.from_numpy(rows.observation))
    observation = torch.from_numpy(rows.observation)
    start = Sequences(torch.ones(21, 1), torch.zeros(1, TEAM.agents, config.on_policy.hidden))
    parts = [
        network.unroll(observation, own, start.of(agents)).outputs
        for network, own, agents in zip(updates.values, split(TEAM, observation), TEAM.agent_slices(), strict=True)
    ]
    np.testing.assert_allclose(value, torch.cat(parts, dim=1).detach().numpy(), atol=1e-5)
    assert np.abs(states.values[0].numpy()).max() == 0.0
    assert np.abs(value[20]).min() > 0.0
