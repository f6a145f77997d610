"""Log-probabilities and entropies of policies, against torch.distributions and against the workers' numbers."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch.distributions import Categorical, Independent, Normal, TransformedDistribution
from torch.distributions.transforms import TanhTransform

from eia_sec.common.actions.sampling import ILLEGAL
from eia_sec.common.actors import TeamActors
from eia_sec.common.team import GroupSpec, TeamSpec
from eia_sec.learner.on_policy.distributions import evaluate
from eia_sec.learner.on_policy.experience import split, split_actions
from tests.learner.on_policy.oracle import squashed_entropy
from tests.learner.on_policy.small_runs import observations, sampled

FREE = GroupSpec("free", 3, 4, 2, choices=(3, 4))
ONE = GroupSpec("one", 2, 4, 1, choices=(5,))
MASKED = GroupSpec("masked", 2, 9, 2, choices=(2, 4), masked=True)
SMOOTH = GroupSpec("smooth", 3, 2, 2)
TEAM = TeamSpec((FREE, MASKED, SMOOTH))
BATCH = 64


def case(group, seed):
    """Return observations, outputs and actions of a type, as a learner has them; every action is legal."""
    draw = np.random.default_rng(seed)
    rows = observations(TeamSpec((group,)), BATCH, draw)
    own = torch.from_numpy(rows).view(BATCH, group.count, group.observation_size)
    outputs = torch.from_numpy(draw.normal(0, 2, (BATCH, group.count, group.options or 2 * group.action_size)))
    if not group.choices:
        return own, outputs, torch.from_numpy(np.tanh(draw.normal(size=(BATCH, group.count, group.action_size))))
    logits = outputs if not group.masked else torch.where(own[..., -group.options :] > 0.5, outputs, -torch.inf)
    parts = torch.split(logits, list(group.choices), dim=-1)
    torch.manual_seed(seed)
    return own, outputs, torch.stack([Categorical(logits=part).sample() for part in parts], dim=-1).double()


def legal_parts(group, own, outputs):
    """Return the distributions of a type's branches, over legal options only."""
    legal = own[..., -group.options :].double() if group.masked else torch.ones_like(outputs)
    shares = [torch.softmax(part, dim=-1) for part in torch.split(outputs, list(group.choices), dim=-1)]
    weights = [share * part for share, part in zip(shares, torch.split(legal, list(group.choices), -1), strict=True)]
    return [Categorical(probs=weight) for weight in weights]


@pytest.mark.parametrize("group", [ONE, FREE, MASKED], ids=lambda group: group.name)
def test_discrete_actions_have_the_probabilities_of_torch(group):
    """The log-probability and the entropy of an action are the sums over its branches, over legal options only."""
    own, outputs, action = case(group, 1)
    found = evaluate(group, own, outputs, action)
    parts = legal_parts(group, own, outputs)
    wanted = sum(part.log_prob(action[..., index]) for index, part in enumerate(parts))
    torch.testing.assert_close(found.log_probability, wanted)
    torch.testing.assert_close(found.entropy, sum(part.entropy() for part in parts), atol=1e-6, rtol=1e-6)


def test_continuous_actions_have_the_probabilities_of_torch():
    """Those of a Gaussian at artanh of the action, summed over the action's numbers, log s clipped to its range."""
    own, outputs, action = case(SMOOTH, 2)
    outputs[0, 0, 2:] = torch.tensor([-30.0, 5.0])
    action[0, 0, 0] = torch.tanh(outputs[0, 0, 0])
    found = evaluate(SMOOTH, own, outputs, action)
    wanted = Independent(Normal(outputs[..., :2], outputs[..., 2:].clamp(-20.0, 2.0).exp()), 1)
    torch.testing.assert_close(found.log_probability, wanted.log_prob(torch.atanh(action)))


def test_the_entropy_of_continuous_actions_is_that_after_the_tanh():
    """It agrees with the mean of -ln p over samples, and falls when the Gaussian is wider than the tanh can hold."""
    torch.manual_seed(0)
    mean, deviation = torch.tensor([0.0, 0.0, 1.5, -0.5]).double(), torch.tensor([0.1, 1.0, 0.6, 2.0]).double()
    outputs = torch.cat([mean, deviation.log()])[None, None]
    group = GroupSpec("smooth", 1, 2, 4)
    own = torch.zeros(1, 1, 2)
    after = TransformedDistribution(Independent(Normal(mean, deviation), 1), TanhTransform(cache_size=1))
    samples = after.sample((200_000,))
    wanted = -after.log_prob(samples).mean().item()
    assert evaluate(group, own, outputs, torch.zeros(1, 1, 4)).entropy.item() == pytest.approx(wanted, abs=0.05)
    wide = torch.cat([mean, (4 * deviation).log()])[None, None]
    narrow = torch.cat([torch.zeros(4), torch.full((4,), -0.14)])[None, None]
    assert (
        evaluate(group, own, wide, own[..., :1].expand(1, 1, 4)).entropy
        < evaluate(group, own, narrow, own[..., :1].expand(1, 1, 4)).entropy
    )


@pytest.mark.parametrize("group", [FREE, MASKED, SMOOTH], ids=lambda group: group.name)
def test_gradients_are_those_of_torch(group):
    """Autograd gives the gradients that it gives through torch.distributions, and 0 for illegal options."""
    own, outputs, action = case(group, 3)
    ours, theirs = outputs.clone().requires_grad_(), outputs.clone().requires_grad_()
    found = evaluate(group, own, ours, action)
    (found.log_probability + 0.3 * found.entropy).sum().backward()
    if group.choices:
        parts = legal_parts(group, own, theirs)
        log_probability = sum(part.log_prob(action[..., index]) for index, part in enumerate(parts))
        entropy = sum(part.entropy() for part in parts)
    else:
        normal = Independent(Normal(theirs[..., :2], theirs[..., 2:].clamp(-20.0, 2.0).exp()), 1)
        log_probability, entropy = normal.log_prob(torch.atanh(action)), squashed_entropy(normal.base_dist).sum(-1)
    (log_probability + 0.3 * entropy).sum().backward()
    torch.testing.assert_close(ours.grad, theirs.grad, atol=1e-6, rtol=1e-5)
    if group.masked:
        assert (ours.grad[own[..., -group.options :] < 0.5] == 0.0).all()


@settings(max_examples=60)
@given(seed=st.integers(0, 2**32 - 1), scale=st.floats(0.01, 1.0), shared=st.booleans())
def test_learner_and_workers_agree(seed, scale, shared):
    """For the same actors and actions the learner computes the log-probability that the worker has sent."""
    draw = np.random.default_rng(seed)
    flat = TeamActors.initial(TEAM, 8, 0, head="gaussian").flat
    flat = tuple(
        (scale * draw.standard_normal((1 if shared else len(own), own.shape[1]))).astype(np.float32) for own in flat
    )
    actors = TeamActors(TEAM, 8, flat, "gaussian")
    rows = observations(TEAM, 16, draw)
    action, sent = sampled(actors, rows, draw)
    outputs = [torch.from_numpy(np.ascontiguousarray(part)) for _, _, part in actors.outputs(rows)]
    own, taken = split(TEAM, torch.from_numpy(rows)), split_actions(TEAM, torch.from_numpy(action))
    parts = [
        evaluate(group, *of_type).log_probability
        for group, *of_type in zip(TEAM.groups, own, outputs, taken, strict=True)
    ]
    # An error of artanh in the last bits weighs as much as the policy is narrow and the action far from its mean.
    narrow = np.ones((16, TEAM.agents))
    narrow[:, 5:] = torch.exp(-outputs[2][..., 2:].min(dim=-1).values).numpy().clip(1.0)
    bound = 1e-5 * narrow**2 * (1.0 + np.abs(sent))
    assert (np.abs(torch.cat(parts, dim=1).numpy() - sent) <= bound).all()


def test_an_illegal_option_has_no_probability():
    """An action that the mask forbids has a ratio of 0, and a masked branch with one legal option no entropy."""
    observation = torch.zeros(1, 2, 9)
    observation[..., 4] = observation[..., 5] = 1.0
    action = torch.tensor([[[1.0, 0.0], [1.0, 2.0]]])
    found = evaluate(MASKED, observation, torch.zeros(1, 2, 6), action)
    assert found.entropy.tolist() == [[0.0, 0.0]]
    assert found.log_probability[0, 0] == 0.0
    assert found.log_probability[0, 1] == ILLEGAL
