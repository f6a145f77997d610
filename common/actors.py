"""The actors' parameters and forward pass, shared by the learner, workers and flight nodes.

The policy pi_v-i(theta_v-i) is a perceptron with two hidden ReLU layers and a tanh output. Its parameters are one
flat vector theta in this order, each matrix stored input-major:

    W1 [o, h], b1 [h], W2 [h, h], b2 [h], W3 [h, a], b3 [a]

The agents of a type are the rows of one [n_v, P] array, so imitation blends two rows. A type whose agents share their
parameters has one row, [1, P]; it then serves any number of agents.

An actor with memory has a gated recurrent unit (`eia_sec.common.gru`) in place of the second hidden layer, W2 and b2.
Its order is W1, b1, W, b, U, c, W3, b3. Whoever lets it decide keeps its state: zeros at the start of an episode, and
updated in place by every decision.

A Gaussian head has 2 a outputs: the mean m, then log s, clipped to LOG_STD_RANGE. Its noise-free action is tanh(m), and
a sample is tanh(m + s n) with standard normal n. Without noise, both heads compute the same function.

A type with discrete actions has one output for each option of each branch, whatever the team's head is: with a
Gaussian head its logit, else its value. Its noise-free action is the legal option with the largest output.
`eia_sec.common.actions.sampling` samples by logits, and explores by values.

Networks of a plug-in (`eia_sec.common.modules`) stand in place of perceptrons; their parameters are rows of the same
arrays, their outputs mean the same.
"""

import hashlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final, Literal, get_args

import numpy as np

from eia_sec.common.actions.sampling import best_options, epsilon_greedy, sample_options, sample_squashed
from eia_sec.common.config.algorithms.network import NetworkConfig
from eia_sec.common.errors import SchemaError
from eia_sec.common.gru import Memory, next_state, unit_shapes
from eia_sec.common.seeds import stream
from eia_sec.common.team import Float32, GroupSpec, TeamSpec

Head = Literal["deterministic", "gaussian"]
HEADS: Final[tuple[Head, ...]] = get_args(Head)
LOG_STD_RANGE: Final = (-20.0, 2.0)
"""Range of the logarithm of a Gaussian head's standard deviation."""


def head_outputs(action_size: int, head: Head) -> int:
    """Return the number of outputs of an actor's last layer."""
    return 2 * action_size if head == "gaussian" else action_size


def actor_outputs(group: GroupSpec, head: Head) -> int:
    """Return the number of outputs of the last layer of a type's actors; with discrete actions one for each option."""
    return group.options or head_outputs(group.action_size, head)


def actor_parameters(
    group: GroupSpec, hidden: int, head: Head, memory: Memory = "none", module: NetworkConfig | None = None
) -> int:
    """Return P, the length of the flat parameters of one of a type's actors.

    Args:
        group: the type.
        hidden: width of a perceptron's hidden layers.
        head: kind of the last layer.
        memory: kind of a perceptron's memory.
        module: options of a plug-in's network; None for perceptrons.

    Raises:
        PluginError: the plug-in's network cannot be used.
    """
    outputs = actor_outputs(group, head)
    if module is None:
        return parameter_count(group.observation_size, hidden, outputs, memory)
    from eia_sec.common.modules import flat_size  # noqa: PLC0415  (loads torch, which perceptrons here do without)

    return flat_size(module, group.seen, outputs)


def can_fly(own: GroupSpec, other: GroupSpec, flat: Float32) -> bool:
    """Return whether the actors of a type [n_v or 1, P] can fly another team's type; adapters' numbers may differ."""
    return (own.observation_size, own.image) == (other.observation_size, other.image) and acts_alike(own, other, flat)


def acts_alike(own: GroupSpec, other: GroupSpec, flat: Float32) -> bool:
    """Return whether the actors of a type [n_v or 1, P] could fly another team's type if it observed the same."""
    return (own.count == other.count or len(flat) == 1) and _actions(own) == _actions(other)


def _actions(group: GroupSpec) -> tuple[object, ...]:
    """Return what two groups must have in common to act alike."""
    kinds = tuple(adapter.kind for adapter in group.adapters)
    return group.name, group.action_size, group.choices, group.masked, kinds


def checked_head(name: str) -> Head:
    """Return the actor head of this name; raise SchemaError when there is none."""
    for head in HEADS:
        if name == head:
            return head
    raise SchemaError(f"there is no actor head {name[:40]!r}.")


def layer_shapes(inputs: int, hidden: int, outputs: int, memory: Memory = "none") -> list[tuple[int, ...]]:
    """Return the shapes of W1, b1, W2, b2, W3, b3; with memory the unit's four stand in place of W2 and b2."""
    middle = [(hidden, hidden), (hidden,)] if memory == "none" else unit_shapes(hidden)
    return [(inputs, hidden), (hidden,), *middle, (hidden, outputs), (outputs,)]


def parameter_count(inputs: int, hidden: int, outputs: int, memory: Memory = "none") -> int:
    """Return P, the length of one network's flat parameter vector."""
    return sum(int(np.prod(shape)) for shape in layer_shapes(inputs, hidden, outputs, memory))


def parameter_views(flat: Float32, inputs: int, hidden: int, outputs: int, memory: Memory = "none") -> list[Float32]:
    """Return views [n, *shape] of W1, b1, ..., W3, b3 into stacked flat parameters [n, P]."""
    views, start = [], 0
    for shape in layer_shapes(inputs, hidden, outputs, memory):
        size = int(np.prod(shape))
        views.append(flat[:, start : start + size].reshape(flat.shape[0], *shape))
        start += size
    return views


def initial_parameters(
    inputs: int, hidden: int, outputs: int, generator: np.random.Generator, memory: Memory = "none"
) -> Float32:
    """Return one network's flat parameters [P], uniform in +-1/sqrt(fan-in), in the last layer a tenth of it."""
    parts = []
    matrices = layer_shapes(inputs, hidden, outputs, memory)[::2]
    for index, (rows, columns) in enumerate(matrices):
        bound = (0.1 if index == len(matrices) - 1 else 1.0) / np.sqrt(rows)
        parts.append(generator.uniform(-bound, bound, rows * columns))
        parts.append(generator.uniform(-bound, bound, columns))
    return np.concatenate(parts).astype(np.float32)


def blend(parameters: Float32, target: Float32, rate: float) -> None:
    """Move parameters to a target in place: theta = (1 - vartheta) theta + vartheta theta', eq. (soft).

    Args:
        parameters: [..., P] float32.
        target: float32 that broadcasts to the same shape.
        rate: vartheta in 0..1.
    """
    parameters[...] = np.float32(1.0 - rate) * parameters + np.float32(rate) * target


def imitate(parameters: Float32, elite: int, rate: float) -> None:
    """Blend every row with the elite's in place: theta_i = (1 - vartheta) theta_i + vartheta theta_i', eq. (soft).

    Learner and workers both call this function on float32 arrays, so their copies stay bit-equal. A single row is
    shared by all agents of the type, the elite included, and does not change.

    Args:
        parameters: [n_v, P] or [1, P] float32, contiguous.
        elite: row of the elite, which does not change.
        rate: vartheta in 0..1.
    """
    if len(parameters) == 1:
        return
    target = parameters[elite].copy()
    for index in range(parameters.shape[0]):
        if index != elite:
            blend(parameters[index], target, rate)


@dataclass(frozen=True)
class TeamActors:
    """All actors of a team.

    Attributes:
        team: the layout.
        hidden: width of the hidden layers.
        flat: for each type, [n_v, P_v] or [1, P_v] float32, C-contiguous.
        head: kind of the last layer.
        memory: kind of memory.
        module: options of the plug-in's network that the actors are, for which `hidden` has no meaning; None for
            perceptrons.
    """

    team: TeamSpec
    hidden: int
    flat: tuple[Float32, ...]
    head: Head = "deterministic"
    memory: Memory = "none"
    module: NetworkConfig | None = None

    def __post_init__(self) -> None:
        """Raise SchemaError unless every array has the team's shape and is finite."""
        if self.module is not None and self.memory != "none":
            raise SchemaError(f"actors of the network {self.module.name} have no memory.")
        if len(self.flat) != len(self.team.groups):
            raise SchemaError(f"actors for {len(self.flat)} types given, the team has {len(self.team.groups)}.")
        for group, flat in zip(self.team.groups, self.flat, strict=True):
            size = actor_parameters(group, self.hidden, self.head, self.memory, self.module)
            shapes = (group.count, size), (1, size)
            if flat.shape not in shapes or flat.dtype != np.float32 or not flat.flags.c_contiguous:
                raise SchemaError(
                    f"{group.name} actors are {flat.dtype}{list(flat.shape)}, not float32{list(shapes[0])}."
                )
            if not np.isfinite(flat).all():
                raise SchemaError(f"{group.name} actors hold a number that is not finite.")

    @classmethod
    def initial(
        cls,
        team: TeamSpec,
        hidden: int,
        seed: int,
        *,
        per_type: bool = True,
        head: Head = "deterministic",
        shared: bool = False,
        memory: Memory = "none",
    ) -> "TeamActors":
        """Return freshly initialised actors: one initialisation for each type, or for each agent (A4).

        With `shared`, the agents of a type share one row of parameters.
        """

        def rows(group: GroupSpec) -> Float32:
            names = [0 if per_type else index for index in range(1 if shared else group.count)]
            sizes = (group.observation_size, hidden, actor_outputs(group, head))
            draw = [initial_parameters(*sizes, stream(seed, "actor", group.name, name), memory) for name in names]
            return np.ascontiguousarray(np.stack(draw))

        return cls(team, hidden, tuple(rows(group) for group in team.groups), head, memory)

    def copy(self) -> "TeamActors":
        """Return a copy that shares no array with these actors."""
        return replace(self, flat=tuple(flat.copy() for flat in self.flat))

    @property
    def draws(self) -> bool:
        """Whether the actors have a distribution to draw actions from."""
        return self.head == "gaussian"

    def noise_free(self) -> "TeamActors":
        """Return actors that act as these do without noise; Gaussian heads of perceptrons become deterministic."""
        if self.head == "deterministic" or self.module is not None:
            return self
        parts = []
        for group, flat in zip(self.team.groups, self.flat, strict=True):
            if group.choices:
                parts.append(flat)
                continue
            views = parameter_views(flat, group.observation_size, self.hidden, 2 * group.action_size, self.memory)
            views[-2:] = [view[..., : group.action_size] for view in views[-2:]]
            parts.append(np.concatenate([view.reshape(len(flat), -1) for view in views], axis=1))
        return replace(self, flat=tuple(parts), head="deterministic")

    def initial_state(self, count: int) -> Float32 | None:
        """Return the state [E, agents, h] of E environments whose episodes begin, or None for actors without memory."""
        return None if self.memory == "none" else np.zeros((count, self.team.agents, self.hidden), np.float32)

    def act(self, observations: Float32, state: Float32 | None = None) -> Float32:
        """Return the noise-free actions of all agents.

        Args:
            observations: rows [E, O] float32.
            state: as for `outputs`.

        Returns:
            rows [E, A] float32: in [-1, 1], or indices of options.
        """
        return noise_free_actions(self.outputs(observations, state))

    def environment_actions(self, observations: Float32, state: Float32 | None = None) -> Float32:
        """Return the noise-free actions after the team's adapters, rows of the environment; see `TeamSpec.adapt`."""
        return self.team.adapt(observations, self.act(observations, state))

    def explore(self, observations: Float32, noise: Float32, noise_std: float) -> Float32:
        """Return the continuous actions of all agents with exploration noise, as off-policy algorithms explore.

        Args:
            observations: rows [E, O] float32.
            noise: rows [E, A] float32, standard normal.
            noise_std: standard deviation of the noise on a deterministic head's actions; a Gaussian head uses its own.

        Returns:
            rows [E, A] float32 in [-1, 1].
        """
        if self.head == "deterministic":
            noisy = self.act(observations) + np.float32(noise_std) * noise
            return np.clip(noisy, np.float32(-1), np.float32(1), out=noisy)
        parts = []
        for (group, _, head), own in zip(self.outputs(observations), self.team.split_actions(noise), strict=True):
            size = group.action_size
            scale = np.exp(np.clip(head[..., size:], np.float32(LOG_STD_RANGE[0]), np.float32(LOG_STD_RANGE[1])))
            parts.append(np.tanh(head[..., :size] + scale * own).reshape(observations.shape[0], -1))
        return np.concatenate(parts, axis=1)

    def explore_options(self, observations: Float32, uniform: Float32, epsilon: float) -> Float32:
        """Return the discrete actions of all agents, of which some are drawn at random.

        Args:
            observations: rows [E, O] float32.
            uniform: rows [E, A] float32, uniform over [0, 1).
            epsilon: share of the options that are drawn among all legal ones, 0..1.

        Returns:
            rows [E, A] float32, indices of options.
        """
        parts = zip(self.outputs(observations), self.team.split_actions(uniform), strict=True)
        found = [epsilon_greedy(group, own, values, draw, epsilon) for (group, own, values), draw in parts]
        return np.concatenate([action.reshape(len(observations), -1) for action in found], axis=1)

    def sample(
        self, observations: Float32, normal: Float32, uniform: Float32, state: Float32 | None = None
    ) -> tuple[Float32, Float32]:
        """Return sampled actions of all agents and their log-probabilities, as on-policy algorithms act.

        Args:
            observations: rows [E, O] float32.
            normal: rows [E, A] float32, standard normal; continuous actions take theirs.
            uniform: rows [E, A] float32, uniform over [0, 1); discrete actions take theirs.
            state: as for `outputs`.

        Returns:
            actions, rows [E, A] float32, and log-probabilities [E, agents] float32.

        Raises:
            SchemaError: a type with continuous actions has deterministic heads.
        """
        count, actions, log_probabilities = observations.shape[0], [], []
        draws = self.team.split_actions(normal), self.team.split_actions(uniform)
        parts = zip(self.outputs(observations, state), *draws, strict=True)
        for (group, own, outputs), noise, draw in parts:
            if group.choices:
                action, log_probability = sample_options(group, own, outputs, draw)
            elif self.head == "gaussian":
                size = group.action_size
                log_std = np.clip(outputs[..., size:], np.float32(LOG_STD_RANGE[0]), np.float32(LOG_STD_RANGE[1]))
                action, log_probability = sample_squashed(outputs[..., :size], log_std, noise)
            else:
                raise SchemaError(f"deterministic {group.name} actors cannot be sampled.")
            actions.append(action.reshape(count, -1))
            log_probabilities.append(log_probability)
        return np.concatenate(actions, axis=1), np.concatenate(log_probabilities, axis=1)

    def outputs(
        self, observations: Float32, state: Float32 | None = None
    ) -> Iterator[tuple[GroupSpec, Float32, Float32]]:
        """Yield each type, its observations [E, n_v, o_v], and the outputs [E, n_v, outputs] of its actors.

        Args:
            observations: rows [E, O] float32.
            state: [E, agents, h] float32 state of actors with memory before this step, which is updated in place; None
                for actors without. See `initial_state`.

        Raises:
            SchemaError: the state does not fit the actors.
        """
        self._check_state(state, len(observations))
        if self.module is not None:
            yield from self._module_outputs(self.module, observations)
            return
        own = zip(self._layers, self.team.agent_slices(), self.team.split_observations(observations), strict=True)
        for group, (layers, agents, rows) in zip(self.team.groups, own, strict=True):
            w1, b1, *middle, w3, b3 = layers
            shared, outputs = len(w1) == 1, w3.shape[-1]
            x = rows.reshape(1, -1, rows.shape[-1]) if shared else np.ascontiguousarray(rows.transpose(1, 0, 2))
            h = np.maximum(np.matmul(x, w1) + b1[:, None], np.float32(0))
            if state is None:
                w2, b2 = middle
                h = np.maximum(np.matmul(h, w2) + b2[:, None], np.float32(0))
            else:
                h = _remembered(h, state[:, agents], middle, shared=shared)
            found = np.matmul(h, w3) + b3[:, None]
            yield group, rows, found.reshape(*rows.shape[:2], outputs) if shared else found.transpose(1, 0, 2)

    def _module_outputs(
        self, module: NetworkConfig, observations: Float32
    ) -> Iterator[tuple[GroupSpec, Float32, Float32]]:
        """Yield what `outputs` does, for networks of a plug-in."""
        from eia_sec.common.modules import outputs_of  # noqa: PLC0415  (loads torch, which perceptrons here do without)

        for group, flat, rows in zip(
            self.team.groups, self.flat, self.team.split_observations(observations), strict=True
        ):
            yield group, rows, outputs_of(module, group.seen, actor_outputs(group, self.head), flat, rows)

    @cached_property
    def _layers(self) -> list[list[Float32]]:
        """Views of each type's layers, which follow every change of `flat` in place."""
        return [
            parameter_views(flat, group.observation_size, self.hidden, actor_outputs(group, self.head), self.memory)
            for group, flat in zip(self.team.groups, self.flat, strict=True)
        ]

    def _check_state(self, state: Float32 | None, count: int) -> None:
        wanted = None if self.memory == "none" else (count, self.team.agents, self.hidden)
        found = None if state is None else state.shape
        if found != wanted:
            raise SchemaError(f"actors with the memory {self.memory!r} take a state {wanted}, not {found}.")

    def digest(self) -> str:
        """Return the SHA-256 of all parameters, in hexadecimal."""
        state = hashlib.sha256()
        for flat in self.flat:
            state.update(np.ascontiguousarray(flat).tobytes())
        return state.hexdigest()


def noise_free_actions(parts: Iterable[tuple[GroupSpec, Float32, Float32]]) -> Float32:
    """Return the noise-free actions for what `TeamActors.outputs` yields, rows [E, A] float32.

    Outputs that are not finite may give an action that is: the index of an option, or tanh of infinity.
    """
    actions = [
        best_options(group, observation, outputs) if group.choices else np.tanh(outputs[..., : group.action_size])
        for group, observation, outputs in parts
    ]
    return np.concatenate([action.reshape(action.shape[0], -1) for action in actions], axis=1)


def _remembered(x: Float32, state: Float32, unit: list[Float32], *, shared: bool) -> Float32:
    """Update the states [E, n_v, h] of a type's actors in place; return them as the networks compute them.

    Args:
        x: [n, B, h] outputs of the first hidden layer: [1, E n_v, h] of shared parameters, else [n_v, E, h].
        state: [E, n_v, h].
        unit: W, b, U, c.
        shared: whether the agents share their parameters.
    """
    before = state.reshape(x.shape) if shared else np.ascontiguousarray(state.transpose(1, 0, 2))
    after = next_state(x, before, *unit)
    state[...] = after.reshape(state.shape) if shared else after.transpose(1, 0, 2)
    return after
