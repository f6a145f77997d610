"""Adam of several tensors in one operation (Kingma & Ba 2015).

It is the operation that `torch.optim.Adam(fused=True)` calls, so results are bit-equal. That class loads torch's
compiler at its first use: 800 modules, and a second of every start of a learner.
"""

from collections.abc import Iterable
from typing import Final, NamedTuple

import torch
from torch import Tensor

BETA1: Final = 0.9
BETA2: Final = 0.999


class Moments(NamedTuple):
    """What Adam keeps of a tensor.

    Attributes:
        step: count of its steps, float32 [].
        exp_avg: first moments, of the tensor's shape.
        exp_avg_sq: second moments, of the tensor's shape.
    """

    step: Tensor
    exp_avg: Tensor
    exp_avg_sq: Tensor


class Adam:
    """Adam with bias correction for groups of parameters, each with a rate of its own.

    Args:
        groups: for each group its parameters, which are changed in place, and its learning rate.
        epsilon: what is added to the root of the second moments.

    Attributes:
        rates: the learning rate of each group; one may change between two steps.
        moments: of each parameter.
    """

    def __init__(self, groups: Iterable[tuple[Iterable[Tensor], float]], *, epsilon: float) -> None:
        self._epsilon = epsilon
        pairs = [(list(parameters), rate) for parameters, rate in groups]
        self._groups, self.rates = [parameters for parameters, _ in pairs], [rate for _, rate in pairs]
        self.moments = {
            parameter: Moments(
                torch.zeros((), device=parameter.device), torch.zeros_like(parameter), torch.zeros_like(parameter)
            )
            for parameters in self._groups
            for parameter in parameters
        }

    def tensors(self) -> list[Tensor]:
        """Return everything that a step changes."""
        return [tensor for parameter, moments in self.moments.items() for tensor in (parameter, *moments)]

    def zero_grad(self) -> None:
        """Forget all gradients."""
        for parameter in self.moments:
            parameter.grad = None

    @torch.no_grad()
    def step(self, share: float | Tensor = 1.0) -> None:
        """Take one step with each parameter that has a gradient.

        Args:
            share: share of the learning rates; a tensor [] where the step is captured in a CUDA graph.
        """
        adam = torch.ops.aten._fused_adam_
        # Chosen here because torch, while it looks for the fitting one, prints tensors, which ends a capture.
        operation = adam.tensor_lr if isinstance(share, Tensor) else adam.default
        for parameters, rate in zip(self._groups, self.rates, strict=True):
            moving = [parameter for parameter in parameters if parameter.grad is not None]
            if not moving:
                continue
            counts, means, squares = map(list, zip(*(self.moments[parameter] for parameter in moving), strict=True))
            for count in counts:
                count.add_(1.0)
            operation(
                moving,
                [parameter.grad for parameter in moving],
                means,
                squares,
                [],
                counts,
                lr=rate * share,
                beta1=BETA1,
                beta2=BETA2,
                weight_decay=0.0,
                eps=self._epsilon,
                amsgrad=False,
                maximize=False,
            )
