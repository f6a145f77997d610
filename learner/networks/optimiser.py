"""Adam on one flat parameter vector: one sweep on processor cores, a few whole-vector operations on other devices.

`torch.optim.Adam` computes the same. The count of steps is a tensor, so that a step can be captured in a graph.
"""

import math
from typing import Final

import numpy as np
import torch
from torch import Tensor

from eia_sec.learner.networks import kernels
from eia_sec.learner.networks.compiled_pass import even

BETA1: Final = 0.9
BETA2: Final = 0.999
EPSILON: Final = 1e-8


class Adam:
    """Adam with bias correction.

    Args:
        parameters: [P], changed in place.
        rate: learning rate.
        cores: processor cores for the compiled sweep; 0 to step by torch.
        clip: largest norm of one network's gradient; 0 for no limit.
        networks: [P] int64, the network that each parameter belongs to; required if `clip` is above 0.

    Attributes:
        mean: first moments [P].
        square: second moments [P].
        steps: steps taken, int64 [].
        norms: norm of each network's gradient in the newest step [networks], before the clip; None without a clip.
    """

    norms: Tensor | None = None

    def __init__(
        self,
        parameters: Tensor,
        rate: float,
        *,
        cores: int = 0,
        clip: float = 0.0,
        networks: Tensor | None = None,
    ) -> None:
        self._parameters, self._rate = parameters, rate
        self._cores, self._clip = cores, clip
        self.mean, self.square = torch.zeros_like(parameters), torch.zeros_like(parameters)
        self.steps = torch.zeros((), dtype=torch.int64, device=parameters.device)
        self._scratch = torch.empty_like(parameters)
        if clip > 0.0 and networks is not None:
            self._networks = networks[: parameters.shape[0]].to(parameters.device)
            self.norms = parameters.new_zeros(int(networks.max()) + 1)
        if cores:
            self._bounds = even(parameters.shape[0], cores)
            self._arrays = (parameters.numpy(), self.mean.numpy(), self.square.numpy())

    def step(self, gradient: Tensor, target: Tensor | None = None, target_rate: float = 0.0) -> None:
        """Take one step down a gradient, and move the target network, if any, in the same sweep.

        Args:
            gradient: [P]; clipped in place if there is a clip.
            target: [P], target <- target_rate p + (1 - target_rate) target.
            target_rate: see `target`.
        """
        if self.norms is not None:
            self._clip_norms(gradient, self.norms)
        self.steps.add_(1)
        if self._cores:
            self._sweep(gradient, target, target_rate)
            return
        self.mean.lerp_(gradient, 1.0 - BETA1)
        self.square.mul_(BETA2).addcmul_(gradient, gradient, value=1.0 - BETA2)
        steps = self.steps.double()
        correction = torch.sqrt(1.0 - BETA2**steps)
        torch.sqrt(self.square, out=self._scratch).add_(EPSILON * correction)
        scale = self._rate * correction / (1.0 - BETA1**steps)
        self._parameters.sub_(torch.div(self.mean, self._scratch, out=self._scratch).mul_(scale))
        if target is not None:
            target.lerp_(self._parameters, target_rate)

    def _sweep(self, gradient: Tensor, target: Tensor | None, target_rate: float) -> None:
        steps = int(self.steps)
        correction = math.sqrt(1.0 - BETA2**steps)
        scale = self._rate * correction / (1.0 - BETA1**steps)
        settings = np.array(
            [1.0 - BETA1, BETA2, 1.0 - BETA2, scale, EPSILON * correction, target_rate], self._arrays[0].dtype
        )
        following = self._arrays[0][:0] if target is None else target.numpy()
        values, mean, square = self._arrays
        if self._cores > 1:
            kernels.adam_on_cores(self._bounds, values, gradient.numpy(), mean, square, settings, following)
        else:
            kernels.adam(values, gradient.numpy(), mean, square, settings, following)

    def _clip_norms(self, gradient: Tensor, norms: Tensor) -> None:
        """Scale every network's gradient to at most the clip; write the norms before scaling."""
        squares = torch.mul(gradient, gradient, out=self._scratch)
        norms.zero_().index_add_(0, self._networks, squares).sqrt_()
        factors = self._clip / torch.clamp_min(norms, self._clip)
        gradient.mul_(factors.index_select(0, self._networks))
