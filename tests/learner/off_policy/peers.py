"""MADDPG, MATD3 and MASAC once more, agent by agent: autograd, one module a network, torch's own Adam.

Straight from the papers' equations; shared with the engine are the order of the numbers in a parameter vector and the
standard normal numbers of an update.
"""

import copy
import math

import torch
from torch import Tensor
from torch.distributions import Normal, TransformedDistribution
from torch.distributions.transforms import TanhTransform

from tests.learner.off_policy.oracle import Network, Oracle, follow


class Peer(Oracle):
    """All agents of a team, one by one; `critics[k][i]` is the k-th critic of agent i."""

    each = 1
    gaussian = False

    def __init__(self, config, team, actors: list[Tensor], critics: list[list[Tensor]]) -> None:
        self.config, self.team, h = config, team, config.hidden
        self.kind = [v for v, group in enumerate(team.groups) for _ in range(group.count)]
        heads = 2 if self.gaussian else 1
        flat = [row for stack in actors for row in stack]
        self.actors = [
            Network(f, team.groups[v].observation_size, h, heads * team.groups[v].action_size, not self.gaussian)
            for f, v in zip(flat, self.kind, strict=True)
        ]
        self.critics = [
            [
                Network(f, self._width(v), h, 1, squash=False)
                for f, v in zip([row for stack in stacks for row in stack], self.kind, strict=True)
            ]
            for stacks in critics
        ]
        self.target_actors, self.target_critics = copy.deepcopy(self.actors), copy.deepcopy(self.critics)
        agents = range(len(self.kind))
        self.actor_optimisers = [torch.optim.Adam(a.parameters(), lr=config.actor_rate) for a in self.actors]
        self.critic_optimisers = [
            torch.optim.Adam([p for c in self.critics for p in c[i].parameters()], lr=config.critic_rate)
            for i in agents
        ]
        self.updates = 0

    def noise(self, block: Tensor) -> list[Tensor]:
        """Cut a block in the action layout into one tensor [B, a] for each agent."""
        sizes = [self.team.groups[v].action_size for v in self.kind]
        parts = block.split([self.config.batch * size for size in sizes])
        return [part.view(self.config.batch, size) for part, size in zip(parts, sizes, strict=True)]

    def values(self, critics, observations, actions) -> list[Tensor]:
        """Return, for each agent, its critics' values [k, B]."""
        views = [self.view(i, observations, actions) for i in range(len(self.kind))]
        return [torch.stack([c[i](view) for c in critics]) for i, view in enumerate(views)]

    def update(self, batch, noise: Tensor) -> None:
        """Do one update."""
        observations = self.split(batch.observation, "observation_size")
        actions = self.split(batch.action, "action_size")
        following = self.split(batch.next_observation, "observation_size")
        with torch.no_grad():
            targets = [
                self.config.reward_scale * batch.reward[:, i] + self.config.discount * (1 - batch.terminated) * value
                for i, value in enumerate(self.bootstrap(following, noise))
            ]
        for i, (values, target) in enumerate(
            zip(self.values(self.critics, observations, actions), targets, strict=True)
        ):
            self.critic_optimisers[i].zero_grad()
            (values - target).square().mean(dim=1).sum().backward()
            self.clip([c[i] for c in self.critics])
            self.critic_optimisers[i].step()
        self.improve(observations, actions, noise)
        self.updates += 1

    def actor_step(self, i: int, loss: Tensor) -> None:
        """Take one step of actor i against the gradient of its loss."""
        self.actor_optimisers[i].zero_grad()
        for p, g in zip(
            self.actors[i].parameters(), torch.autograd.grad(loss, list(self.actors[i].parameters())), strict=True
        ):
            p.grad = g
        self.clip([self.actors[i]])
        self.actor_optimisers[i].step()

    def joint_actor_step(self, loss: Tensor) -> None:
        """Take one step of every actor against the gradient of one loss."""
        gradients = torch.autograd.grad(loss, [p for actor in self.actors for p in actor.parameters()])
        for p, g in zip((p for actor in self.actors for p in actor.parameters()), gradients, strict=True):
            p.grad = g
        for actor, optimiser in zip(self.actors, self.actor_optimisers, strict=True):
            self.clip([actor])
            optimiser.step()

    def follow_targets(self, actors: bool) -> None:
        for k, critics in enumerate(self.critics):
            for target, source in zip(self.target_critics[k], critics, strict=True):
                follow(target, source, self.config.target_rate)
        if actors:
            for target, source in zip(self.target_actors, self.actors, strict=True):
                follow(target, source, self.config.target_rate)


class MaddpgOracle(Peer):
    """Lowe et al., 2017."""

    def bootstrap(self, following, noise):
        decided = [actor(o) for actor, o in zip(self.target_actors, following, strict=True)]
        return [value[0] for value in self.values(self.target_critics, following, decided)]

    def improve(self, observations, actions, noise) -> None:
        if self.config.others == "team":
            chosen = [actor(o) for actor, o in zip(self.actors, observations, strict=True)]
            total = sum(self.critics[0][i](self.view(i, observations, chosen)).mean() for i in range(len(chosen)))
            self.joint_actor_step(-total)
            self.follow_targets(actors=True)
            return
        if self.config.others == "policy":
            with torch.no_grad():
                actions = [actor(o) for actor, o in zip(self.actors, observations, strict=True)]
        for i, actor in enumerate(self.actors):
            x = self.view(i, observations, [*actions[:i], actor(observations[i]), *actions[i + 1 :]])
            self.actor_step(i, -self.critics[0][i](x).mean())
        self.follow_targets(actors=True)


class Matd3Oracle(MaddpgOracle):
    """Ackermann et al., 2019."""

    each = 2

    def bootstrap(self, following, noise):
        config = self.config
        decided = []
        for actor, o, n in zip(self.target_actors, following, self.noise(noise[0]), strict=True):
            smooth = (config.smoothing_noise * n).clamp(-config.smoothing_clip, config.smoothing_clip)
            decided.append((actor(o) + smooth).clamp(-1, 1))
        return [value.min(dim=0).values for value in self.values(self.target_critics, following, decided)]

    def improve(self, observations, actions, noise) -> None:
        if (self.updates + 1) % self.config.actor_delay == 0:
            super().improve(observations, actions, noise)


class MasacOracle(Peer):
    """Haarnoja et al., 2018, for every agent."""

    each = 2
    gaussian = True

    def __init__(self, config, team, actors, critics) -> None:
        super().__init__(config, team, actors, critics)
        start = math.log(config.temperature)
        self.log_alpha = [torch.tensor(start, dtype=actors[0].dtype, requires_grad=True) for _ in self.kind]
        self.alpha_optimisers = [torch.optim.Adam([a], lr=config.temperature_rate) for a in self.log_alpha]

    def sample(self, actor, observation, noise):
        """Return an action and the logarithm of its density."""
        mean, log_std = actor(observation).reshape(observation.shape[0], -1).chunk(2, dim=1)
        std = log_std.clamp(-20, 2).exp()
        policy = TransformedDistribution(Normal(mean, std), TanhTransform(cache_size=1))
        before = mean + std * noise
        action = policy.transforms[0](before)
        return action, policy.log_prob(action).sum(dim=1)

    def bootstrap(self, following, noise):
        drawn = [
            self.sample(actor, o, n) for actor, o, n in zip(self.actors, following, self.noise(noise[0]), strict=True)
        ]
        values = self.values(self.target_critics, following, [action for action, _ in drawn])
        return [
            value.min(dim=0).values - log_alpha.exp() * density
            for value, log_alpha, (_, density) in zip(values, self.log_alpha, drawn, strict=True)
        ]

    def improve(self, observations, actions, noise) -> None:
        own = self.noise(noise[1])
        if self.config.others == "policy":
            with torch.no_grad():
                actions = [self.sample(*given)[0] for given in zip(self.actors, observations, own, strict=True)]
        if self.config.others == "team":
            drawn = [self.sample(*given) for given in zip(self.actors, observations, own, strict=True)]
            values = self.values(self.critics, observations, [action for action, _ in drawn])
            total = sum(value.min(dim=0).values.mean() for value in values)
            cost = sum((a.detach().exp() * d).mean() for a, (_, d) in zip(self.log_alpha, drawn, strict=True))
            self.joint_actor_step(cost - total)
        for i, (actor, n) in enumerate(zip(self.actors, own, strict=True)):
            action, density = drawn[i] if self.config.others == "team" else self.sample(actor, observations[i], n)
            alpha = self.log_alpha[i].exp()
            if self.config.others != "team":
                x = self.view(i, observations, [*actions[:i], action, *actions[i + 1 :]])
                value = torch.minimum(self.critics[0][i](x), self.critics[1][i](x))
                self.actor_step(i, (alpha.detach() * density - value).mean())
            wanted = self.config.entropy_target * actions[i].shape[1]
            self.alpha_optimisers[i].zero_grad()
            (-alpha * (density.detach() + wanted)).mean().backward()
            self.alpha_optimisers[i].step()
        self.follow_targets(actors=False)
