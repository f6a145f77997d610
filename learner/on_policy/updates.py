"""The updates of one iteration: advantages once, then epochs of minibatches.

    values, advantages, returns of all rows           at the iteration's start
    for each epoch: shuffle the steps, or with memory the sequences of steps
        for each minibatch: one Adam step of L_actor and of L_value of every type; their gradients side by side
        a type whose KL divergence exceeds `target_kl` keeps its actors for the rest of the iteration
    all actors keep still in the iterations of the first `value_steps` steps

A chunk's behaviour policy may be some versions older than the actors (`max_lag_versions`). Values and advantages are
those of the present value functions. `objective` says what the ratio's denominator is:

    ppo        pi_behaviour, as the worker sent it. The clip bounds how far the actors move from the policy that acted.
               Steps of an older policy begin with ratios beyond the clip, so that part of them teaches nothing.
    decoupled  pi_newest, the actors at the iteration's start (Hilton et al. 2022). Advantages are multiplied by
               min(pi_newest / pi_behaviour, 2), so steps of an older policy count as much as the others.
"""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import partial

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from eia_sec.common.config import LearnerConfig, OnPolicyConfig
from eia_sec.common.errors import CheckpointError
from eia_sec.common.team import Float32, TeamSpec
from eia_sec.common.transitions import Rows
from eia_sec.learner.checkpoint.array_tensors import as_tensor
from eia_sec.learner.networks.adam import Adam
from eia_sec.learner.networks.device import product_dtype
from eia_sec.learner.networks.sequences import TypeSequences
from eia_sec.learner.networks.side_by_side import SideBySide
from eia_sec.learner.networks.stack import Stack
from eia_sec.learner.on_policy.advantages import advantages
from eia_sec.learner.on_policy.captured_updates import CapturedUpdates
from eia_sec.learner.on_policy.diagnostics import IterationDiagnostics
from eia_sec.learner.on_policy.experience import Observations, split, split_actions, step_rows
from eia_sec.learner.on_policy.iteration_states import IterationStates
from eia_sec.learner.on_policy.minibatch import Minibatch
from eia_sec.learner.on_policy.normalisation import Scales
from eia_sec.learner.registry import on_policy

VALUE_BATCH = 4096
"""Most rows whose values are computed at once."""
MOST_INPUTS = 2**24
"""Most numbers that a plug-in's networks read at once for that, 64 MiB; their layers take a multiple of it."""
EPSILON = 1e-8
"""Added to the deviation that advantages are divided by."""
ADAM_EPSILON = 1e-5
MOST_WEIGHT = 2.0
"""Largest weight of a step in the decoupled objective; rare actions of an older policy would else drown the others."""
NOTHING_SEEN = Observations((), torch.zeros(0, 0))
COMPUTED = ("returns", "advantage")
"""Tensors of an iteration's rows, [R, agents], that are computed at its start."""


class Updates:
    """Networks, optimiser and the state of a running iteration.

    Args:
        config: the algorithm's configuration.
        team: the layout of the team.
        seed: seed of the run.
        learner: the torch device of networks and rows, and threads.

    Attributes:
        algorithm: networks and losses.
        policies: its actors.
        values: its value functions, one module for each type.
        diagnostics: what the newest iteration's updates measured.
    """

    def __init__(self, config: OnPolicyConfig, team: TeamSpec, seed: int, learner: LearnerConfig) -> None:
        self._config, self._team, self._seed, self._learner = config, team, seed, learner
        self._device = device = learner.device
        most = min(learner.update_threads, 2 * len(team.groups))
        self._side_by_side = SideBySide(most if device == "cpu" else 1)
        self._dtype = product_dtype(config.precision, device)
        # The last layers' narrow products have float32 results; rounding their factors makes them several times faster.
        torch.set_float32_matmul_precision("medium" if self._dtype == torch.bfloat16 else "highest")
        self.algorithm = on_policy(config.name)(config, team, seed, device)
        self.policies, self.values = self.algorithm.policies, self.algorithm.values
        self._all_networks = (("actors", self.policies), ("values", nn.ModuleList(self.values)))
        rates = config.actor_rate, config.critic_rate
        groups = [(networks.parameters(), rate) for (_, networks), rate in zip(self._all_networks, rates, strict=True)]
        self._adam = Adam(groups, epsilon=ADAM_EPSILON)
        # Networks with memory go through sequences, whose number differs from one minibatch to the next. What a
        # plug-in's network does is not known.
        self._captures = device != "cpu" and config.memory == "none" and config.module is None
        self._captured = self._uncaptured()
        self.diagnostics = IterationDiagnostics(team)
        self._scales = Scales(team, device)
        if config.normalise_observations:
            self.policies.scales = self._scales
        self._groups = list(zip(team.groups, team.agent_slices(), strict=True))
        gamma = config.discounts
        self._discount = np.concatenate(
            [np.full(group.count, gamma.get(group.name, config.discount), np.float32) for group in team.groups]
        )
        self._rows: dict[str, Tensor] = {}
        self._seen = NOTHING_SEEN
        self._states: IterationStates | None = None
        self._begun: Rows | None = None
        self.stopped = [False] * len(team.groups)

    def _uncaptured(self) -> CapturedUpdates | None:
        """Return where the graphs of updates are kept, without any; None where updates are not captured."""
        return CapturedUpdates(self._adam.tensors(), len(self._team.groups)) if self._captures else None

    def retune(self, config: OnPolicyConfig) -> None:
        """Go on with other values of the options that are `live`, between two iterations."""
        self._config = replace(config, shared_until=self._config.shared_until)
        self.algorithm.config = self._config
        self._adam.rates[:] = config.actor_rate, config.critic_rate
        self._captured = self._uncaptured()  # graphs hold the values

    def separated(self) -> "Updates":
        """Return the updates in which every agent has networks of its own, copies of its type's.

        A loss is a mean over a type's n agents, so an agent's network gets an n-th of the gradient that a shared one
        gets. Adam's moments shrink with it, so that steps stay as long.
        """
        found = self._with(replace(self._config, shared_until=0.0))
        shared = dict(self.network_tensors())
        with torch.no_grad():
            for name, tensor in found.network_tensors():
                own = shared[self.algorithm.shared_name(name)]
                copies = len(tensor) // len(own) if tensor.ndim and tensor.numel() else 1
                power = {"exp_avg": 1, "exp_avg_sq": 2}.get(name.rpartition(".")[2], 0)
                tensor.copy_((own / copies**power).expand_as(tensor))
        found.diagnostics = self.diagnostics
        return found

    def _with(self, config: OnPolicyConfig) -> "Updates":
        """Return fresh updates of another configuration."""
        return Updates(config, self._team, self._seed, self._learner)

    def begin(self, rows: Rows, steps: int) -> None:
        """Compute values, advantages and returns of an iteration's rows.

        Args:
            rows: the iteration's rows.
            steps: environment steps of all iterations up to this one.
        """
        config, device = self._config, self._device
        self.stopped = [steps <= config.value_steps] * len(self._team.groups)
        self._begun = rows
        if not self._scales_follow:
            self._take_in_observations(rows)
        self._load(rows)
        states, team = self._states, self._seen.team
        value = self._all_values() if states is None else states.begin(self.policies, team)
        for scale, (_, agents) in zip(self._scales.returns, self._groups, strict=True):
            mean, deviation = scale.shift_and_scale()
            value[:, agents] = mean + deviation * value[:, agents]
        reward = rows.reward * np.float32(config.reward_scale)
        ends = config.time_limit == "terminal"
        gain = advantages(reward, value, rows.flag, self._discount, config.gae_lambda, time_limit_ends=ends)
        used = step_rows(rows)
        returns = gain + value
        if config.normalise_returns:
            self._take_in_returns(returns, used)
        self._rows["returns"] = torch.from_numpy(self._as_learnt(returns)).to(device)
        self._rows["advantage"] = torch.from_numpy(self._normalised(gain, used)).to(device)
        if config.objective == "decoupled":
            self._decouple(rows)
        self.diagnostics.begin(value[used], returns[used])

    @property
    def _scales_follow(self) -> bool:
        """Whether an iteration's rows change what observations are scaled by after its updates, and not before.

        A plug-in's network does not keep its function when its inputs move. So it learns from inputs as it has acted on
        them; its ratios would else not begin with 1.
        """
        return self._config.module is not None

    def _take_in_observations(self, rows: Rows) -> None:
        """Update what observations are scaled by; networks that have learnt keep their function."""
        if not self._config.normalise_observations:
            return
        scales, kinds = self._scales, range(len(self._groups))
        fresh, before = scales.fresh, [scales.of_type(kind) for kind in kinds]
        team_before = scales.of_team()
        for kind, own in enumerate(split(self._team, as_tensor(rows.observation))):
            scales.observations[kind].add(own.flatten(0, 1))
        for kind in kinds:
            stack, moved = self.policies.stacks[kind], _moved(before[kind], scales.of_type(kind))
            if not fresh:
                stack.follow_inputs(*moved)
            elif float(scales.loaded):
                stack.rescale_inputs(*moved)
            seen = (team_before, scales.of_team()) if self._config.sees_team else (before[kind], scales.of_type(kind))
            for stack in () if fresh else _stacks(self.values[kind]):
                stack.follow_inputs(*_moved(*seen))

    def _take_in_returns(self, returns: Float32, used: NDArray[np.int64]) -> None:
        """Update what returns are scaled by; value functions that have learnt keep theirs."""
        for scale, value, (_, agents) in zip(self._scales.returns, self.values, self._groups, strict=True):
            fresh, (mean, deviation) = scale.fresh, scale.shift_and_scale()
            scale.add(torch.from_numpy(returns[used, agents]))
            new_mean, new_deviation = scale.shift_and_scale()
            for stack in () if fresh else _stacks(value):
                stack.follow_outputs((mean - new_mean) / new_deviation, deviation / new_deviation)

    def _as_learnt(self, returns: Float32) -> Float32:
        """Return the returns [R, agents] as value functions learn them."""
        found = returns.copy()
        for scale, (_, agents) in zip(self._scales.returns, self._groups, strict=True):
            mean, deviation = scale.shift_and_scale()
            found[:, agents] = (returns[:, agents] - mean) / deviation
        return found

    @torch.no_grad()
    def _decouple(self, rows: Rows) -> None:
        """Replace the behaviour policy by the present actors, and weight the advantages."""
        newest = self._newest_log_probability(rows)
        weight = (newest - self._rows["log_probability"]).exp().clamp(max=MOST_WEIGHT)
        self._rows["log_probability"] = newest
        self._rows["advantage"] = self._rows["advantage"] * weight

    @torch.no_grad()
    def _newest_log_probability(self, rows: Rows) -> Tensor:
        """Return log pi(a | o) [R, agents] of the present actors in the rows from which a step follows."""
        newest = self._rows["log_probability"].clone()
        samples = self.samples(rows)
        for part in np.array_split(samples, min(len(samples), -(-rows.steps // self._rows_at_once))):
            places, sequences = self._gathered(part)
            actions = enumerate(split_actions(self._team, self._rows["action"][places]))
            tasks = [partial(self._log_probability, kind, places, action, sequences) for kind, action in actions]
            newest[places] = torch.cat(self._side_by_side.run(tasks), dim=1)
        return newest

    @torch.no_grad()  # which each thread asks for itself
    def _log_probability(self, kind: int, places: Tensor, action: Tensor, sequences: TypeSequences | None) -> Tensor:
        """Return log pi(a | o) [B, n] of a type's present actors for its actions [B, n, a] in some rows."""
        acting = None if sequences is None else sequences[kind][0]
        return self.policies.evaluate(kind, self._own(places, kind), action, acting).log_probability

    def _gathered(self, samples: NDArray[np.int64]) -> tuple[Tensor, TypeSequences | None]:
        """Return the rows' numbers of some samples, and for networks with memory how these follow one another."""
        places, sequences = (samples, None) if self._states is None else self._states.rows_and_sequences(samples)
        return torch.from_numpy(places).to(self._device), sequences

    def _load(self, rows: Rows) -> None:
        assert rows.log_probability is not None
        arrays = {"action": rows.action, "log_probability": rows.log_probability}
        self._rows = {name: torch.from_numpy(array).to(self._device) for name, array in arrays.items()}
        whole = self._config.sees_team or self._config.memory != "none"
        observation = as_tensor(rows.observation).to(self._device)
        if self._config.normalise_observations and not self._team.in_bytes:
            shift, scale = self._scales.of_team()
            observation = (observation - shift) / scale
        self._seen = Observations.of(self._team, observation, self._dtype, self._side_by_side, whole=whole)
        if self._config.memory != "none":
            self._states = IterationStates(self._config, self._team, rows, self.values, self._device)

    def _normalised(self, gain: Float32, used: NDArray[np.int64]) -> Float32:
        """Return advantages with mean 0 and deviation 1 over the steps and agents of each type."""
        found = gain.copy()
        for _, agents in self._groups:
            own = gain[used, agents]
            found[:, agents] = (gain[:, agents] - own.mean()) / (own.std() + EPSILON)
        return found

    def _all_values(self) -> Float32:
        """Return V of every row, [R, agents]."""
        parts = self._side_by_side.run([partial(self._values_of, kind) for kind in range(len(self._groups))])
        found: Float32 = torch.cat(parts, dim=1).float().cpu().numpy()
        return found

    @torch.no_grad()
    def _values_of(self, kind: int) -> Tensor:
        """Return V of every row for a type's agents, [R, n]."""
        batches = (torch.split(part, self._rows_at_once) for part in (self._seen.team, self._seen.own[kind]))
        return torch.cat([self.values[kind].value(team, own) for team, own in zip(*batches, strict=True)])

    @property
    def _rows_at_once(self) -> int:
        """Rows that networks go through at once where no gradients are needed."""
        if self._config.module is None:
            return VALUE_BATCH
        return max(1, min(VALUE_BATCH, MOST_INPUTS // self._team.observation_size))

    def samples(self, rows: Rows) -> NDArray[np.int64]:
        """Return what minibatches are made of: the rows from which steps follow, or with memory sequences' numbers."""
        used = step_rows(rows)
        return used if self._config.memory == "none" else np.arange(len(used) // self._config.sequence_steps)

    def minibatches(self, rows: Rows, random: np.random.Generator) -> list[NDArray[np.int64]]:
        """Shuffle the samples and cut them into minibatches of equal size, but for one sample."""
        return np.array_split(random.permutation(self.samples(rows)), self._count(rows))

    def _count(self, rows: Rows) -> int:
        """Return how many minibatches an epoch has."""
        return max(1, round(rows.steps / self._config.minibatch_steps))

    def update(self, samples: NDArray[np.int64], progress: float) -> None:
        """Do one update from a minibatch; `progress` is the finished share of the run, 0 to 1."""
        batch, captured = self._minibatch(samples, progress), self._captured
        self.diagnostics.add(self._learn(batch) if captured is None else captured.update(self._learn, batch))

    def _minibatch(self, samples: NDArray[np.int64], progress: float) -> Minibatch:
        config = self._config
        weight = config.entropy_start + (config.entropy_end - config.entropy_start) * progress
        places, sequences = self._gathered(samples)
        tensors = {name: tensor.index_select(0, places) for name, tensor in self._rows.items()}
        team = self._seen.team if config.sees_team else self._seen.team[:, :0]
        own, stopped = partial(self._own, places), tuple(self.stopped)
        return Minibatch(
            own, tensors, team.index_select(0, places), sequences, stopped, weight, config.rate_share(progress)
        )

    def _learn(self, batch: Minibatch) -> list[dict[str, Tensor]]:
        """Take one step of Adam for each type; return what was measured of each."""
        self._adam.zero_grad()
        found = self._gradients(batch)
        networks: list[nn.Module] = [*self.policies.stacks, *self.values]
        norms = self._side_by_side.run([partial(self._clipped, each) for each in networks])
        self._adam.step(batch.rate_share)
        for kind, measured in enumerate(found):
            if not batch.stopped[kind]:
                measured["actor_gradient"] = norms[kind]
            measured["value_gradient"] = norms[len(found) + kind]
        return found

    def _gradients(self, batch: Minibatch) -> list[dict[str, Tensor]]:
        """Compute the gradients of all networks side by side; return what was measured of each type."""
        kinds = range(len(self._groups))
        gradients = self._actor_gradient, self._value_gradient
        found = self._side_by_side.run([partial(gradient, kind, batch) for gradient in gradients for kind in kinds])
        return [found[kind] | found[len(kinds) + kind] for kind in kinds]

    def _own(self, places: Tensor, kind: int) -> Tensor:
        """Return a type's observations [B, n, o] in some rows."""
        return self._seen.own[kind].index_select(0, places)

    def _actor_gradient(self, kind: int, batch: Minibatch) -> dict[str, Tensor]:
        """Compute the gradient of a type's actors; return what was measured, nothing if they have stopped."""
        if batch.stopped[kind]:
            return {}
        part = self.algorithm.actor_loss(kind, batch)
        part.loss.backward()
        return {
            "actor_loss": part.loss.detach(),
            "entropy": part.entropy,
            "kl": part.kl,
            "clipped_share": part.clipped,
        }

    def _value_gradient(self, kind: int, batch: Minibatch) -> dict[str, Tensor]:
        """Compute the gradient of a type's value functions; return what was measured."""
        loss = self.algorithm.value_loss(kind, batch)
        loss.backward()
        return {"value_loss": loss.detach()}

    def end_epoch(self) -> None:
        """Stop the actors of types that have moved too far from the policy under the ratio."""
        for kind, kl in enumerate(self.diagnostics.epoch_kl()):
            if 0.0 < self._config.target_kl < kl:
                self.stopped[kind] = True

    def _clipped(self, networks: nn.Module) -> Tensor:
        """Limit the gradient of some networks; return its norm before."""
        limit = self._config.gradient_clip or float("inf")
        return nn.utils.clip_grad_norm_(list(networks.parameters()), limit)

    def network_tensors(self) -> Iterator[tuple[str, Tensor]]:
        """Yield views of all layers and Adam's moments of them by name; moments are zeros before the first step.

        Writing to them restores a state. Adam counts the steps of a whole stack; the count stands beside each layer.
        """
        if self._config.normalise_observations or self._config.normalise_returns:
            yield from ((f"scales.{name}", tensor) for name, tensor in self._scales.named_tensors())
        for owner, module in self._all_networks:
            for name, stack in module.named_modules():
                if isinstance(stack, Stack):
                    yield from self._stack_tensors(f"{owner}.{name}", stack)

    def _stack_tensors(self, name: str, stack: Stack) -> Iterator[tuple[str, Tensor]]:
        for index, layer in enumerate(stack.layers):
            yield f"{name}.layers.{index}", layer
        for moment, tensor in self._adam.moments[stack.flat]._asdict().items():
            parts = [tensor] * len(stack.layers) if moment == "step" else stack.layers_of(tensor)
            for index, part in enumerate(parts):
                yield f"{name}.layers.{index}.{moment}", part

    def iteration_tensors(self) -> dict[str, Tensor]:
        """Return what a running iteration has computed from its rows, by name."""
        states = {} if self._states is None else self._states.tensors()
        return {name: self._rows[name] for name in self._computed if "returns" in self._rows} | states

    def iteration_shapes(self, rows: Rows) -> dict[str, tuple[int, ...]]:
        """Return the shapes of `iteration_tensors` for an iteration with these rows."""
        shapes: dict[str, tuple[int, ...]] = dict.fromkeys(self._computed, (len(rows.flag), self._team.agents))
        if self._config.memory != "none":
            shapes |= IterationStates(self._config, self._team, rows, self.values, self._device).shapes()
        return shapes

    @property
    def _computed(self) -> tuple[str, ...]:
        """Names of the tensors [R, agents] that an iteration's updates learn from and that its rows do not hold."""
        return (*COMPUTED, "log_probability") if self._config.objective == "decoupled" else COMPUTED

    def resume(self, rows: Rows, tensors: dict[str, Tensor], stopped: list[bool]) -> None:
        """Continue an iteration with what it had computed from its rows."""
        self._begun = rows
        self._load(rows)
        self._rows |= {name: tensors[name].to(self._device) for name in self._computed}
        if self._states is not None:
            self._states.restore(tensors)
        self.stopped = list(stopped)

    def end(self) -> None:
        """Forget the iteration's rows, and which actors have stopped in it."""
        if self._begun is not None and self._scales_follow:
            self._take_in_observations(self._begun)
        self._begun = None
        self._rows, self._seen, self._states = {}, NOTHING_SEEN, None
        self.stopped = [False] * len(self._team.groups)


def _stacks(networks: nn.Module) -> list[Stack]:
    return [module for module in networks.modules() if isinstance(module, Stack)]


def _moved(before: tuple[Tensor, Tensor], after: tuple[Tensor, Tensor]) -> tuple[Tensor, Tensor]:
    """Return shift and scale of what was read with `before`'s, as what is read with `after`'s."""
    (shift, scale), (new_shift, new_scale) = before, after
    return (new_shift - shift) / scale, new_scale / scale


def require_one_count(found: Mapping[str, Tensor]) -> None:
    """Raise CheckpointError unless the layers of each stack have the same count of Adam's steps.

    Args:
        found: tensors by the names of `Updates.network_tensors`, which may have a prefix.
    """
    counts: dict[str, Tensor] = {}
    for name, count in found.items():
        stack, _, layer = name.partition(".layers.")
        if layer.endswith(".step") and not torch.equal(counts.setdefault(stack, count), count):
            raise CheckpointError(f"the checkpoint's {name} differs within one network.")
