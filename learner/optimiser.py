"""Adam and the soft target update on flat parameter vectors, a few whole-buffer operations each."""

import math

import torch
from torch import Tensor

BETA1 = 0.9
BETA2 = 0.999
EPSILON = 1e-8


class Adam:
    """Adam with bias correction on one flat vector, as `torch.optim.Adam` computes it.

    Attributes:
        mean: first moments [P].
        square: second moments [P].
        steps: steps taken.
    """

    def __init__(self, parameters: Tensor, rate: float) -> None:
        self._parameters, self._rate = parameters, rate
        self.mean = torch.zeros_like(parameters)
        self.square = torch.zeros_like(parameters)
        self.steps = 0
        self._scratch = torch.empty_like(parameters)

    def step(self, gradient: Tensor) -> None:
        """Take one step against the gradient [P]."""
        self.steps += 1
        self.mean.lerp_(gradient, 1.0 - BETA1)
        self.square.mul_(BETA2).addcmul_(gradient, gradient, value=1.0 - BETA2)
        correction = math.sqrt(1.0 - BETA2**self.steps)
        torch.sqrt(self.square, out=self._scratch).add_(EPSILON * correction)
        scale = self._rate * correction / (1.0 - BETA1**self.steps)
        self._parameters.addcdiv_(self.mean, self._scratch, value=-scale)
