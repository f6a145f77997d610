"""Adam on one flat parameter vector: torch's own, in its fused form that reads and writes each number once."""

import torch
from torch import Tensor


class Adam:
    """Adam with torch's defaults (betas 0.9 and 0.999, epsilon 1e-8, bias correction).

    Args:
        parameters: [P], changed in place.
        gradient: [P], where every step's gradient will stand.
        rate: learning rate.

    Attributes:
        mean: first moments [P].
        square: second moments [P].
    """

    def __init__(self, parameters: Tensor, gradient: Tensor, rate: float) -> None:
        self.mean, self.square = torch.zeros_like(parameters), torch.zeros_like(parameters)
        self._steps = torch.zeros((), dtype=torch.float32, device=parameters.device)
        parameters.grad = gradient
        self._optimiser = torch.optim.Adam([parameters], lr=rate, fused=True)
        self._optimiser.state[parameters] = {"step": self._steps, "exp_avg": self.mean, "exp_avg_sq": self.square}

    @property
    def steps(self) -> int:
        """Steps taken; beyond 2^24 the count stands still, where the bias correction has long been 1."""
        return int(self._steps)

    @steps.setter
    def steps(self, count: int) -> None:
        self._steps.fill_(count)

    def step(self) -> None:
        """Take one step against the gradient."""
        self._optimiser.step()
