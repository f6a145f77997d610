"""The interface of off-policy algorithms, and the steps that they share.

An algorithm is one class in a file of this folder: its networks, and one update of all of them from a batch of replay.
The engine calls

    for number in itertools.count(1):
        algorithm.update(batch, noise, actor_step=number % period == 0, diagnostics=False)

An update has no branch that depends on data, so that each kind of update can be captured as a CUDA graph.

Gradients are written out, because that is what is fast (`python -m research.benchmarks.autograd`). A forward pass
returns values together with what its gradients take; the gradient of a forward pass that another one has overwritten is
refused.
"""

from abc import ABC, abstractmethod
from typing import ClassVar, Generic, NamedTuple, TypeVar

import torch
from torch import Tensor

from eia_sec.common.actors import Head
from eia_sec.common.config import OffPolicyConfig
from eia_sec.common.team import TeamSpec
from eia_sec.learner.networks.optimiser import Adam
from eia_sec.learner.off_policy.actors import Actors
from eia_sec.learner.off_policy.critics import Critics, QValues
from eia_sec.learner.off_policy.inputs import Inputs, action_layout, action_views

C = TypeVar("C", bound=OffPolicyConfig)


class Batch(NamedTuple):
    """B transitions of the whole team, on the engine's device; each spans m steps, 1 <= m <= n.

    Attributes:
        observation: rows [B, O].
        action: rows [B, A].
        reward: [B, agents], sum_{k < m} gamma^k r_{t+k}.
        next_observation: rows [B, O], m steps later.
        terminated: [B], 1 where nothing is bootstrapped from the next observation, else 0.
        discount: [B], gamma^m.
    """

    observation: Tensor
    action: Tensor
    reward: Tensor
    next_observation: Tensor
    terminated: Tensor
    discount: Tensor


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
    """

    td_error: Tensor
    objective: Tensor
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
        critics_each: critics of one agent.
        objective_critics: how many of these the actors' objective takes.
        noise_blocks: standard normal numbers that an update takes, in action layouts.
        phi: parameters of all critics [P].
        target_phi: those of the target critics [P].
        gradient: the newest gradient of the critics' losses [P].
    """

    head: ClassVar[Head] = "deterministic"
    critics_each: ClassVar[int] = 1
    objective_critics: ClassVar[int] = 1
    noise_blocks: ClassVar[int] = 0

    def __init__(self, config: C, team: TeamSpec, seed: int, like: Tensor, *, cores: int) -> None:
        self.config, self.team, self.like, self.cores = config, team, like, cores
        self._inputs, self._next_inputs = (
            Inputs(team, config.batch, config.joint_critics, like, pooled=config.uses_ensemble) for _ in range(2)
        )
        self.actors = Actors(config, team, like, head=self.head, target=self.has_target_actors(), cores=cores)
        self.actors.initialise(seed)
        self.critics = Critics(
            config, team, like, each=self.critics_each, objective=self.objective_critics, cores=cores
        )
        self._action_gradient = like.new_zeros(config.batch * team.action_size)
        self._action_gradient_views = action_views(team, config.batch, self._action_gradient)
        self._action_layout = action_layout(team)
        self._team_action_gradient = like.new_zeros(config.batch, team.action_size)
        self._build_critics(seed)

    def _build_critics(self, seed: int) -> None:
        size = self.critics.networks.size
        self._allocate(size)
        self.critics.initialise(self.phi, seed)
        self.target_phi.copy_(self.phi)
        self.critic_adam = self._critic_optimiser(size, self.critics.networks.segments())

    def _allocate(self, size: int) -> None:
        """Create the critics' flat vectors [size], whose first numbers are those of `critics`."""
        self.phi, self.target_phi, self.gradient = (self.like.new_zeros(size) for _ in range(3))
        local = self.critics.networks.size
        self._critic_parameters, self._target_parameters, self._critic_gradient = (
            self.critics.networks.parameters(flat[:local]) for flat in (self.phi, self.target_phi, self.gradient)
        )
        self._objective_parameters = self.critics.objective_networks.parameters(self.phi[:local])

    def _critic_optimiser(self, size: int, networks: Tensor) -> Adam:
        """Return Adam for the first numbers of `phi`; `networks` [size] says which network each belongs to."""
        config = self.config
        return Adam(
            self.phi[:size], config.critic_rate, cores=self.cores, clip=config.gradient_clip, networks=networks[:size]
        )

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
        adam = self.critic_adam
        return {
            **self.actors.tensors(),
            "critics": self.phi,
            "target_critics": self.target_phi,
            "critic_mean": adam.mean,
            "critic_square": adam.square,
            "critic_steps": adam.steps,
        }

    def inputs(self, batch: Batch) -> tuple[Inputs, Inputs]:
        """Return the networks' inputs of the batch, and those of what followed, where no action is known yet."""
        return self._inputs.fill(batch.observation, batch.action), self._next_inputs.fill(batch.next_observation)

    def td_target(self, batch: Batch, next_value: Tensor) -> Tensor:
        """Return Y_i = reward_scale r_i + discount (1 - terminated) V_i(o'), [agents, B], given V [agents, B]."""
        continuation = (1.0 - batch.terminated) * batch.discount
        return torch.addcmul(batch.reward.t() * self.config.reward_scale, next_value, continuation)

    def critic_gradient(self, inputs: Inputs, target: Tensor) -> tuple[Tensor, Tensor]:
        """Differentiate the loss sum_k mean_B (Q_k,i - Y_i)^2 of every agent's critics.

        Returns:
            Q_k,i - Y_i [k, agents, B], and the gradient [P].
        """
        q = self.critics.q_values(self._critic_parameters, inputs)
        td_error = q.values - target
        self.critics.parameter_gradient(q, td_error * (2.0 / self.config.batch), self._critic_gradient)
        return td_error, self.gradient

    def objective_q_values(self, inputs: Inputs, actions: Tensor) -> QValues:
        """Return Q_k,i of the actors' actions, [k, agents, B].

        In the joint scope the other agents act as `others` says: as in the batch, or by their policies as well.
        """
        if self.config.follows_policies:
            return self.critics.objective_q_values(self._objective_parameters, inputs.with_actions(actions))
        return self.critics.objective_q_values(self._objective_parameters, inputs, inputs.action_change(actions))

    def action_gradient(self, q: QValues, upstream: Tensor) -> Tensor:
        """Return the gradient of sum(upstream * Q) by the actors' actions, in the action layout.

        Each critic's gradient is taken by its own agent's action. Where the actors share one objective
        (`others = "team"`), all critics' gradients by an action add up.
        """
        gradient = self._action_gradient.zero_()
        if not self.config.team_objective:
            self.critics.action_gradient(q, upstream, self._action_gradient_views)
            return gradient
        rows = self._team_action_gradient.zero_()
        shared = [rows.expand(group.count, *rows.shape) for group in self.team.groups]
        self.critics.action_gradient(q, upstream, shared)
        for view, part in zip(self._action_gradient_views, self._action_layout.by_agent(rows), strict=True):
            view.copy_(part)
        return gradient

    def measured(self, td_error: Tensor, objective: Tensor, target: Tensor) -> Diagnostics:
        """Return the diagnostics that all algorithms have, after the update's steps."""
        norms = self.critic_adam.norms
        if norms is None:
            norms = self.critics.networks.norms(self._critic_gradient.flat)
        each, agents = self.critics.each, self.team.agents
        critic_norms = norms[: each * agents].view(each, agents).mean(dim=0)
        return Diagnostics(td_error, objective, target, td_error + target, critic_norms, self.actors.gradient_norms())
