"""The engine of off-policy algorithms: a batch in, one update of all agents, actors out.

The engine holds what algorithms share: the noise of an update, the update count, and on an
accelerator the captured graphs. The algorithm (`eia_sec.learner.registry`) defines what an update computes.
"""

from typing import Final

import numba
import numpy as np
import torch
from torch import Tensor

from eia_sec.common.actors import TeamActors
from eia_sec.common.config import OffPolicyConfig
from eia_sec.common.seeds import stream
from eia_sec.common.team import TeamSpec
from eia_sec.learner.networks.compiled import usable_cores
from eia_sec.learner.off_policy.algorithm import Batch, Diagnostics
from eia_sec.learner.off_policy.captured_updates import CapturedUpdates
from eia_sec.learner.registry import off_policy

__all__ = ["Batch", "Diagnostics", "Engine"]

NOISE: Final = "round noise"
"""Name of the random stream that updates draw from; renaming it would change every run."""


class Engine:
    """All networks of a run, and their updates.

    Args:
        config: the algorithm's configuration.
        team: the layout of the team.
        seed: seed of the run; every initialisation follows from it.
        device: torch device.
        dtype: dtype of all arithmetic.
        cores: processor cores for the compiled kernels; 0 to compute with torch. The default is torch's thread count on
            a CPU, limited to numba's, and 0 elsewhere.

    Attributes:
        cores: processor cores that compiled kernels use; 0 if torch computes.
        algorithm: the algorithm with its networks.
        updates: updates done, int64 [].
        random: the generator of the updates' noise; checkpoints include its state.
    """

    def __init__(
        self,
        config: OffPolicyConfig,
        team: TeamSpec,
        seed: int,
        device: str = "cpu",
        dtype: torch.dtype = torch.float32,
        *,
        cores: int | None = None,
    ) -> None:
        self.config, self.team = config, team
        like = torch.empty(0, device=device, dtype=dtype)
        if cores is None:
            cores = usable_cores(torch.get_num_threads()) if like.device.type == "cpu" else 0
        self.cores = cores
        self.algorithm = off_policy(config.name)(config, team, seed, like, cores=cores)
        self.updates = torch.zeros((), dtype=torch.int64)
        self.random = stream(seed, NOISE)
        self._noise = like.new_zeros(self.algorithm.noise_blocks, config.batch * team.action_size)
        self._graphs = CapturedUpdates(self.algorithm) if like.device.type == "cuda" else None

    def update(self, batch: Batch, *, diagnostics: bool = False) -> Diagnostics | None:
        """Do one update; return its diagnostics if requested, valid until the next update."""
        if self.algorithm.noise_blocks:
            drawn = self.random.standard_normal(self._noise.shape, np.float32)
            self._noise.copy_(torch.from_numpy(drawn))
        if self.cores > 1:
            numba.set_num_threads(usable_cores(self.cores))  # numba keeps this setting per calling thread
        self.updates.add_(1)
        actor_step = int(self.updates) % self.algorithm.actor_period(self.config) == 0
        updater = self.algorithm if self._graphs is None else self._graphs
        return updater.update(batch, self._noise, actor_step=actor_step, diagnostics=diagnostics)

    def retune(self, config: OffPolicyConfig) -> None:
        """Go on with other values of the options that are `live`."""
        self.config = config
        self.algorithm.retune(config)
        if self._graphs is not None:  # they hold the rates
            self._graphs = CapturedUpdates(self.algorithm)

    def actors(self) -> TeamActors:
        """Return a copy of all actors."""
        return TeamActors(self.team, self.config.hidden, self.algorithm.actors.export(), self.algorithm.head)

    def tensors(self) -> dict[str, Tensor]:
        """Return the whole state except `random`, by name."""
        return {**self.algorithm.tensors(), "updates": self.updates}
