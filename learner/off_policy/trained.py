"""Networks that an algorithm trains: parameters, optimiser and, where wanted, target networks."""

from torch import Tensor

from eia_sec.learner.networks.adam import Adam
from eia_sec.learner.networks.stacks import Stacks

ADAM_EPSILON = 1e-8


class Trained:
    """All networks of one role, with what trains them.

    Args:
        networks: the networks.
        rate: learning rate.
        clip: largest norm of a network's gradient; 0 for any.
        target: whether there are target networks; they begin as the networks do.

    Attributes:
        networks: the networks.
        target: those that follow them; they are the networks themselves where there are no others.
        norms: norm of each network's newest gradient before any clip, as `step` was asked to note it.
    """

    def __init__(self, networks: Stacks, rate: float, clip: float, *, target: bool) -> None:
        self.networks, self._clip = networks, clip
        self.target = networks.twin() if target else networks
        self._adam = Adam([(networks.parameters(), rate)], epsilon=ADAM_EPSILON)
        self.norms = networks.flat.new_zeros(sum(shape.count for shape in networks.shapes))

    def set_rate(self, rate: float) -> None:
        """Change the learning rate; the optimiser's moments stay."""
        self._adam.rates[0] = rate

    def zero_grad(self) -> None:
        """Forget all gradients."""
        self._adam.zero_grad()

    def step(self, *, norms: bool) -> None:
        """Take one Adam step along the gradient that `backward` left.

        Args:
            norms: whether to note the norm of each network's gradient.
        """
        if norms or self._clip:
            self.norms = self.networks.clip(self._clip)
        self._adam.step()

    def follow(self, rate: float) -> None:
        """Move the target networks towards the networks, phi' <- rate phi + (1 - rate) phi'."""
        if self.target is not self.networks:
            self.target.follow(self.networks, rate)

    def tensors(self, name: str) -> dict[str, Tensor]:
        """Return the whole state by names that begin with `name`, tensors that are changed in place."""
        found = {f"{name}.parameters": self.networks.flat.detach()}
        if self.target is not self.networks:
            found[f"{name}.target"] = self.target.flat.detach()
        moments = self._adam.moments[self.networks.flat]._asdict()
        return found | {f"{name}.{moment}": tensor for moment, tensor in moments.items()}
