"""Adam on one flat parameter vector, a few whole-vector operations a step.

`torch.optim.Adam` computes the same; its fused form was measured here and gains nothing at these sizes.
"""

import math

import torch
from torch import Tensor

BETA1 = 0.9
BETA2 = 0.999
EPSILON = 1e-8


class Adam:
    """Adam with bias correction.

    Args:
        parameters: [P], changed in place.
        gradient: [P], where every step's gradient stands.
        rate: learning rate.

    Attributes:
        mean: first moments [P].
        square: second moments [P].
        steps: steps taken.
    """

    def __init__(self, parameters: Tensor, gradient: Tensor, rate: float) -> None:
        self._parameters, self._gradient, self._rate = parameters, gradient, rate
        self.mean, self.square = torch.zeros_like(parameters), torch.zeros_like(parameters)
        self.steps = 0
        self._scratch = torch.empty_like(parameters)

    def step(self) -> None:
        """Take one step against the gradient."""
        self.steps += 1
        self.mean.lerp_(self._gradient, 1.0 - BETA1)
        self.square.mul_(BETA2).addcmul_(self._gradient, self._gradient, value=1.0 - BETA2)
        correction = math.sqrt(1.0 - BETA2**self.steps)
        torch.sqrt(self.square, out=self._scratch).add_(EPSILON * correction)
        scale = self._rate * correction / (1.0 - BETA1**self.steps)
        self._parameters.addcdiv_(self.mean, self._scratch, value=-scale)
