"""An iteration of networks with memory against torch.nn.GRUCell, row by row and agent by agent."""

import numpy as np
import pytest
import torch

from eia_sec.learner.on_policy.trainer import OnPolicyTrainer
from tests.learner.on_policy.recurrent_oracle import RecurrentOracle
from tests.learner.on_policy.recurrent_runs import remembered_chunk, with_memory
from tests.learner.on_policy.small_runs import TEAM, moved
from tests.learner.on_policy.test_updates import networks

CASES = {
    "ippo": ("ippo", {}),
    "ippo separate": ("ippo", {"shared_until": 0.0, "time_limit": "bootstrap"}),
    "ippo whole chunks": ("ippo", {"sequence_steps": 20, "minibatch_steps": 20}),
    "ippo decoupled": ("ippo", {"objective": "decoupled", "target_kl": 0.0}),
    "mappo": ("mappo", {"target_kl": 0.0}),
    "eia-ppo": ("eia-ppo", {"target_kl": 0.0, "minibatch_steps": 15}),
    "eia-ppo shared": ("eia-ppo", {"target_kl": 0.0, "minibatch_steps": 15, "shared_until": 1.0}),
}


def iterate(name, options, iterations=1):
    """Return a trainer and an oracle that have learned from the same iterations."""
    config = with_memory(name, **options)
    trainer = OnPolicyTrainer(config, TEAM)
    oracle = RecurrentOracle(config.on_policy, TEAM, config.seed, trainer.state()[0])
    for number in range(iterations):
        behaviour = moved(trainer.actors(), 0.1, np.random.default_rng(number))
        experience = remembered_chunk(behaviour, number, episodes=2)
        trainer.absorb(experience)
        trainer.train(trainer.updates_due())
        oracle.iteration(experience.rows, trainer.episodes / config.episodes)
    assert trainer.iterations == iterations
    return trainer, oracle


@pytest.mark.parametrize("case", CASES)
def test_an_iteration_gives_the_weights_of_the_plain_loop(case):
    """All weights are equal to 1e-5 after two iterations, and every kind of weight has moved further."""
    name, options = CASES[case]
    before = OnPolicyTrainer(with_memory(name, **options), TEAM).state()[0]
    trainer, oracle = iterate(name, options, iterations=2)
    after = trainer.state()[0]
    for agent in oracle.agents:
        for stack, module in networks(after, agent, TEAM.groups.index(agent.group)):
            layers = [after[f"networks.{stack}.layers.{layer}"] for layer in range(8)]
            found = torch.cat([layer[agent.index % len(layer)].reshape(-1) for layer in layers])
            torch.testing.assert_close(found, module.flat(), atol=1e-5, rtol=0.0, msg=lambda t, n=stack: f"{n}: {t}")
    for layer in range(8):
        names = [n for n in before if n.endswith(f"layers.{layer}")]
        assert min(float((after[n] - before[n]).abs().max()) for n in names) > 1e-4
