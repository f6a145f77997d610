"""Log-probability and entropy of actions, with gradients; `common.actions.sampling` samples from the same policies."""

import math
from typing import Final, NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

from eia_sec.common.actions.sampling import HALF_LOG_TAU, ILLEGAL, LARGEST_ACTION
from eia_sec.common.actors import LOG_STD_RANGE
from eia_sec.common.team import GroupSpec

_NODES, _WEIGHTS = np.polynomial.hermite_e.hermegauss(9)
QUADRATURE: Final = (_NODES.tolist(), (_WEIGHTS / _WEIGHTS.sum()).tolist())
"""Where a standard normal variable is evaluated, and with which weights, to integrate over it."""


class Evaluated(NamedTuple):
    """A policy's view of actions that were taken.

    Attributes:
        log_probability: log pi(a | o) [B, n].
        entropy: entropy of the policy at o [B, n], nats.
    """

    log_probability: Tensor
    entropy: Tensor


def evaluate(group: GroupSpec, observation: Tensor, outputs: Tensor, action: Tensor) -> Evaluated:
    """Evaluate actions of a type.

    Args:
        group: the type.
        observation: [B, n, o].
        outputs: [B, n, outputs] of its actors.
        action: [B, n, a], as rows hold it.
    """
    if group.choices:
        return _categorical(group, observation, outputs, action)
    return _squashed_gaussian(outputs, action)


def _categorical(group: GroupSpec, observation: Tensor, logits: Tensor, action: Tensor) -> Evaluated:
    if group.masked:
        # `torch.where` would copy ILLEGAL to the device, which ends the capture of a CUDA graph.
        legal = observation[..., -group.options :] > 0.5
        logits = logits.masked_fill(~legal, ILLEGAL)
    log_probability = entropy = logits.new_zeros(logits.shape[:-1])
    for index, part in enumerate(torch.split(logits, list(group.choices), dim=-1)):
        # Along the first axis torch works on many samples at once, along a short last one on one after another.
        log_share = torch.log_softmax(part.flatten(0, -2).t().contiguous(), dim=0)
        taken = action[..., index].long().reshape(1, -1)
        log_probability = log_probability + log_share.gather(0, taken).view_as(log_probability)
        entropy = entropy - (log_share.exp() * log_share).sum(dim=0).view_as(entropy)
    return Evaluated(log_probability, entropy)


def _squashed_gaussian(outputs: Tensor, action: Tensor) -> Evaluated:
    size = action.shape[-1]
    mean, log_std = outputs[..., :size], outputs[..., size:].clamp(*LOG_STD_RANGE)
    score = (torch.atanh(action.clamp(-LARGEST_ACTION, LARGEST_ACTION)) - mean) * torch.exp(-log_std)
    log_probability = (-0.5 * score.square() - log_std - HALF_LOG_TAU).sum(dim=-1)
    # H(tanh u) = H(u) + E[ln(1 - tanh(u)^2)], by Gauss-Hermite quadrature over u. Without the second part entropy could
    # grow for ever by widening a Gaussian whose samples the tanh already pushes to the ends.
    nodes, weights = (outputs.new_tensor(part) for part in QUADRATURE)
    u = mean[..., None] + torch.exp(log_std)[..., None] * nodes
    slope = 2.0 * (math.log(2.0) - u - nn.functional.softplus(-2.0 * u))
    entropy = log_std + 0.5 + HALF_LOG_TAU + (slope * weights).sum(dim=-1)
    return Evaluated(log_probability, entropy.sum(dim=-1))
