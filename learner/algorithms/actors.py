"""The actors of all agents on the learner's side: parameters, optimiser, and what they decide for a batch.

A deterministic head gives the action's inverse hyperbolic tangent; a Gaussian head gives its mean and, behind it, the
logarithm of its standard deviation (see `common.actors`).
"""

from collections.abc import Sequence

import torch
from torch import Tensor

from common.actors import Head, TeamActors
from common.config import AlgorithmConfig
from common.team import Float32, TeamSpec
from learner.networks.compiled_pass import make_pass
from learner.networks.optimiser import Adam
from learner.networks.stacked import Networks, Stack


class Actors:
    """All actors and, where wanted, target actors.

    Args:
        config: the algorithm's configuration.
        team: the layout of the team.
        like: a tensor of the wanted device and type.
        head: kind of the last layer.
        target: whether there are target actors.
        cores: processor cores to compute on by compiled kernels; 0 to compute by torch.

    Attributes:
        flat: parameters of all actors [P].
        target: those of the target actors, or None.
    """

    def __init__(
        self, config: AlgorithmConfig, team: TeamSpec, like: Tensor, *, head: Head, target: bool, cores: int
    ) -> None:
        self._config, self._team, self.head = config, team, head
        outputs = 2 if head == "gaussian" else 1
        stacks = [Stack(g.count, g.observation_size, outputs * g.action_size, config.batch) for g in team.groups]
        self.networks = Networks(stacks, config.hidden)
        self.flat = like.new_zeros(self.networks.size)
        self.target = like.new_zeros(self.networks.size) if target else None
        self.gradient = like.new_zeros(self.networks.size)
        self._pass = make_pass(self.networks, like, cores=cores)
        self._parameters, self._into = self.networks.parameters(self.flat), self.networks.parameters(self.gradient)
        self._deciding = self._parameters if self.target is None else self.networks.parameters(self.target)
        self.adam = Adam(
            self.flat,
            self.gradient,
            config.actor_rate,
            cores=cores,
            clip=config.gradient_clip,
            networks=self.networks.segments(),
        )

    def initialise(self, seed: int) -> None:
        """Draw all parameters, those of a type alike or each its own (A4)."""
        alike = self._config.initialisation == "type"
        self.load(TeamActors.initial(self._team, self._config.hidden, seed, per_type=alike, head=self.head).flat)
        if self.target is not None:
            self.target.copy_(self.flat)

    def load(self, flat: Sequence[Float32]) -> None:
        """Replace the actors' parameters, [n_v, P_v] for each type in the order of `common.actors`."""
        for kind, parameters in enumerate(flat):
            self.networks.load(self.flat, kind, torch.from_numpy(parameters))

    def export(self) -> tuple[Float32, ...]:
        """Return a copy of the actors' parameters, [n_v, P_v] for each type in the order of `common.actors`."""
        kinds = range(len(self._team.groups))
        return tuple(self.networks.export(self.flat, kind).float().contiguous().cpu().numpy() for kind in kinds)

    def forward(self, inputs: list[Tensor], *, next_action: bool = False) -> Tensor:
        """Return the heads' outputs, flat, before any tanh; by the target actors, if any, for the next action."""
        return self._pass.forward(self._deciding if next_action else self._parameters, inputs)

    def descend(self, inputs: list[Tensor], upstream: Tensor) -> None:
        """Take one Adam step against the gradient of sum(upstream * output) of the last forward pass."""
        self._pass.parameter_gradient(self._parameters, inputs, upstream, self._into)
        self.adam.step(self.target, self._config.target_rate)

    def norms(self) -> Tensor:
        """Return the norm of each actor's newest gradient [agents], before any clip."""
        return self.networks.norms(self.gradient) if self.adam.norms is None else self.adam.norms

    def tensors(self) -> dict[str, Tensor]:
        """Return the whole state by name."""
        found = {"actors": self.flat, "actor_mean": self.adam.mean, "actor_square": self.adam.square}
        found["actor_steps"] = self.adam.steps
        return found if self.target is None else {**found, "target_actors": self.target}
