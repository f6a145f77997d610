"""Choices among options: the legal one with the largest logit, and samples that follow their probabilities."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from eia_sec.common.actions.sampling import best_options, epsilon_greedy, sample_options, sample_squashed
from eia_sec.common.actors import TeamActors
from eia_sec.common.errors import ConfigError, SchemaError
from eia_sec.common.team import GroupSpec, TeamSpec

PLAIN = GroupSpec("a", 2, 3, 2, choices=(3, 4))
MASKED = GroupSpec("a", 2, 10, 2, choices=(3, 4), masked=True)
SEEDS = st.integers(0, 2**32)


def drawn(seed, group, rows=20):
    """Return observations with random masks that allow something in each branch, and logits."""
    draw = np.random.default_rng(seed)
    observation = draw.uniform(-1, 1, (rows, group.observation_size)).astype(np.float32)
    legal = draw.integers(0, 2, (rows, group.options)).astype(np.float32)
    start = 0
    for options in group.choices:
        legal[np.arange(rows), start + draw.integers(0, options, rows)] = 1.0
        start += options
    if group.masked:
        observation[:, -group.options :] = legal
    else:
        legal[:] = 1.0
    return observation, legal, draw.normal(0.0, 3.0, (rows, group.options)).astype(np.float32), draw


@pytest.mark.parametrize("group", [PLAIN, MASKED])
@given(seed=SEEDS)
def test_the_best_legal_option_of_each_branch(group, seed):
    """A plain loop over rows and branches chooses the same."""
    observation, legal, logits, _ = drawn(seed, group)
    found = best_options(group, observation, logits)
    assert found.dtype == np.float32
    for row in range(len(logits)):
        for branch, options in enumerate((range(3), range(3, 7))):
            allowed = [option for option in options if legal[row, option]]
            assert found[row, branch] == max(allowed, key=lambda k: logits[row, k]) - options.start


@pytest.mark.parametrize("group", [PLAIN, MASKED])
@given(seed=SEEDS)
def test_without_epsilon_the_best_option_is_chosen_and_with_all_of_it_any_legal_one(group, seed):
    """Legal options alone, whatever their values; in between, the numbers below epsilon decide."""
    observation, legal, values, draw = drawn(seed, group)
    uniform = draw.random((len(values), 2), np.float32)
    best = best_options(group, observation, values)
    np.testing.assert_array_equal(epsilon_greedy(group, observation, values, uniform, 0.0), best)
    some = epsilon_greedy(group, observation, values, uniform, 0.3)
    assert some.dtype == np.float32
    np.testing.assert_array_equal(some[uniform >= 0.3], best[uniform >= 0.3])
    for found in (some, epsilon_greedy(group, observation, values, uniform, 1.0)):
        for branch, start in enumerate((0, 3)):
            assert legal[np.arange(len(values)), start + found[:, branch].astype(int)].all()


def test_epsilon_is_the_share_of_options_that_chance_draws_evenly():
    """Of n options all have a share of epsilon / n, and the best one has the rest besides."""
    rows, epsilon = 40_000, 0.4
    observation, values = np.zeros((rows, PLAIN.observation_size), np.float32), np.zeros((rows, 7), np.float32)
    values[:, (1, 5)] = 1.0
    uniform = np.random.default_rng(0).random((rows, 2), np.float32)
    found = epsilon_greedy(PLAIN, observation, values, uniform, epsilon)
    for branch, (options, best) in enumerate(((3, 1), (4, 2))):
        shares = np.bincount(found[:, branch].astype(int), minlength=options) / rows
        wanted = np.full(options, epsilon / options)
        wanted[best] += 1.0 - epsilon
        np.testing.assert_allclose(shares, wanted, atol=0.01)


@pytest.mark.parametrize("group", [PLAIN, MASKED])
@given(seed=SEEDS, edge=st.sampled_from([None, 0.0, np.nextafter(np.float32(1), np.float32(0)), 1.0]))
def test_samples_are_legal_and_know_their_probability(group, seed, edge):
    """The logarithm is the sum over branches of log softmax, at the ends of the random numbers' range too."""
    observation, legal, logits, draw = drawn(seed, group)
    uniform = draw.random((len(logits), 2), np.float32)
    if edge is not None:
        uniform[:] = edge
    option, log_probability = sample_options(group, observation, logits, uniform)
    wanted = np.zeros(len(logits))
    for branch, part in enumerate((slice(0, 3), slice(3, 7))):
        chosen = option[:, branch].astype(int)
        rows = np.arange(len(logits))
        assert legal[:, part][rows, chosen].all()
        weight = np.exp(logits[:, part].astype(np.float64)) * legal[:, part]
        wanted += np.log(weight[rows, chosen] / weight.sum(axis=1))
    np.testing.assert_allclose(log_probability, wanted, rtol=1e-4, atol=1e-5)


def test_frequencies_are_the_probabilities():
    """Many samples of one distribution, with an option that is forbidden."""
    group = GroupSpec("a", 1, 5, 1, choices=(4,), masked=True)
    observation = np.tile(np.array([0.0, 1.0, 1.0, 0.0, 1.0], np.float32), (40_000, 1))
    logits = np.tile(np.log(np.array([0.2, 0.3, 9.0, 0.5], np.float32)), (40_000, 1))
    uniform = np.random.default_rng(0).random((40_000, 1), np.float32)
    option, _ = sample_options(group, observation, logits, uniform)
    share = np.bincount(option[:, 0].astype(int), minlength=4) / 40_000
    np.testing.assert_allclose(share, [0.2, 0.3, 0.0, 0.5], atol=0.01)


def test_squashed_samples_know_their_density_before_the_tanh():
    """The log-probability is that of artanh(a) under the Gaussian."""
    draw = np.random.default_rng(1)
    mean, log_std, noise = draw.normal(size=(3, 50, 2)).astype(np.float32) * np.float32(0.5)
    action, log_probability = sample_squashed(mean, log_std, noise)
    x, std = np.arctanh(action.astype(np.float64)), np.exp(log_std.astype(np.float64))
    wanted = (-0.5 * ((x - mean) / std) ** 2 - np.log(std) - 0.5 * np.log(2 * np.pi)).sum(axis=1)
    np.testing.assert_allclose(log_probability, wanted, rtol=1e-3, atol=1e-3)


@pytest.mark.parametrize("head", ["deterministic", "gaussian"])
def test_shared_actors_act_as_equal_ones(head):
    """One row of parameters serves all agents of a type; without noise the head does not matter."""
    team = TeamSpec((MASKED, GroupSpec("b", 3, 4, 2)))
    shared = TeamActors.initial(team, 8, 0, head=head, shared=True)
    alike = TeamActors.initial(team, 8, 0, head=head)
    rows = np.random.default_rng(0).uniform(-1, 1, (6, team.observation_size)).astype(np.float32)
    np.testing.assert_allclose(shared.act(rows), alike.act(rows), atol=1e-6)
    np.testing.assert_array_equal(shared.noise_free().act(rows), shared.act(rows))


@given(
    choices=st.lists(st.integers(1, 9), max_size=4),
    masked=st.booleans(),
    extra=st.integers(1, 5),
)
def test_a_team_with_choices_survives_the_wire(choices, masked, extra):
    """Choices and masks come back as they were and matter for the digest."""
    masked = masked and bool(choices)
    group = GroupSpec("a", 2, extra + sum(choices), len(choices) or 2, choices=tuple(choices), masked=masked)
    team = TeamSpec((group, GroupSpec("b", 1, 3, 2)))
    assert TeamSpec.from_dict(team.to_dict()) == team
    plain = TeamSpec((GroupSpec("a", 2, group.observation_size, group.action_size), team.groups[1]))
    assert (plain.digest == team.digest) == (not choices)


@pytest.mark.parametrize(
    "change",
    [
        {"choices": [3]},
        {"choices": [3, 0]},
        {"choices": [3, 2.0]},
        {"choices": [3, 70_000]},
        {"choices": 3},
        {"masked": 1},
        {"choices": [], "masked": True},
        {"observation_size": 7},
    ],
)
def test_false_descriptions_of_choices_are_refused(change):
    """Whatever a file or a peer says instead of choices is one SchemaError."""
    with pytest.raises(SchemaError):
        TeamSpec.from_dict({"groups": [{**MASKED.to_dict(), **change}]})


def test_a_mask_needs_choices_and_something_to_see():
    """Both are said when the type is made."""
    with pytest.raises(ConfigError, match="a mask needs discrete actions"):
        GroupSpec("a", 1, 5, 2, masked=True)
    with pytest.raises(ConfigError, match="2 branches of choices do not fit actions of 1"):
        GroupSpec("a", 1, 5, 1, choices=(2, 2))
