"""What every algorithm is to the engine, and what they share.

An algorithm is one class in `learner/algorithms`. The engine calls

    for number in count():
        diagnostics = algorithm.update(batch, noise, algorithm.phase(number))

An update has no branch that depends on data, so that each phase can be captured as one graph.

The targets of all algorithms are Y_i = reward_scale r_i + discount (1 - terminated) V_i(o'), where `discount` is the
batch's, gamma^m for its m steps.
"""

from abc import ABC, abstractmethod
from typing import ClassVar, NamedTuple

import torch
from torch import Tensor

from common.actors import Head
from common.config import AlgorithmConfig
from common.team import TeamSpec
from learner.algorithms.actors import Actors
from learner.algorithms.critics import Critics
from learner.networks.inputs import Inputs, action_views
from learner.networks.optimiser import Adam


class Batch(NamedTuple):
    """B transitions of the whole team, on the engine's device; each goes m steps on, 1 <= m <= n.

    Attributes:
        observation: rows [B, O].
        action: rows [B, A].
        reward: [B, agents], sum_{k < m} gamma^k r_{t+k}.
        next_observation: rows [B, O], m steps on.
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
    """What one update can report; None is what the algorithm does not have. Norms are those before any clip.

    Attributes:
        error: the (first) critics' errors before their step, [agents, B].
        value: what the actors climb, [agents, B].
        target: Y [agents, B].
        prediction: Q of the batch's own actions before the step [agents, B]: Q_P, or the (first) critics' values.
        critic_gradient: norm of the newest gradient of each agent's critic [agents], mean over its critics.
        actor_gradient: norm of each actor's newest gradient [agents].
        spread: standard deviation of the SEC members' values at the actors' actions [agents, B].
        member_loss: mean over the members and the agent's rows of (Q_s,k - Y)^2 before the step [agents].
        member_gradient: norm of a member's newest gradient, mean over the members of the agent's type [agents].
        temperature: alpha [agents].
        log_probability: log pi of the actions that the actors drew, mean over the batch [agents].
        soft: whether values and targets count entropy beside rewards, so that no sum of rewards compares.
    """

    error: Tensor
    value: Tensor
    target: Tensor
    prediction: Tensor
    critic_gradient: Tensor | None = None
    actor_gradient: Tensor | None = None
    spread: Tensor | None = None
    member_loss: Tensor | None = None
    member_gradient: Tensor | None = None
    temperature: Tensor | None = None
    log_probability: Tensor | None = None
    soft: bool = False


class Algorithm(ABC):
    """One algorithm's networks and update.

    Args:
        config: its configuration.
        team: the layout of the team.
        seed: seed of the run; every initialisation follows from it.
        like: a tensor of the wanted device and type.
        cores: processor cores to compute on by compiled kernels; 0 to compute by torch.

    Attributes:
        head: kind of the actors' last layer.
        critics_each: critics of one agent.
        climbed_each: how many of these the actors climb.
        noise_blocks: standard normal numbers that an update takes, in action layouts.
    """

    head: ClassVar[Head] = "deterministic"
    critics_each: ClassVar[int] = 1
    climbed_each: ClassVar[int] = 1
    noise_blocks: ClassVar[int] = 0

    def __init__(self, config: AlgorithmConfig, team: TeamSpec, seed: int, like: Tensor, *, cores: int) -> None:
        self.config, self.team, self.like, self.cores = config, team, like, cores
        joint = config.joint_critics
        pooled = config.uses_ensemble
        self.current = Inputs(team, config.batch, joint, like, cores=cores, views=pooled)
        self.next = Inputs(team, config.batch, joint, like, cores=cores, views=pooled)
        self.actors = Actors(config, team, like, head=self.head, target=self.has_target_actors(), cores=cores)
        self.actors.initialise(seed)
        self.critics = Critics(config, team, like, each=self.critics_each, climbed=self.climbed_each, cores=cores)
        self.change = like.new_zeros(config.batch * team.action_size)
        self.slopes = like.new_zeros(config.batch * team.action_size)
        self.change_views = action_views(team, config.batch, self.change)
        self.slope_views = action_views(team, config.batch, self.slopes)
        self._team_slopes = like.new_zeros(config.batch, team.action_size)
        self._allocate_critics(seed)

    def _allocate_critics(self, seed: int) -> None:
        size = self.critics.networks.size
        self.phi, self.target_phi, self.critic_gradient = (self.like.new_zeros(size) for _ in range(3))
        self.critics.initialise(self.phi, seed)
        self.target_phi.copy_(self.phi)
        self.critic_views, self.target_views, self.gradient_views = (
            self.critics.networks.parameters(flat) for flat in (self.phi, self.target_phi, self.critic_gradient)
        )
        self.climbed_views = self.critics.climbed_networks.parameters(self.phi)
        self.critic_adam = Adam(
            self.phi,
            self.critic_gradient,
            self.config.critic_rate,
            cores=self.cores,
            clip=self.config.gradient_clip,
            networks=self.critics.networks.segments(),
        )

    def has_target_actors(self) -> bool:
        """Return whether next actions are chosen by target actors."""
        return False

    @classmethod
    def phases(cls, config: AlgorithmConfig) -> int:
        """Return after how many updates the kind of update repeats; in one of so many the actors step."""
        return 1

    def phase(self, number: int) -> int:
        """Return which kind of update the update of this number is; 0 where all are alike."""
        return 0

    @abstractmethod
    def update(self, batch: Batch, noise: Tensor, phase: int, *, diagnostics: bool) -> Diagnostics | None:
        """Do one update; return its diagnostics where asked for.

        Args:
            batch: the transitions.
            noise: [noise_blocks, sum n_v * B * a_v] standard normal numbers, each block in the action layout.
            phase: see `phase`.
            diagnostics: whether to return diagnostics; changes nothing else.
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

    def diagnosed(self, error: Tensor, value: Tensor, target: Tensor) -> Diagnostics:
        """Return the diagnostics that all algorithms report, after the update's steps."""
        norms = self.critic_adam.norms
        if norms is None:
            norms = self.critics.networks.norms(self.gradient_views.flat)
        each, agents = self.critics.each, self.team.agents
        critic = norms[: each * agents].view(each, agents).mean(dim=0)
        return Diagnostics(error, value, target, error + target, critic, self.actors.norms())

    def observe(self, batch: Batch) -> None:
        """Bring a batch into the networks' inputs."""
        self.current.observe(batch.observation)
        self.current.act(batch.action)
        self.next.observe(batch.next_observation)

    def bootstrapped(self, batch: Batch, value: Tensor) -> Tensor:
        """Return Y [agents, B] from the value of what follows."""
        going_on = (1.0 - batch.terminated) * batch.discount
        return torch.addcmul(batch.reward.t() * self.config.reward_scale, value, going_on)

    def regress(self, target: Tensor) -> Tensor:
        """Write the gradient of mean_B (Q_k,i - Y_i)^2 of every critic; return the errors [k, agents, B]."""
        error = self.critics.forward(self.critic_views, self.current) - target
        upstream = error * (2.0 / self.config.batch)
        self.critics.parameter_gradient(self.critic_views, self.current, upstream, self.gradient_views)
        return error

    def choose(self) -> Tensor:
        """Return the deterministic actors' actions for the batch in the action layout, and note how they differ."""
        action = self.actors.forward(self.current.actor).tanh_()
        torch.sub(action, self.current.acted, out=self.change)
        return action

    def appraise(self, action: Tensor) -> Tensor:
        """Return the climbed critics' values [k, agents, B] of the actors' actions, from which `change` was made."""
        if self.config.others != "batch" and self.config.joint_critics:
            self.current.decide(action)
            return self.critics.appraise(self.climbed_views, self.current)
        return self.critics.appraise(self.climbed_views, self.current, self.change_views)

    def slope(self, upstream: Tensor) -> None:
        """Write the gradient of sum(upstream * value) by the actors' actions into `slopes`, after `appraise`."""
        self.slopes.zero_()
        if not self.config.climbs_together:
            self.critics.action_gradient(self.climbed_views, upstream, self.slope_views)
            return
        rows = self._team_slopes.zero_()
        shared = [rows.expand(group.count, *rows.shape) for group in self.team.groups]
        self.critics.action_gradient(self.climbed_views, upstream, shared)
        for view, part in zip(self.slope_views, self.team.action_slices(), strict=True):
            view.copy_(torch.unflatten(rows[:, part], 1, (view.shape[0], -1)).transpose(0, 1))

    def climb(self, action: Tensor) -> None:
        """Take the actors' step, given the loss's `slopes` by their `action` = tanh(output)."""
        upstream = torch.addcmul(self.slopes, self.slopes * action, action, value=-1.0)
        self.actors.descend(self.current.actor, upstream)
