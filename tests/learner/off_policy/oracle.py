"""The update once more, agent by agent: autograd, one module a network, torch's own Adam, straight from the text.

The equations are those of the paper with readings A4 to A12; nothing here is shared with the engine except the order
of the numbers in a parameter vector.
"""

import copy

import torch
from torch import Tensor, nn

from eia_sec.common.config import AlgorithmConfig
from eia_sec.common.team import TeamSpec


class Network(nn.Module):
    """A perceptron with two hidden ReLU layers, filled from a flat vector W1, b1, W2, b2, W3, b3 (input-major)."""

    def __init__(self, flat: Tensor, inputs: int, hidden: int, outputs: int, squash: bool) -> None:
        super().__init__()
        self.squash, self.norm = squash, 0.0
        self.layers = nn.ModuleList([nn.Linear(a, b) for a, b in self._sizes(inputs, hidden, outputs)]).to(flat.dtype)
        start = 0
        with torch.no_grad():
            for layer in self.layers:
                size = layer.weight.numel()
                layer.weight.copy_(flat[start : start + size].view(layer.in_features, layer.out_features).T)
                layer.bias.copy_(flat[start + size : start + size + layer.out_features])
                start += size + layer.out_features

    @staticmethod
    def _sizes(inputs: int, hidden: int, outputs: int) -> list[tuple[int, int]]:
        return [(inputs, hidden), (hidden, hidden), (hidden, outputs)]

    def forward(self, x: Tensor) -> Tensor:
        x = torch.relu(self.layers[1](torch.relu(self.layers[0](x))))
        x = self.layers[2](x)
        return torch.tanh(x) if self.squash else x.squeeze(-1)

    def flat(self) -> Tensor:
        return torch.cat([p for layer in self.layers for p in (layer.weight.T.reshape(-1), layer.bias)]).detach()


def follow(target: nn.Module, source: nn.Module, rate: float) -> None:
    """Move the target's parameters towards the source's: t <- rate s + (1 - rate) t."""
    with torch.no_grad():
        for t, s in zip(target.parameters(), source.parameters(), strict=True):
            t.copy_(rate * s + (1 - rate) * t)


class Oracle:
    """All agents of a team, one by one.

    `actors` and `critics` hold one network for each agent in team order, `members` a list of k_s for each type.
    """

    def __init__(
        self,
        config: AlgorithmConfig,
        team: TeamSpec,
        actors: list[Tensor],
        critics: list[Tensor],
        members: list[Tensor],
    ) -> None:
        self.config, self.team, h = config, team, config.hidden
        self.kind = [v for v, group in enumerate(team.groups) for _ in range(group.count)]
        width = [self._width(v) for v in range(len(team.groups))]
        sizes = [(g.observation_size, h, g.action_size) for g in team.groups]
        flat = [row for stack in actors for row in stack]
        self.actors = [Network(f, *sizes[v], squash=True) for f, v in zip(flat, self.kind, strict=True)]
        flat = [row for stack in critics for row in stack]
        self.critics = [Network(f, width[v], h, 1, squash=False) for f, v in zip(flat, self.kind, strict=True)]
        self.members = [[Network(f, width[v], h, 1, squash=False) for f in stack] for v, stack in enumerate(members)]
        self.target_actors = copy.deepcopy(self.actors)
        self.target_critics = copy.deepcopy(self.critics)
        self.target_members = copy.deepcopy(self.members)
        trained = [*self.critics, *(m for group in self.members for m in group)]
        self.critic_optimiser = torch.optim.Adam([p for n in trained for p in n.parameters()], lr=config.critic_rate)
        self.actor_optimiser = torch.optim.Adam([p for n in self.actors for p in n.parameters()], lr=config.actor_rate)

    def _width(self, v: int) -> int:
        if self.config.joint_critics:
            return self.team.observation_size + self.team.action_size
        return self.team.groups[v].observation_size + self.team.groups[v].action_size

    def split(self, row: Tensor, size: str) -> list[Tensor]:
        """Cut rows [B, all] into one tensor for each agent."""
        return list(row.split([getattr(g, size) for g in self.team.groups for _ in range(g.count)], dim=1))

    def view(self, agent: int, observations: list[Tensor], actions: list[Tensor]) -> Tensor:
        """Return what the critic of an agent sees."""
        own = [observations[agent], actions[agent]]
        if not self.config.joint_critics:
            return torch.cat(own, dim=1)
        kind = self.kind[agent]
        peers = [j for j, v in enumerate(self.kind) if v == kind and j != agent]
        seen = own + [observations[j] for j in peers] + [actions[j] for j in peers]
        for other in range(len(self.team.groups)):
            if other != kind:
                agents = [j for j, v in enumerate(self.kind) if v == other]
                seen += [observations[j] for j in agents] + [actions[j] for j in agents]
        return torch.cat(seen, dim=1)

    def mix(self, local: Tensor, members: list[Network], x: Tensor, mixture: bool) -> Tensor:
        """Return Q_P, or Q_i alone."""
        if not (mixture and members):
            return local
        epsilon = self.config.mixture_epsilon
        return epsilon * local + (1 - epsilon) * sum(m(x) for m in members) / len(members)

    def update(self, batch) -> None:
        """Do one update."""
        observations = self.split(batch.observation, "observation_size")
        actions = self.split(batch.action, "action_size")
        following = self.split(batch.next_observation, "observation_size")
        targets = self._targets(batch, following)
        self._critic_step(observations, actions, targets)
        self._copy()
        for target, source in zip(self.target_critics, self.critics, strict=True):
            follow(target, source, self.config.target_rate)
        for group, sources in zip(self.target_members, self.members, strict=True):
            for target, source in zip(group, sources, strict=True):
                follow(target, source, self.config.target_rate)
        self._actor_step(observations, actions)

    def _targets(self, batch, following: list[Tensor]) -> list[Tensor]:
        config = self.config
        with torch.no_grad():
            decided = [actor(o) for actor, o in zip(self.actors, following, strict=True)]
            targets = []
            for i, critic in enumerate(self.target_critics):
                x = self.view(i, following, decided)
                value = self.mix(critic(x), self.target_members[self.kind[i]], x, config.bootstrap == "mixture")
                going_on = config.discount * (1 - batch.terminated)
                targets.append(config.reward_scale * batch.reward[:, i] + going_on * value)
        return targets

    def _critic_step(self, observations: list[Tensor], actions: list[Tensor], targets: list[Tensor]) -> None:
        config = self.config
        views = [self.view(i, observations, actions) for i in range(len(self.kind))]
        for network in [*self.critics, *(m for group in self.members for m in group)]:
            network.zero_grad()
        for i, critic in enumerate(self.critics):
            mixture = config.ensemble_loss == "mixture"
            frozen = copy.deepcopy(self.members[self.kind[i]])
            prediction = self.mix(critic(views[i]), frozen, views[i], mixture)
            (prediction - targets[i]).square().mean().backward()
        for v, group in enumerate(self.members):
            if not config.ensemble_gradient:
                break
            agents = [i for i, kind in enumerate(self.kind) if kind == v]
            if config.ensemble_loss == "mixture":
                losses = [
                    (self.mix(self.critics[i](views[i]).detach(), group, views[i], True) - targets[i]).square().mean()
                    for i in agents
                ]
                (sum(losses) / len(agents)).backward()
            else:
                x, y = torch.cat([views[i] for i in agents]), torch.cat([targets[i] for i in agents])
                for member in group:
                    (member(x) - y).square().mean().backward()
        if not config.ensemble_gradient:
            for group in self.members:
                for member in group:
                    member.zero_grad(set_to_none=True)
        self.clip(self.critics)
        if config.ensemble_gradient:
            self.clip([member for group in self.members for member in group])
        self.critic_optimiser.step()

    def clip(self, networks) -> None:
        """Note the norm of each network's gradient, and clip the gradient by it."""
        for network in networks:
            network.norm = float(torch.cat([p.grad.flatten() for p in network.parameters()]).norm())
            if self.config.gradient_clip > 0:
                for p in network.parameters():
                    p.grad *= min(1.0, self.config.gradient_clip / network.norm)

    def _copy(self) -> None:
        tau = self.config.ensemble_copy_rate
        for i, critic in enumerate(self.critics):
            group = self.members[self.kind[i]]
            for k, member in enumerate(group, start=1):
                follow(member, critic, tau * k / len(group))

    def _actor_step(self, observations: list[Tensor], actions: list[Tensor]) -> None:
        config = self.config
        self.actor_optimiser.zero_grad()
        losses = []
        for i, actor in enumerate(self.actors):
            x = self.view(i, observations, [*actions[:i], actor(observations[i]), *actions[i + 1 :]])
            mixture = config.actor_objective == "mixture"
            losses.append(-self.mix(self.critics[i](x), self.members[self.kind[i]], x, mixture).mean())
        parameters = [p for actor in self.actors for p in actor.parameters()]
        for p, g in zip(parameters, torch.autograd.grad(sum(losses), parameters), strict=True):
            p.grad = g
        self.clip(self.actors)
        self.actor_optimiser.step()
