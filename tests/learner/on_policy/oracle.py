"""PPO once more, agent by agent, in the plain style of CleanRL's ppo.py: modules, loops, torch.distributions, Adam.

Nothing is shared with the trainer except the names of its tensors in a checkpoint, from which the networks begin, and
the random order of the steps.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn
from torch.distributions import Categorical, Normal
from torch.distributions.transforms import TanhTransform

from eia_sec.common.config import OnPolicyConfig
from eia_sec.common.seeds import stream
from eia_sec.common.team import GroupSpec, TeamSpec
from eia_sec.common.transitions import TERMINATED, TRANSITION, TRUNCATED, Rows


def network(tensors: dict[str, Tensor], name: str, index: int) -> nn.Sequential:
    """Return a perceptron with the parameters of one network of a stack."""
    layers: list[nn.Module] = []
    for layer in range(0, 6, 2):
        weight, bias = (tensors[f"networks.{name}.layers.{layer + part}"][index] for part in range(2))
        linear = nn.Linear(*weight.shape)
        with torch.no_grad():
            linear.weight.copy_(weight.T)
            linear.bias.copy_(bias)
        layers += [linear, nn.ReLU()]
    return nn.Sequential(*layers[:-1])


def flat(module: nn.Sequential) -> Tensor:
    """Return the parameters in the order of `eia_sec.common.actors`."""
    linear = [layer for layer in module if isinstance(layer, nn.Linear)]
    return torch.cat([p for layer in linear for p in (layer.weight.T.reshape(-1), layer.bias)]).detach()


@dataclass
class Agent:
    """One agent: its networks, which it may share with others, and its steps."""

    group: GroupSpec
    place: int
    """Its index in the team."""
    index: int
    """Its index in its type."""
    actor: nn.Module
    local: nn.Module | None
    members: list[nn.Module]
    gamma: float
    data: dict[str, Tensor] = field(default_factory=dict)
    weight: Tensor = field(default_factory=lambda: torch.ones(()))
    """pi_newest / pi_behaviour of its steps, at most 2."""

    @property
    def values(self) -> list[nn.Module]:
        """Its value functions."""
        return [*self.members, *([] if self.local is None else [self.local])]


class Oracle:
    """All agents of a team.

    Attributes:
        agents: the agents in team order.
        stopped: types whose actors have stopped in the iteration.
        clipped: how many gradients were shortened.
    """

    network: Callable[[dict[str, Tensor], str, int], nn.Module] = staticmethod(network)

    def __init__(self, config: OnPolicyConfig, team: TeamSpec, seed: int, tensors: dict[str, Tensor]) -> None:
        self.config, self.team = config, team
        self.random = stream(seed, "minibatches")
        self.stopped: set[str] = set()
        self.clipped = 0
        self.agents: list[Agent] = []
        for kind, group in enumerate(team.groups):
            self._add(kind, group, tensors)
        self.actors = unique([agent.actor for agent in self.agents])
        self.values = unique([v for agent in self.agents for v in agent.values])
        parameters = [
            {"params": [p for module in modules for p in module.parameters()], "lr": rate}
            for modules, rate in ((self.actors, config.actor_rate), (self.values, config.critic_rate))
        ]
        self.adam = torch.optim.Adam(parameters, eps=1e-5)

    def _add(self, kind: int, group: GroupSpec, tensors: dict[str, Tensor]) -> None:
        config = self.config
        copies = 1 if config.shared else group.count
        actors = [self.network(tensors, f"actors.types.{kind}", index) for index in range(copies)]
        part = ".local.network" if config.ensemble_size else ".network"
        locals_: list[nn.Module | None] = (
            [self.network(tensors, f"values.{kind}{part}", index) for index in range(1 if config.sees_team else copies)]
            if not (config.ensemble_size and config.shared)
            else [None]
        )
        members = [self.network(tensors, f"values.{kind}.members.{k}", 0) for k in range(config.ensemble_size)]
        gamma = {"b": 0.5}.get(group.name, config.discount)
        for index in range(group.count):
            actor, local = actors[index % copies], locals_[index % len(locals_)]
            self.agents.append(Agent(group, len(self.agents), index, actor, local, members, gamma))

    def value(self, agent: Agent, module: nn.Module, own: Tensor, team: Tensor) -> Tensor:
        if self.config.sees_team:
            return module(team)[:, agent.index]
        return module(own)[:, 0]

    def mixture(self, agent: Agent, own: Tensor, team: Tensor) -> Tensor:
        local = None if agent.local is None else self.value(agent, agent.local, own, team)
        if not agent.members:
            assert local is not None
            return local
        shared = torch.stack([self.value(agent, member, own, team) for member in agent.members]).mean(dim=0)
        if local is None:
            return shared
        epsilon = self.config.mixture_epsilon  # type: ignore[attr-defined]  # an ensemble means EiaPpoConfig
        return epsilon * local + (1 - epsilon) * shared

    def policy(self, agent: Agent, own: Tensor, action: Tensor) -> tuple[Tensor, Tensor]:
        """Return log pi(a | o) and the entropy."""
        outputs, group = agent.actor(own), agent.group
        if not group.choices:
            size = group.action_size
            normal = Normal(outputs[:, :size], outputs[:, size:].exp())
            return normal.log_prob(torch.atanh(action)).sum(1), squashed_entropy(normal).sum(1)
        if group.masked:
            outputs = torch.where(own[:, -group.options :] == 1, outputs, torch.tensor(-1e9))
        log_probability, entropy, start = torch.zeros(len(own)), torch.zeros(len(own)), 0
        for branch, options in enumerate(group.choices):
            part = Categorical(logits=outputs[:, start : start + options])
            log_probability = log_probability + part.log_prob(action[:, branch])
            entropy = entropy + part.entropy()
            start += options
        return log_probability, entropy

    def iteration(self, rows: Rows, progress: float) -> None:
        """Learn from an iteration's rows; `progress` is the finished share of the run."""
        config, flag = self.config, rows.flag
        if config.normalise_observations:
            rows = replace(rows, observation=scaled(self.team, rows.observation))
        self.stopped.clear()
        team = torch.from_numpy(rows.observation)
        used = np.flatnonzero(flag & TRANSITION)
        for agent in self.agents:
            self._prepare(agent, rows, team)
        if config.objective == "decoupled":
            for agent in self.agents:
                self._newest(agent)
        for group in self.team.groups if config.normalise_returns else ():
            mates = [agent for agent in self.agents if agent.group is group]
            every = torch.cat([agent.data["returns"][used] for agent in mates])
            for agent in mates:
                agent.data["returns"] = (agent.data["returns"] - every.mean()) / every.std(correction=0)
        for group in self.team.groups:
            mates = [agent for agent in self.agents if agent.group is group]
            every = torch.cat([agent.data["advantage"][used] for agent in mates])
            for agent in mates:
                centred = agent.data["advantage"] - every.mean()
                agent.data["advantage"] = centred / (every.std(correction=0) + 1e-8) * agent.weight
        share = 1 + (config.rate_end - 1) * progress
        for part, rate in zip(self.adam.param_groups, (config.actor_rate, config.critic_rate), strict=True):
            part["lr"] = rate * share
        weight = config.entropy_start * (1 - progress) + config.entropy_end * progress
        for _ in range(config.epochs):
            self._epoch(team, used, weight)

    def _prepare(self, agent: Agent, rows: Rows, team: Tensor) -> None:
        observations = self.team.split_observations(rows.observation)
        actions = self.team.split_actions(rows.action)
        kind = self.team.groups.index(agent.group)
        own = torch.from_numpy(observations[kind][:, agent.index].copy())
        assert rows.log_probability is not None
        reward = rows.reward[:, agent.place] * self.config.reward_scale
        with torch.no_grad():
            value = self.mixture(agent, own, team).numpy()
        advantage = self._gae(agent, reward, value, rows.flag)
        agent.data = {
            "own": own,
            "action": torch.from_numpy(actions[kind][:, agent.index].copy()),
            "sent": torch.from_numpy(rows.log_probability[:, agent.place].copy()),
            "advantage": torch.from_numpy(advantage),
            "returns": torch.from_numpy(advantage + value),
        }

    def _newest(self, agent: Agent) -> None:
        """Take ratios against the present actor."""
        with torch.no_grad():
            newest, _ = self.policy(agent, agent.data["own"], agent.data["action"])
        agent.weight = (newest - agent.data["sent"]).exp().clamp(max=2.0)
        agent.data["sent"] = newest

    def _gae(self, agent: Agent, reward: Any, value: Any, flag: Any) -> Any:
        advantage, last = np.zeros(len(flag), np.float32), 0.0
        for row in reversed(range(len(flag))):
            if not flag[row] & TRANSITION:
                last = 0.0
                continue
            over = flag[row] & TERMINATED or (flag[row] & TRUNCATED and self.config.time_limit == "terminal")
            nonterminal = 0.0 if over else 1.0
            delta = reward[row] + agent.gamma * value[row + 1] * nonterminal - value[row]
            last = delta + agent.gamma * self.config.gae_lambda * nonterminal * last
            advantage[row] = last
        return advantage

    def _epoch(self, team: Tensor, used: Any, weight: float) -> None:
        kl: dict[str, list[float]] = {group.name: [] for group in self.team.groups}
        for places in self._minibatches(used):
            here = torch.from_numpy(places)
            loss = torch.zeros(())
            for agent in self.agents:
                loss = loss + self._loss(agent, here, team[here], weight, kl) / agent.group.count
            self.adam.zero_grad()
            loss.backward()
            self._clip()
            self.adam.step()
        for name, found in kl.items():
            if self.config.target_kl and found and np.mean(found) > self.config.target_kl:
                self.stopped.add(name)

    def _minibatches(self, used: Any) -> Any:
        """Return the rows of each minibatch of an epoch."""
        return np.array_split(self.random.permutation(used), round(len(used) / self.config.minibatch_steps))

    def _loss(self, agent: Agent, here: Tensor, team: Tensor, weight: float, kl: dict[str, list[float]]) -> Tensor:
        own, action, sent, advantage, returns = (part[here] for part in agent.data.values())
        loss = torch.zeros(())
        for module in agent.values:
            error = self.value(agent, module, own, team) - returns
            if module in agent.members:
                error = error[self._learnt(agent.members.index(module), len(agent.members), len(here))]
            loss = loss + (error**2).mean()
        if agent.group.name in self.stopped:
            return loss
        log_probability, entropy = self.policy(agent, own, action)
        logratio = log_probability - sent
        ratio, scale = logratio.exp(), {"b": 0.25}.get(agent.group.name, 1.0)
        kl[agent.group.name].append(float(((ratio - 1) - logratio).mean().detach()))
        return loss - self.surrogate(ratio, advantage).mean() - weight * scale * entropy.mean()

    def surrogate(self, ratio: Tensor, advantage: Tensor) -> Tensor:
        """Return what the actor maximises besides its entropy, of each row."""
        clipped = torch.clamp(ratio, 1 - self.config.clip, 1 + self.config.clip)
        return torch.min(advantage * ratio, advantage * clipped)

    def _learnt(self, member: int, members: int, rows: int) -> Any:
        """Return the places in a minibatch from which a member of an ensemble learns."""
        return [place for place in range(rows) if place % members == member]

    def _clip(self) -> None:
        """Limit the gradient of a type's actors, and that of its value functions."""
        for group in self.team.groups if self.config.gradient_clip else ():
            mates = [agent for agent in self.agents if agent.group is group]
            actors = unique([agent.actor for agent in mates])
            values = unique([v for agent in mates for v in agent.values])
            for modules in (actors, values):
                parameters = [p for module in modules for p in module.parameters()]
                norm = nn.utils.clip_grad_norm_(parameters, self.config.gradient_clip)
                self.clipped += bool(norm > self.config.gradient_clip)


def scaled(team: TeamSpec, observation: Any) -> Any:
    """Return rows of a first iteration minus their mean over their deviation, or a tenth of the farthest distance."""
    found = observation.astype(np.float64)
    for group, own in zip(team.groups, team.split_observations(found), strict=True):
        part = own[..., : -group.options] if group.masked else own
        part -= part.mean(axis=(0, 1))
        part /= np.maximum(part.std(axis=(0, 1)), np.abs(part).max(axis=(0, 1)) / 10)
    return found.astype(np.float32)


def squashed_entropy(normal: Normal) -> Tensor:
    """Return the entropy after a tanh: H(u) + E[ln |d tanh(u) / du|], the expectation by quadrature."""
    nodes, weights = np.polynomial.hermite.hermgauss(9)
    u = normal.mean[..., None] + normal.stddev[..., None] * np.sqrt(2.0) * normal.mean.new_tensor(nodes)
    slope = TanhTransform().log_abs_det_jacobian(u, torch.tanh(u))
    return normal.entropy() + (slope * normal.mean.new_tensor(weights / np.sqrt(np.pi))).sum(-1)


def unique(modules: list[nn.Module]) -> list[nn.Module]:
    """Return each module once, in the order of their first places."""
    return list(dict.fromkeys(modules))
