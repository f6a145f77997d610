"""Adam on one flat parameter vector, in one sweep on a processor core and a few whole-vector operations elsewhere.

`torch.optim.Adam` computes the same. The count of steps is a tensor, so that a step can be part of a captured graph.
"""

import math
from typing import Final

import numpy as np
import torch
from torch import Tensor

from learner.networks import kernels
from learner.networks.compiled_pass import even

BETA1: Final = 0.9
BETA2: Final = 0.999
EPSILON: Final = 1e-8


class Adam:
    """Adam with bias correction.

    Args:
        parameters: [P], changed in place.
        gradient: [P], where every step's gradient stands.
        rate: learning rate.
        cores: processor cores for the compiled sweep; 0 to step by torch.
        clip: largest norm of one network's gradient; 0 for any.
        networks: [P] int64, the network that each parameter belongs to; wanted where `clip` is above 0.

    Attributes:
        mean: first moments [P].
        square: second moments [P].
        steps: steps taken, int64 [].
        norms: norm of each network's gradient in the newest step [networks], before the clip; None without a clip,
            where the gradient stands as it was.
    """

    norms: Tensor | None = None

    def __init__(
        self,
        parameters: Tensor,
        gradient: Tensor,
        rate: float,
        *,
        cores: int = 0,
        clip: float = 0.0,
        networks: Tensor | None = None,
    ) -> None:
        self._parameters, self._gradient, self._rate = parameters, gradient, rate
        self._cores, self._clip = cores, clip
        self.mean, self.square = torch.zeros_like(parameters), torch.zeros_like(parameters)
        self.steps = torch.zeros((), dtype=torch.int64, device=parameters.device)
        self._scratch = torch.empty_like(parameters)
        if clip > 0.0 and networks is not None:
            self._networks = networks[: parameters.shape[0]].to(parameters.device)
            self.norms = parameters.new_zeros(int(networks.max()) + 1)
        if cores:
            self._bounds = even(parameters.shape[0], cores)
            self._arrays = (parameters.numpy(), gradient.numpy(), self.mean.numpy(), self.square.numpy())

    def step(self, target: Tensor | None = None, follow: float = 0.0) -> None:
        """Take one step against the gradient; a target then follows by target <- follow p + (1 - follow) target."""
        if self.norms is not None:
            self._shorten(self.norms)
        self.steps.add_(1)
        if self._cores:
            self._sweep(target, follow)
            return
        self.mean.lerp_(self._gradient, 1.0 - BETA1)
        self.square.mul_(BETA2).addcmul_(self._gradient, self._gradient, value=1.0 - BETA2)
        steps = self.steps.double()
        correction = torch.sqrt(1.0 - BETA2**steps)
        torch.sqrt(self.square, out=self._scratch).add_(EPSILON * correction)
        scale = self._rate * correction / (1.0 - BETA1**steps)
        self._parameters.sub_(torch.div(self.mean, self._scratch, out=self._scratch).mul_(scale))
        if target is not None:
            target.lerp_(self._parameters, follow)

    def _sweep(self, target: Tensor | None, follow: float) -> None:
        steps = int(self.steps)
        correction = math.sqrt(1.0 - BETA2**steps)
        scale = self._rate * correction / (1.0 - BETA1**steps)
        settings = np.array(
            [1.0 - BETA1, BETA2, 1.0 - BETA2, scale, EPSILON * correction, follow], self._arrays[0].dtype
        )
        following = self._arrays[0][:0] if target is None else target.numpy()
        values, slopes, mean, square = self._arrays
        if self._cores > 1:
            kernels.adam_on_cores(self._bounds, values, slopes, mean, square, settings, following)
        else:
            kernels.adam(values, slopes, mean, square, settings, following)

    def _shorten(self, norms: Tensor) -> None:
        """Scale every network's gradient whose norm is above the clip down to it; write the norms from before."""
        squares = torch.mul(self._gradient, self._gradient, out=self._scratch)
        norms.zero_().index_add_(0, self._networks, squares).sqrt_()
        factors = self._clip / torch.clamp_min(norms, self._clip)
        self._gradient.mul_(factors.index_select(0, self._networks))
