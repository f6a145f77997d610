"""An iteration's updates against a plain implementation that goes agent by agent."""

import numpy as np
import pytest
import torch

from eia_sec.learner.on_policy.trainer import OnPolicyTrainer
from tests.learner.on_policy.oracle import Oracle, flat, network
from tests.learner.on_policy.small_runs import ENDS, TEAM, chunk, configured, moved

CASES = {
    "ippo": ("ippo", {}),
    "ippo separate": ("ippo", {"shared_until": 0.0}),
    "ippo bootstrapped": ("ippo", {"time_limit": "bootstrap"}),
    "ippo without clips": ("ippo", {"gradient_clip": 0.0, "clip": 1e6, "target_kl": 0.0}),
    "ippo tight clips": ("ippo", {"gradient_clip": 0.01, "clip": 0.02, "target_kl": 0.0}),
    "ippo entropy": ("ippo", {"entropy_start": 0.5, "entropy_end": 0.1, "rate_end": 0.5, "target_kl": 0.0}),
    "ippo stops": ("ippo", {"actor_rate": 0.02, "target_kl": 0.02, "epochs": 4}),
    "ippo decoupled": ("ippo", {"objective": "decoupled", "target_kl": 0.0}),
    "ippo scales": ("ippo", {"normalise_observations": True, "normalise_returns": True, "target_kl": 0.0}),
    "mappo scales": ("mappo", {"normalise_observations": True, "normalise_returns": True, "target_kl": 0.0}),
    "eia-ppo scales": (
        "eia-ppo",
        {"normalise_observations": True, "normalise_returns": True, "objective": "decoupled"},
    ),
    "mappo": ("mappo", {"target_kl": 0.0}),
    "mappo decoupled": ("mappo", {"objective": "decoupled", "target_kl": 0.0}),
    "mappo separate": ("mappo", {"shared_until": 0.0, "gae_lambda": 0.5}),
    "eia-ppo": ("eia-ppo", {"target_kl": 0.0}),
    "eia-ppo shared": ("eia-ppo", {"shared_until": 1.0, "ensemble_members": 3}),
    "eia-ppo without ensemble": ("eia-ppo", {"ensemble": False, "target_kl": 0.0}),
}


def iterate(name, options, iterations=1, oracle_class=Oracle):
    """Return a trainer and an oracle that have learned from the same iterations."""
    config = configured(name, **options)
    trainer = OnPolicyTrainer(config, TEAM)
    oracle = oracle_class(config.on_policy, TEAM, config.seed, trainer.state()[0])
    for number in range(iterations):
        behaviour = moved(trainer.actors(), 0.1, np.random.default_rng(number))
        experience = chunk(behaviour, number, ENDS, episodes=2)
        trainer.absorb(experience)
        trainer.train(trainer.updates_due())
        oracle.iteration(experience.rows, trainer.episodes / config.episodes)
    assert trainer.iterations == iterations
    return trainer, oracle


def assert_equal_networks(trainer, oracle):
    """Hold every network of the trainer against the oracle's."""
    tensors = trainer.state()[0]
    for agent in oracle.agents:
        kind = TEAM.groups.index(agent.group)
        for name, module in networks(tensors, agent, kind):
            index = agent.index % len(tensors[f"networks.{name}.layers.0"])
            wanted = flat(module)
            found = flat(network(tensors, name, index))
            torch.testing.assert_close(found, wanted, atol=1e-5, rtol=0.0, msg=lambda text, n=name: f"{n}: {text}")


def networks(tensors, agent, kind):
    """Yield the names of an agent's stacks in a checkpoint, and its networks."""
    yield f"actors.types.{kind}", agent.actor
    if agent.local is not None:
        parts = (".local.network", ".network")
        local = next(part for part in parts if f"networks.values.{kind}{part}.layers.0" in tensors)
        yield f"values.{kind}{local}", agent.local
    for k, member in enumerate(agent.members):
        yield f"values.{kind}.members.{k}", member


@pytest.mark.parametrize("case", CASES)
def test_an_iteration_gives_the_weights_of_the_plain_loop(case):
    """All weights of actors and value functions are equal to 1e-5 after one iteration, and have moved further."""
    name, options = CASES[case]
    config = configured(name, **options)
    before = OnPolicyTrainer(config, TEAM).state()[0]
    trainer, oracle = iterate(name, options)
    assert_equal_networks(trainer, oracle)
    after = trainer.state()[0]
    moves = [(after[n] - before[n]).abs().max() for n in before if n.endswith("layers.4")]
    assert min(moves) > 1e-3


def test_two_iterations_go_on_like_the_plain_loop():
    """Adam's moments, the random order and falling rates carry over from one iteration to the next."""
    trainer, oracle = iterate("eia-ppo", {"target_kl": 0.0}, iterations=2)
    assert_equal_networks(trainer, oracle)


def test_the_cases_do_what_their_names_say():
    """In the comparison actors do stop, gradients are shortened where they may be, and ratios are clipped."""
    trainer, oracle = iterate(*CASES["ippo stops"])
    assert oracle.stopped
    assert trainer.updates == 16
    assert iterate(*CASES["ippo tight clips"])[1].clipped > 20
    assert iterate(*CASES["ippo without clips"])[1].clipped == 0
    shares = [iterate(*CASES[case])[0].statistics() for case in ("ippo tight clips", "ippo without clips")]
    clipped = [sum(statistics[f"clipped_share/{kind}"] for kind in "ab") for statistics in shares]
    assert clipped[0] > 0.1
    assert clipped[1] == 0.0


def test_stopped_actors_stay_while_values_learn():
    """After the epoch that moved a type too far its actors keep still, and its value functions go on."""
    config = configured(actor_rate=0.05, target_kl=1e-6, epochs=2)
    trainer = OnPolicyTrainer(config, TEAM)
    trainer.absorb(chunk(trainer.actors(), 0, ENDS))
    trainer.train(4)
    before = trainer.state()[0]
    trainer.train(4)
    after = trainer.state()[0]
    same = {name: torch.equal(before[name], after[name]) for name in after if name in before and "layers" in name}
    assert all(same[name] for name in same if name.startswith("networks.actors"))
    assert not any(same[name] for name in same if name.startswith("networks.values") and "layers.4" in name)


def test_values_learn_first():
    """Iterations within `value_steps` leave the actors as they were, and move the value functions."""
    experience = chunk(OnPolicyTrainer(configured(), TEAM).actors(), 0, ENDS)
    config = configured(value_steps=experience.rows.steps)
    trainer = OnPolicyTrainer(config, TEAM)
    states = []
    for _ in range(3):
        states.append(trainer.state()[0])
        trainer.absorb(chunk(trainer.actors(), 0, ENDS))
        trainer.train(trainer.updates_due())
        trainer.next_version()
    for before, after, moves in ((states[0], states[1], False), (states[1], states[2], True)):
        for name in (name for name in after if "layers.0" in name and not name.endswith(("step", "exp_avg", "_sq"))):
            assert torch.equal(before[name], after[name]) is not (moves or name.startswith("networks.values"))


def test_statistics_are_those_of_the_last_iteration():
    """Every diagnostic of each type is reported after an iteration, and single numbers are right."""
    config = configured(target_kl=0.0, time_limit="bootstrap", discounts={}, gae_lambda=1.0, discount=0.0)
    trainer = OnPolicyTrainer(config, TEAM)
    assert not any("/" in name for name in trainer.statistics())
    experience = chunk(trainer.actors(), 0, ENDS)
    trainer.absorb(experience, version=0)
    trainer.next_version()
    assert trainer.statistics()["iteration_occupancy"] == 1.0
    trainer.train(trainer.updates_due())
    found = trainer.statistics()
    assert len([name for name in found if "/" in name]) == 18
    # Without a future the return of a step is its reward.
    assert found["return_mean/a"] == pytest.approx(
        experience.rows.reward[experience.rows.flag > 0, :2].mean(), rel=1e-5
    )
    assert 0.0 <= found["kl/a"] < 0.05
    assert found["entropy/a"] < np.log(6) + 1e-6
    assert (found["iterations"], found["iteration_occupancy"]) == (1.0, 0.0)


def test_steps_of_an_older_policy_are_weighted():
    """Decoupled, an iteration's ratios begin at 1, whoever acted; otherwise many are clipped at once."""
    config = configured(objective="decoupled", epochs=1, minibatch_steps=40, target_kl=0.0)
    trainer = OnPolicyTrainer(config, TEAM)
    behaviour = moved(trainer.actors(), 0.3, np.random.default_rng(0))
    trainer.absorb(chunk(behaviour, 0, ENDS))
    trainer.train(1)
    found = trainer.statistics()
    assert found["kl/a"] == pytest.approx(0.0, abs=1e-5)
    assert found["clipped_share/b"] == 0.0
    plain = OnPolicyTrainer(configured(epochs=1, minibatch_steps=40, target_kl=0.0), TEAM)
    plain.absorb(chunk(behaviour, 0, ENDS))
    plain.train(1)
    assert plain.statistics()["clipped_share/b"] > 0.5


@pytest.mark.parametrize("clip", [0.5, 0.0])
def test_one_impossible_action_spoils_no_weights(clip):
    """However unlikely a worker says that its action was, ratio and gradients stay finite."""
    config = configured("ippo", objective="ppo", target_kl=0.0, gradient_clip=clip)
    trainer = OnPolicyTrainer(config, TEAM)
    experience = chunk(trainer.actors(), 0, ENDS, episodes=2)
    experience.rows.log_probability[::3] = -100.0
    trainer.absorb(experience)
    trainer.train(trainer.updates_due())
    assert all(np.isfinite(flat).all() for flat in trainer.actors().flat)


def test_actors_are_changed_from_outside_between_iterations_only():
    """Half of an iteration's updates leave ratios against the policy at its start."""
    trainer = OnPolicyTrainer(configured("eia-ppo"), TEAM)
    assert trainer.between_iterations
    trainer.absorb(chunk(trainer.actors(), 0, ENDS, episodes=2))
    assert trainer.between_iterations
    trainer.train(1)
    assert not trainer.between_iterations
    trainer.train(trainer.updates_due())
    assert trainer.between_iterations
