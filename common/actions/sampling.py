"""How stochastic actors act: actions sampled from their outputs, and the logarithms of their probabilities.

With logits l of a branch, option k has the probability p_k = exp(l_k) / sum_j exp(l_j) over the legal options, and
option k is sampled where u falls into the k-th interval of the cumulated probabilities, u uniform over [0, 1). An
action of several branches has the product of their probabilities.

A Gaussian head samples a = tanh(m + s n) with standard normal n. Its log-probability is that of x = artanh(a) under
N(m, s^2), without the term of the tanh: that term depends on the action only, and cancels in every ratio of two
policies. x is computed from the stored a, as learners do, so that both sides agree.

`eia_sec.learner.on_policy.distributions` computes the same numbers with gradients.
"""

import math
from collections.abc import Iterator
from typing import Final

import numpy as np

from eia_sec.common.team import Float32, GroupSpec

LARGEST_ACTION: Final = 1.0 - 1e-6
"""Largest magnitude of a squashed action whose artanh is computed; it is about 7."""
ILLEGAL: Final = -1e9
"""Logit of an option that the mask forbids."""
HALF_LOG_TAU: Final = 0.5 * math.log(2.0 * math.pi)


def branches(group: GroupSpec, observation: Float32, logits: Float32) -> Iterator[Float32]:
    """Yield the logits [..., options] of each branch; those of illegal options are ILLEGAL.

    Args:
        group: a type with discrete actions.
        observation: [..., o_v], whose last numbers are the mask where the type is masked.
        logits: [..., group.options].
    """
    if group.masked:
        logits = np.where(observation[..., -group.options :] > 0.5, logits, np.float32(ILLEGAL))
    start = 0
    for options in group.choices:
        yield logits[..., start : start + options]
        start += options


def best_options(group: GroupSpec, observation: Float32, logits: Float32) -> Float32:
    """Return the index of the legal option with the largest logit in each branch, [..., a_v] float32."""
    found = [part.argmax(axis=-1) for part in branches(group, observation, logits)]
    return np.stack(found, axis=-1).astype(np.float32)


def sample_options(
    group: GroupSpec, observation: Float32, logits: Float32, uniform: Float32
) -> tuple[Float32, Float32]:
    """Sample an option of each branch.

    Args:
        group: a type with discrete actions.
        observation: [..., o_v].
        logits: [..., group.options].
        uniform: [..., a_v] uniform over [0, 1).

    Returns:
        indices [..., a_v] float32, and the log-probability of the whole action [...] float32.
    """
    chosen, log_probability = [], np.zeros(logits.shape[:-1], np.float32)
    for index, part in enumerate(branches(group, observation, logits)):
        weight = np.exp(part - part.max(axis=-1, keepdims=True))
        cumulated = np.cumsum(weight, axis=-1)
        total = cumulated[..., -1]
        # An option of zero weight is never chosen: the threshold is met first by an option that adds to the sum.
        option = np.count_nonzero(cumulated <= (uniform[..., index] * total)[..., None], axis=-1)
        if option.max(initial=0) == part.shape[-1]:
            option = np.minimum(option, last_possible(weight))
        flat = np.arange(0, weight.size, part.shape[-1]).reshape(option.shape) + option
        log_probability += np.log(weight.reshape(-1)[flat] / total)
        chosen.append(option)
    return np.stack(chosen, axis=-1).astype(np.float32), log_probability


def epsilon_greedy(
    group: GroupSpec, observation: Float32, values: Float32, uniform: Float32, epsilon: float
) -> Float32:
    """Choose the best legal option of each branch, or with probability epsilon any legal one.

    Args:
        group: a type with discrete actions.
        observation: [..., o_v].
        values: [..., group.options] the options' values.
        uniform: [..., a_v] uniform over [0, 1). Below epsilon it stands for chance, and says which option.
        epsilon: 0..1.

    Returns:
        indices [..., a_v] float32.
    """
    best = best_options(group, observation, values)
    if epsilon <= 0.0:
        return best
    drawn, _ = sample_options(group, observation, np.zeros_like(values), uniform / np.float32(epsilon))
    chosen: Float32 = np.where(uniform < np.float32(epsilon), drawn, best)
    return chosen


def last_possible(weight: Float32) -> "np.ndarray[tuple[int, ...], np.dtype[np.intp]]":
    """Return the last option with a positive weight; rounding may put a threshold behind it."""
    found: np.ndarray[tuple[int, ...], np.dtype[np.intp]]
    found = weight.shape[-1] - 1 - np.argmax(weight[..., ::-1] > 0.0, axis=-1)
    return found


def sample_squashed(mean: Float32, log_std: Float32, noise: Float32) -> tuple[Float32, Float32]:
    """Sample squashed Gaussian actions.

    Args:
        mean: m [..., a_v].
        log_std: log s [..., a_v], clipped to its range.
        noise: [..., a_v] standard normal.

    Returns:
        actions [..., a_v] float32 in [-1, 1], and the log-probability of each whole action [...] float32.
    """
    action = np.clip(np.tanh(mean + np.exp(log_std) * noise), -LARGEST_ACTION, LARGEST_ACTION).astype(np.float32)
    score = (np.arctanh(action) - mean) * np.exp(-log_std)
    log_probability: Float32 = (-0.5 * score * score - log_std - np.float32(HALF_LOG_TAU)).sum(axis=-1)
    return action, log_probability.astype(np.float32)
