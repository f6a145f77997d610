"""The mixing network of QMIX: the team's value of its agents' values, in which none of them counts less than nothing.

    Q = |w2| elu(|W1| q + b1) + b2                       q [agents], W1 [m, agents], b1 and w2 [m], b2 a number

The state decides all of these weights: one perceptron, with two hidden layers as all networks here, has them as its
outputs. Rashid et al. take a network of its own for each; that the weights are of the state alone, and absolute, is
theirs. Two things are ours, because the slope dQ/dq is a product of two weights that both grow with the state:

- The perceptron sees the state normalised (Ba et al., 2016, Layer normalization, without gain and bias), so that its
  numbers' size does not matter.
- It begins with biases that make Q about the sum of the agents' values, as in VDN: sum_m |w2| |W1| = 1 for each agent.
"""

from torch import Tensor
from torch.nn.functional import elu, layer_norm

from eia_sec.common.config import QmixConfig
from eia_sec.common.seeds import stream
from eia_sec.common.team import TeamSpec
from eia_sec.learner.networks.stacks import Shape, Stacks
from eia_sec.learner.off_policy.trained import Trained

LAST_GAIN = 0.1
"""Gain of the perceptron's last layer, so that the weights begin close to their biases, and not all alike."""


class Mixer(Trained):
    """The mixing network and its target.

    Args:
        config: the algorithm's configuration.
        team: the layout of the team.
        seed: seed of the run.
        like: a tensor of the wanted device and type.
        cores: processor cores for the compiled kernels; 0 to compute by torch.
    """

    def __init__(self, config: QmixConfig, team: TeamSpec, seed: int, like: Tensor, *, cores: int) -> None:
        self._width = config.mixing_width
        self._parts = [self._width * team.agents, self._width, self._width, 1]
        networks = Stacks(
            [Shape(1, team.observation_size, sum(self._parts), config.batch)], config.hidden, like, cores=cores
        )
        networks.stacks[0].initialise(0, stream(seed, "mixer"), LAST_GAIN)
        w1, _, w2, _ = networks.stacks[0].layers[-1].split(self._parts, dim=-1)
        for weights in (w1, w2):
            weights.fill_(self._width**-0.5)
        super().__init__(networks, config.critic_rate, config.gradient_clip, target=True)
        self._state = like.new_zeros(1, config.batch, team.observation_size)

    def __call__(self, q: Tensor, state: Tensor) -> Tensor:
        """Return the team's value [1, B] of its agents' values [agents, B] in the states, rows [B, O]."""
        return self._mixed(self.networks, q, state)

    def target_value(self, q: Tensor, state: Tensor) -> Tensor:
        """Return what a call does, by the target network."""
        return self._mixed(self.target, q, state)

    def _mixed(self, networks: Stacks, q: Tensor, state: Tensor) -> Tensor:
        self._state[0].copy_(layer_norm(state, state.shape[1:]))  # the networks read from one place
        weights: Tensor = networks([self._state])
        w1, b1, w2, b2 = weights.view(len(state), -1).split(self._parts, dim=1)
        w1 = w1.view(len(state), self._width, -1).abs()
        hidden = elu((w1 @ q.t()[:, :, None]).squeeze(2) + b1)
        value: Tensor = (w2.abs() * hidden).sum(dim=1, keepdim=True) + b2
        return value.t()
