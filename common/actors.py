"""The actors' parameters and their forward pass, the same for learner, workers and whoever flies a UAV.

The policy pi_v-i(theta_v-i) is a perceptron with two hidden ReLU layers and a tanh output. Its parameters are one
flat vector theta in this order, each matrix stored input-major:

    W1 [o, h], b1 [h], W2 [h, h], b2 [h], W3 [h, a], b3 [a]

and the agents of a type are the rows of one [n_v, P] array, so that imitation is a blend of two rows.
"""

import hashlib
from dataclasses import dataclass

import numpy as np

from common.errors import SchemaError
from common.seeds import stream
from common.team import Float32, GroupSpec, TeamSpec


def layer_shapes(inputs: int, hidden: int, outputs: int) -> list[tuple[int, ...]]:
    """Return the shapes of W1, b1, W2, b2, W3, b3."""
    return [(inputs, hidden), (hidden,), (hidden, hidden), (hidden,), (hidden, outputs), (outputs,)]


def parameter_count(inputs: int, hidden: int, outputs: int) -> int:
    """Return P, the length of one network's flat parameter vector."""
    return sum(int(np.prod(shape)) for shape in layer_shapes(inputs, hidden, outputs))


def parameter_views(flat: Float32, inputs: int, hidden: int, outputs: int) -> list[Float32]:
    """Return views [n, *shape] of W1, b1, W2, b2, W3, b3 into stacked flat parameters [n, P]."""
    views, start = [], 0
    for shape in layer_shapes(inputs, hidden, outputs):
        size = int(np.prod(shape))
        views.append(flat[:, start : start + size].reshape(flat.shape[0], *shape))
        start += size
    return views


def initial_parameters(inputs: int, hidden: int, outputs: int, generator: np.random.Generator) -> Float32:
    """Return one network's flat parameters [P]: uniform in +-1/sqrt(fan-in), the last layer a tenth of that."""
    parts = []
    for index, (rows, columns) in enumerate(((inputs, hidden), (hidden, hidden), (hidden, outputs))):
        bound = (0.1 if index == 2 else 1.0) / np.sqrt(rows)
        parts.append(generator.uniform(-bound, bound, rows * columns))
        parts.append(generator.uniform(-bound, bound, columns))
    return np.concatenate(parts).astype(np.float32)


def imitate(parameters: Float32, elite: int, rate: float) -> None:
    """Blend every row towards the elite's in place: theta_i = (1 - vartheta) theta_i + vartheta theta_i', eq. (soft).

    Learner and workers both call this function on float32 arrays, which is what makes their copies bit-equal.

    Args:
        parameters: [n_v, P] float32, contiguous.
        elite: row of the elite; it stays as it is.
        rate: vartheta in 0..1.
    """
    keep = np.float32(1.0 - rate)
    step = np.float32(rate)
    target = parameters[elite].copy()
    for index in range(parameters.shape[0]):
        if index != elite:
            parameters[index] = keep * parameters[index] + step * target


@dataclass(frozen=True)
class ActorBank:
    """All actors of a team.

    Attributes:
        team: the layout.
        hidden: width of the hidden layers.
        flat: for each type, [n_v, P_v] float32, C-contiguous.
    """

    team: TeamSpec
    hidden: int
    flat: tuple[Float32, ...]

    def __post_init__(self) -> None:
        """Raise SchemaError unless every array has the team's shape and is finite."""
        if len(self.flat) != len(self.team.groups):
            raise SchemaError(f"actors for {len(self.flat)} types given, the team has {len(self.team.groups)}.")
        for group, flat in zip(self.team.groups, self.flat, strict=True):
            shape = (group.count, parameter_count(group.observation_size, self.hidden, group.action_size))
            if flat.shape != shape or flat.dtype != np.float32 or not flat.flags.c_contiguous:
                raise SchemaError(f"{group.name} actors are {flat.dtype}{list(flat.shape)}, not float32{list(shape)}.")
            if not np.isfinite(flat).all():
                raise SchemaError(f"{group.name} actors hold a number that is not finite.")

    @classmethod
    def initial(cls, team: TeamSpec, hidden: int, seed: int, *, per_type: bool = True) -> "ActorBank":
        """Return fresh actors: one initialisation for each type, or for each agent (A4)."""

        def rows(group: GroupSpec) -> Float32:
            names = [0 if per_type else index for index in range(group.count)]
            draw = [
                initial_parameters(
                    group.observation_size, hidden, group.action_size, stream(seed, "actor", group.name, name)
                )
                for name in names
            ]
            return np.ascontiguousarray(np.stack(draw))

        return cls(team, hidden, tuple(rows(group) for group in team.groups))

    def copy(self) -> "ActorBank":
        """Return a bank whose arrays are its own."""
        return ActorBank(self.team, self.hidden, tuple(flat.copy() for flat in self.flat))

    def act(self, observations: Float32) -> Float32:
        """Return the noise-free actions of all agents.

        Args:
            observations: rows [E, O] float32.

        Returns:
            rows [E, A] float32 in [-1, 1].
        """
        parts = []
        for group, flat, rows in zip(
            self.team.groups, self.flat, self.team.split_observations(observations), strict=True
        ):
            w1, b1, w2, b2, w3, b3 = parameter_views(flat, group.observation_size, self.hidden, group.action_size)
            x = np.ascontiguousarray(rows.transpose(1, 0, 2))
            h = np.maximum(np.matmul(x, w1) + b1[:, None], np.float32(0))
            h = np.maximum(np.matmul(h, w2) + b2[:, None], np.float32(0))
            a = np.tanh(np.matmul(h, w3) + b3[:, None])
            parts.append(a.transpose(1, 0, 2).reshape(observations.shape[0], -1))
        return np.concatenate(parts, axis=1)

    def digest(self) -> str:
        """Return the SHA-256 of all parameters, in hexadecimal."""
        state = hashlib.sha256()
        for flat in self.flat:
            state.update(np.ascontiguousarray(flat).tobytes())
        return state.hexdigest()
