"""Milliseconds of one EIA-SEC update: compiled kernels, written-out torch, and plain batched torch autograd.

    python -m research.benchmarks.autograd [--updates 300] [--widths 64]

All three do the same update of the same batch, of the sizes of the preset `eia-sec`, in turns on one thread.
`AutogradEiaSec` is what the engine would be without written-out gradients: a tensor for each layer of a type,
`backward` and `torch.optim.Adam`.
"""

import argparse
import json
import os
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import replace

for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")

import numpy as np  # noqa: E402  (the variables above count only before numpy is loaded)
import torch  # noqa: E402  (as above)
from torch import Tensor  # noqa: E402  (as above)

from eia_sec.common.actors import layer_shapes  # noqa: E402  (as above)
from eia_sec.common.config import AlgorithmConfig  # noqa: E402  (as above)
from eia_sec.common.config.presets import preset  # noqa: E402  (as above)
from eia_sec.common.farm import farm_team  # noqa: E402  (as above)
from eia_sec.common.team import TeamSpec  # noqa: E402  (as above)
from eia_sec.deploy.reports.provenance import provenance  # noqa: E402  (as above)
from eia_sec.learner.off_policy.algorithm import Batch  # noqa: E402  (as above)
from eia_sec.learner.off_policy.eia_sec import EiaSec  # noqa: E402  (as above)
from eia_sec.learner.off_policy.engine import Engine  # noqa: E402  (as above)

BURST = 2
Layers = list[Tensor]
"""W1, b1, W2, b2, W3, b3 of a type's networks: [n, fan_in, fan_out] and [n, 1, fan_out]."""


def layers(flat: Tensor, inputs: int, hidden: int, outputs: int) -> Layers:
    """Return networks [n, P] in the order of `eia_sec.common.actors` as layers that require a gradient."""
    shapes = layer_shapes(inputs, hidden, outputs)
    parts = torch.split(flat, [int(np.prod(shape)) for shape in shapes], dim=1)
    stacks = [
        part.reshape(-1, *(shape if len(shape) == 2 else (1, *shape)))
        for part, shape in zip(parts, shapes, strict=True)
    ]
    return [stack.clone().requires_grad_() for stack in stacks]


def forward(network: Layers, x: Tensor) -> Tensor:
    """Return the outputs [n, B, outputs] for inputs [n, B, inputs]."""
    w1, b1, w2, b2, w3, b3 = network
    h = torch.relu(torch.baddbmm(b1, x, w1))
    return torch.baddbmm(b3, torch.relu(torch.baddbmm(b2, h, w2)), w3)


class AutogradEiaSec:
    """EIA-SEC with local critics, its members each regressing to Y, by autograd.

    Args:
        engine: where the first parameters come from.
    """

    def __init__(self, engine: Engine) -> None:
        self.config, self.team, method = engine.config, engine.team, engine.algorithm
        hidden, groups = self.config.hidden, list(enumerate(self.team.groups))
        widths = [g.observation_size + g.action_size for _, g in groups]
        self.actors = [
            layers(method.actors.networks.export(method.actors.flat, kind), g.observation_size, hidden, g.action_size)
            for kind, g in groups
        ]
        local = method.critics.networks.size
        self.critics = [
            layers(method.critics.export(method.phi[:local], 0, kind), widths[kind], hidden, 1) for kind, _ in groups
        ]
        assert isinstance(method, EiaSec)
        assert method.ensemble is not None
        sec, members = method.ensemble, method.phi[local:]
        self.members = [
            layers(
                torch.cat(
                    [sec.networks.export(members, sec.index(k, kind)) for k in range(self.config.ensemble_members)]
                ),
                widths[kind],
                hidden,
                1,
            )
            for kind, _ in groups
        ]
        self.q_parameters = [p for networks in (self.critics, self.members) for network in networks for p in network]
        self.actor_parameters = [p for network in self.actors for p in network]
        self.target_parameters = [p.detach().clone() for p in self.q_parameters]
        size = len(groups)
        pieces = [self.target_parameters[i : i + 6] for i in range(0, len(self.target_parameters), 6)]
        self.target_critics, self.target_members = pieces[:size], pieces[size:]
        self.q_adam = torch.optim.Adam(self.q_parameters, lr=self.config.critic_rate, fused=True)
        self.actor_adam = torch.optim.Adam(self.actor_parameters, lr=self.config.actor_rate, fused=True)

    def split(self, rows: Tensor, slices: Sequence[slice], kind: int) -> Tensor:
        """Return a type's part of rows [B, all] as [n, B, size]."""
        count = self.team.groups[kind].count
        return rows[:, slices[kind]].unflatten(1, (count, -1)).transpose(0, 1).contiguous()

    def pooled(self, members: Layers, x: Tensor) -> Tensor:
        """Return the members' values [k_s, n, B] of inputs [n, B, width]."""
        rows = x.reshape(1, -1, x.shape[-1]).expand(self.config.ensemble_members, -1, -1)
        return forward(members, rows).view(-1, *x.shape[:2])

    def mixture(self, critics: Layers, members: Layers, x: Tensor) -> Tensor:
        """Return Q_P [n, B]."""
        local = forward(critics, x).squeeze(-1)
        return torch.lerp(self.pooled(members, x).mean(dim=0), local, self.config.mixture_epsilon)

    def update(self, batch: Batch) -> None:
        """Do one update."""
        config, kinds, team = self.config, range(len(self.team.groups)), self.team
        seen = [self.split(batch.observation, team.observation_slices(), kind) for kind in kinds]
        q_loss = torch.zeros(())
        for kind in kinds:
            following = self.split(batch.next_observation, team.observation_slices(), kind)
            with torch.no_grad():
                x = torch.cat((following, forward(self.actors[kind], following).tanh()), dim=2)
                value = self.mixture(self.target_critics[kind], self.target_members[kind], x)
                reward = batch.reward[:, team.agent_slices()[kind]].t() * config.reward_scale
                target = reward + batch.discount * (1.0 - batch.terminated) * value
            x = torch.cat((seen[kind], self.split(batch.action, team.action_slices(), kind)), dim=2)
            q_loss = q_loss + (forward(self.critics[kind], x).squeeze(-1) - target).square().mean(dim=1).sum()
            q_loss = q_loss + (self.pooled(self.members[kind], x) - target).square().mean(dim=(1, 2)).sum()
        self.q_adam.zero_grad()
        q_loss.backward()
        self.q_adam.step()
        with torch.no_grad():
            torch._foreach_lerp_(self.target_parameters, self.q_parameters, config.target_rate)
        actor_loss = torch.zeros(())
        for parameter in self.q_parameters:
            parameter.requires_grad_(False)
        for kind in kinds:
            x = torch.cat((seen[kind], forward(self.actors[kind], seen[kind]).tanh()), dim=2)
            actor_loss = actor_loss - self.mixture(self.critics[kind], self.members[kind], x).mean(dim=1).sum()
        self.actor_adam.zero_grad()
        actor_loss.backward()
        self.actor_adam.step()
        for parameter in self.q_parameters:
            parameter.requires_grad_(True)


def random_batch(config: AlgorithmConfig, team: TeamSpec, dtype: torch.dtype = torch.float32) -> Batch:
    """Return a batch of noise."""
    generator, rows = torch.Generator().manual_seed(0), config.batch

    def normal(*shape: int) -> Tensor:
        return torch.randn(*shape, generator=generator, dtype=dtype)

    return Batch(
        normal(rows, team.observation_size),
        normal(rows, team.action_size).tanh(),
        normal(rows, team.agents),
        normal(rows, team.observation_size),
        (normal(rows) > 1.0).to(dtype),
        torch.full((rows,), config.discount, dtype=dtype),
    )


def in_turns(variants: dict[str, Callable[[], None]], bursts: int) -> dict[str, dict[str, float]]:
    """Return for each variant the least and the median milliseconds of one update, timed in turns."""
    seconds: dict[str, list[float]] = {name: [] for name in variants}
    for _ in range(bursts):
        for name, update in variants.items():
            started = time.perf_counter()
            for _ in range(BURST):
                update()
            seconds[name].append((time.perf_counter() - started) / BURST)
    return {
        name: {"ms": round(1e3 * min(found), 3), "median_ms": round(1e3 * float(np.median(found)), 3)}
        for name, found in seconds.items()
    }


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        prog="python -m research.benchmarks.autograd", description="Time of one update, three ways."
    )
    parser.add_argument("--widths", type=int, nargs="+", default=[preset("eia-sec").algorithm.hidden])
    parser.add_argument("--updates", type=int, default=300)
    options = parser.parse_args()
    torch.set_num_threads(1)
    run, lines = preset("eia-sec"), []
    team = farm_team(run.farm)
    for width in options.widths:
        config = replace(run.algorithm, hidden=width)
        batch = random_batch(config, team)
        compiled, stacked = (Engine(config, team, 0, cores=cores) for cores in (1, 0))
        autograd = AutogradEiaSec(compiled)
        variants: dict[str, Callable[[], None]] = {
            "compiled": lambda engine=compiled, batch=batch: engine.update(batch),
            "torch": lambda engine=stacked, batch=batch: engine.update(batch),
            "autograd": lambda autograd=autograd, batch=batch: autograd.update(batch),
        }
        in_turns(variants, 10)
        lines.append({"width": width, **in_turns(variants, options.updates // BURST)})
    sys.stdout.write(json.dumps({**provenance("research.benchmarks.autograd"), "lines": lines}, indent=1) + "\n")


if __name__ == "__main__":
    main()
