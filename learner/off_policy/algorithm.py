"""The interface of off-policy algorithms, and the steps that they share.

An algorithm is one class in a file of this folder: its networks, and one update of all of them from a batch of replay.
Those with critics derive from `ActorCritic`. The engine calls

    for number in itertools.count(1):
        algorithm.update(batch, noise, actor_step=number % period == 0, diagnostics=False)

An update has no branch that depends on data, so that each kind of update can be captured as a CUDA graph.

It computes a loss, calls `backward()` and takes the step. The networks of a role are one differentiable operation
(`eia_sec.learner.networks.stacks`), whose newest result alone can be differentiated: call `backward()` before you
compute the same networks again.
"""

from abc import ABC, abstractmethod
from typing import ClassVar, Generic, NamedTuple, TypeVar

import torch
from torch import Tensor

from eia_sec.common.actors import Head
from eia_sec.common.config import OffPolicyConfig
from eia_sec.common.team import TeamSpec
from eia_sec.learner.off_policy.actors import Actors
from eia_sec.learner.off_policy.critics import Critics
from eia_sec.learner.off_policy.inputs import Inputs

C = TypeVar("C", bound=OffPolicyConfig)


class Batch(NamedTuple):
    """B transitions of the whole team, on the engine's device.

    Attributes:
        observation: rows [B, O].
        action: rows [B, A].
        reward: [B, agents].
        next_observation: rows [B, O].
        terminated: [B], 1 where nothing is bootstrapped from the next observation, else 0.
    """

    observation: Tensor
    action: Tensor
    reward: Tensor
    next_observation: Tensor
    terminated: Tensor


class Diagnostics(NamedTuple):
    """What one update measured; None where the algorithm has no such thing. Norms are those before any clip.

    Attributes:
        td_error: Q - Y of the (first) critics before their step, [agents, B]; Q_P - Y with the mixture loss.
        objective: what the actors maximise, before their step, [agents, B].
        target: Y [agents, B].
        q_value: Q of the batch's own actions before the step [agents, B]: Q_P, or the (first) critics' values.
        critic_gradient_norm: norm of the newest gradient of each agent's critic [agents], mean over its critics.
        actor_gradient_norm: norm of each actor's newest gradient [agents].
        member_std: standard deviation of the SEC members' values at the actors' actions [agents, B].
        member_loss: mean over the members and the agent's rows of (Q_s,k - Y)^2 before the step [agents].
        member_gradient_norm: norm of a member's newest gradient, mean over the members of the agent's type [agents].
        temperature: alpha [agents].
        log_probability: log pi of the actions that the actors sampled, mean over the batch [agents].
        entropy_regularised: whether values and targets include entropy, so that they do not compare with rewards.
        of_team: whether values and targets are of the mean of all agents' rewards; each agent then has the same.
    """

    td_error: Tensor
    objective: Tensor | None
    target: Tensor
    q_value: Tensor
    critic_gradient_norm: Tensor | None = None
    actor_gradient_norm: Tensor | None = None
    member_std: Tensor | None = None
    member_loss: Tensor | None = None
    member_gradient_norm: Tensor | None = None
    temperature: Tensor | None = None
    log_probability: Tensor | None = None
    entropy_regularised: bool = False
    of_team: bool = False


class Algorithm(ABC, Generic[C]):
    """The networks of one off-policy algorithm, and its update from a batch of replay.

    Args:
        config: its configuration.
        team: the layout of the team.
        seed: seed of the run, from which every initialisation follows.
        like: a tensor of the wanted device and type.
        cores: processor cores for the compiled kernels; 0 to compute by torch.

    Attributes:
        head: kind of the actors' last layer.
        shared_actors: whether the agents of a type share one actor.
        noise_blocks: standard normal numbers that an update takes, in action layouts.
        actors: all actors and their targets.
    """

    head: ClassVar[Head] = "deterministic"
    shared_actors: ClassVar[bool] = False
    noise_blocks: ClassVar[int] = 0

    def __init__(self, config: C, team: TeamSpec, seed: int, like: Tensor, *, cores: int) -> None:
        self.config, self.team = config, team
        self._inputs, self._next_inputs = (Inputs(team, config.batch, config.joint_critics, like) for _ in range(2))
        target, shared = self.has_target_actors(), self.shared_actors
        self.actors = Actors(config, team, seed, like, head=self.head, shared=shared, target=target, cores=cores)

    def retune(self, config: C) -> None:
        """Go on with other values of the options that are `live`."""
        self.config = config
        self.actors.set_rate(config.actor_rate)

    def has_target_actors(self) -> bool:
        """Return whether target actors choose the next actions."""
        return False

    @classmethod
    def actor_period(cls, config: C) -> int:
        """Return after how many updates the actors step."""
        return 1

    @abstractmethod
    def update(self, batch: Batch, noise: Tensor, *, actor_step: bool, diagnostics: bool) -> Diagnostics | None:
        """Do one update; return its diagnostics where wanted, valid until the next update.

        Args:
            batch: the transitions.
            noise: [noise_blocks, sum n_v * B * a_v] standard normal numbers, each block in the action layout.
            actor_step: whether the actors step in this update.
            diagnostics: whether to return diagnostics, which changes nothing else.
        """

    def tensors(self) -> dict[str, Tensor]:
        """Return the whole state by name, float and integer tensors that are changed in place."""
        return self.actors.tensors("actors")

    def inputs(self, batch: Batch) -> tuple[Inputs, Inputs]:
        """Return the networks' inputs of the batch, and those of what followed, where no action is known yet."""
        return self._inputs.fill(batch.observation, batch.action), self._next_inputs.fill(batch.next_observation)

    def td_target(self, batch: Batch, next_value: Tensor) -> Tensor:
        """Return Y_i = reward_scale r_i + discount (1 - terminated) V_i(o'), [agents, B], given V [agents, B]."""
        continuation = (1.0 - batch.terminated) * self.config.discount
        return torch.addcmul(batch.reward.t() * self.config.reward_scale, next_value, continuation)

    def critic_loss(self, q: Tensor, target: Tensor) -> Tensor:
        """Return the loss [] of values q, [agents, B] or [critics, agents, B], for their targets Y [agents, B]."""
        return (q - target).square().mean(dim=-1).sum()


class ActorCritic(Algorithm[C]):
    """An algorithm with critics beside its actors.

    Args:
        config: its configuration.
        team: the layout of the team.
        seed: seed of the run, from which every initialisation follows.
        like: a tensor of the wanted device and type.
        cores: processor cores for the compiled kernels; 0 to compute by torch.

    Attributes:
        critics_each: critics of one agent.
        objective_critics: how many of these the actors' objective takes.
        critics: the agents' own critics and their targets.
    """

    critics_each: ClassVar[int] = 1
    objective_critics: ClassVar[int] = 1

    def __init__(self, config: C, team: TeamSpec, seed: int, like: Tensor, *, cores: int) -> None:
        super().__init__(config, team, seed, like, cores=cores)
        counts = {"each": self.critics_each, "objective": self.objective_critics}
        self.critics = Critics(config, team, seed, like, **counts, cores=cores)

    def retune(self, config: C) -> None:
        """See `Algorithm`."""
        super().retune(config)
        self.critics.set_rate(config.critic_rate)

    def tensors(self) -> dict[str, Tensor]:
        """See `Algorithm`."""
        return super().tensors() | self.critics.tensors("critics")

    def measured(self, q_value: Tensor, objective: Tensor, target: Tensor) -> Diagnostics:
        """Return the diagnostics that all of them have, after the update's steps; arguments are [agents, B]."""
        q_value, objective = q_value.detach(), objective.detach()
        critic_norms = self.critics.norms.view(self.critics.each, -1).mean(dim=0)
        return Diagnostics(q_value - target, objective, target, q_value, critic_norms, self.actors.norms)
