"""AgileRL: milliseconds of an update of MADDPG and MATD3. Runs in the environment of requirements/agilerl.txt.

An update is `sample` of its replay buffer and `learn` of the algorithm, as in its own training loop. No agent's name
ends in "_" and a number, so that AgileRL gives each agent networks of its own. Its networks are an encoder, a latent
layer and a head. With latent layer and head of the width its critics have exactly two hidden layers of that width, and
its actors, whose encoder needs one of its own, three. Layer normalisation, which the others lack, is off.
"""

import argparse
from collections.abc import Callable
from typing import Any

import torch
from agilerl.algorithms import MADDPG, MATD3
from agilerl.components.data import MultiAgentTransition
from agilerl.components.replay_buffer import ReplayBuffer
from gymnasium import spaces
from tensordict import TensorDict

from research.benchmarks.peers.clock import hand_over, learner_options, parse_groups, update_times

ALGORITHMS = {"MADDPG": MADDPG, "MATD3": MATD3}
Sizes = dict[str, tuple[int, int]]


def sizes_of(groups: list[tuple[str, int, int, int]]) -> Sizes:
    """Return observation and action size of each agent."""
    return {f"{name}{i}": (seen, done) for name, count, seen, done in groups for i in range(count)}


def filled_buffer(sizes: Sizes, capacity: int) -> ReplayBuffer:
    """Return a replay buffer that is full of noise."""
    torch.manual_seed(0)
    memory = ReplayBuffer(capacity)
    part = 4096
    while len(memory) < capacity:
        noise = MultiAgentTransition(
            obs={name: torch.rand(part, seen) * 2 - 1 for name, (seen, _) in sizes.items()},
            action={name: torch.rand(part, done) * 2 - 1 for name, (_, done) in sizes.items()},
            reward={name: torch.randn(part, 1) for name in sizes},
            next_obs={name: torch.rand(part, seen) * 2 - 1 for name, (seen, _) in sizes.items()},
            done={name: torch.zeros(part, 1) for name in sizes},
        )
        memory.add(TensorDict(noise.to_dict(), batch_size=[part]))
    return memory


def make(name: str, sizes: Sizes, width: int, batch: int) -> Any:
    """Return the algorithm with a network configuration for the width."""
    layer = {"hidden_size": [width], "layer_norm": False}
    return ALGORITHMS[name](
        [spaces.Box(-1.0, 1.0, (seen,)) for seen, _ in sizes.values()],
        [spaces.Box(-1.0, 1.0, (done,)) for _, done in sizes.values()],
        agent_ids=list(sizes),
        net_config={"encoder_config": layer, "head_config": dict(layer), "latent_dim": width, "max_latent_dim": 512},
        batch_size=batch,
    )


def parameters(agent: Any) -> int:
    """Return how many trained parameters there are; MATD3 has two critics for each agent."""
    critics = [agent.critics] if hasattr(agent, "critics") else [agent.critics_1, agent.critics_2]
    return sum(p.numel() for networks in (agent.actors, *critics) for p in networks.parameters())


def update_of(agent: Any, memory: ReplayBuffer, batch: int) -> Callable[[], None]:
    """Return one update."""

    def update() -> None:
        agent.learn(memory.sample(batch))

    return update


def measure(name: str, sizes: Sizes, memory: ReplayBuffer, width: int, options: argparse.Namespace) -> dict[str, Any]:
    """Return one line of the result."""
    agent = make(name, sizes, width, options.batch)
    agent.set_training_mode(True)
    if len(agent.actors) != len(sizes):
        raise RuntimeError(f"AgileRL made {len(agent.actors)} actors for {len(sizes)} agents.")
    least, median = update_times(update_of(agent, memory, options.batch), options.updates)
    return {
        "software": "AgileRL",
        "algorithm": name,
        "form": "one after the other",
        "width": width,
        "agents": len(sizes),
        "threads": options.threads,
        "ms": least,
        "median_ms": median,
        "parameters": parameters(agent),
    }


def main() -> None:
    """Measure and print."""
    options = learner_options("AgileRL").parse_args()
    torch.set_num_threads(options.threads)
    sizes = sizes_of(parse_groups(options.groups))
    memory = filled_buffer(sizes, options.capacity)
    lines = [measure(name, sizes, memory, width, options) for width in options.widths for name in ALGORITHMS]
    hand_over(lines, "agilerl", "torch")


if __name__ == "__main__":
    main()
