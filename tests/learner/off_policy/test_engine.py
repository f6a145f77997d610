"""The stacked engine against the per-agent oracle, switch by switch."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from eia_sec.common.actors import TeamActors
from eia_sec.common.config import EiaSecConfig
from eia_sec.common.team import GroupSpec, TeamSpec
from eia_sec.learner.off_policy.engine import Batch, Engine
from tests.learner.off_policy.oracle import Oracle

TEAM = TeamSpec((GroupSpec("c", 2, 5, 2), GroupSpec("m", 3, 4, 2), GroupSpec("d", 4, 7, 2)))
CHOOSERS = TeamSpec(
    (
        GroupSpec("c", 2, 5, 1, choices=(3,)),
        GroupSpec("m", 3, 9, 2, choices=(2, 4), masked=True),
        GroupSpec("d", 1, 6, 3, choices=(2, 2, 5)),
    )
)
"""Types that choose among options, the second with masks."""
UNEVEN = TeamSpec((GroupSpec("c", 1, 5, 1), GroupSpec("m", 3, 5, 3), GroupSpec("d", 2, 3, 2)))
BASE = EiaSecConfig(hidden=11, batch=16, actor_rate=2e-3, critic_rate=5e-3, target_rate=0.05)
SWITCHES = {
    "default": {},
    "no ensemble": {"ensemble": False},
    "no ensemble, printed losses": {"ensemble": False, "ensemble_loss": "mixture", "ensemble_gradient": False},
    "mixture loss": {"ensemble_loss": "mixture"},
    "mixture loss, no gradient": {"ensemble_loss": "mixture", "ensemble_gradient": False, "ensemble_copy_rate": 0.1},
    "copy only": {"ensemble_gradient": False, "ensemble_copy_rate": 0.1},
    "gradient and copy": {"ensemble_copy_rate": 0.3},
    "full copy": {"ensemble_copy_rate": 1.0, "ensemble_members": 3},
    "local bootstrap": {"bootstrap": "local"},
    "local objective": {"actor_objective": "local"},
    "printed": {
        "ensemble_loss": "mixture",
        "ensemble_copy_rate": 0.1,
        "bootstrap": "local",
        "actor_objective": "local",
    },
    "clipped": {"gradient_clip": 0.05},
    "mixture loss, clipped": {"gradient_clip": 0.05, "ensemble_loss": "mixture"},
    "mixture loss, copy": {"ensemble_loss": "mixture", "ensemble_copy_rate": 0.05},
    "one member": {"ensemble_members": 1},
    "three members": {"ensemble_members": 3, "ensemble_loss": "mixture"},
    "scaled rewards": {"reward_scale": 0.1, "discount": 0.9},
}


def batches(team, config, count, dtype=torch.float64, seed=1):
    generator = torch.Generator().manual_seed(seed)

    def normal(*shape):
        return torch.randn(*shape, generator=generator, dtype=dtype)

    for _ in range(count):
        rows = config.batch
        yield Batch(
            masked(team, normal(rows, team.observation_size)),
            chosen(team, normal(rows, team.action_size).tanh()),
            normal(rows, team.agents),
            masked(team, normal(rows, team.observation_size)),
            (normal(rows) > 1.0).to(dtype),
        )


def masked(team, observation):
    """Return observations whose masks are made of what they held, with one legal option in each branch at least."""
    for group, part in zip(team.groups, team.observation_slices(), strict=True):
        if group.masked:
            mask = observation[:, part].unflatten(1, (group.count, -1))[..., -group.options :]
            mask.copy_((mask > 0.0).to(mask.dtype))
            for last in torch.tensor(group.choices).cumsum(0) - 1:
                mask[..., last] = 1.0
    return observation


def chosen(team, action):
    """Return actions in -1..1, as indices of options where the team chooses."""
    options = torch.tensor([each for group in team.groups for each in group.choices * group.count], dtype=action.dtype)
    return action if not len(options) else ((action + 1.0) * 0.5 * options).floor()


def stacks_of(networks):
    """Return a copy of the parameters [n, P] of each stack."""
    return [torch.from_numpy(stack.export()) for stack in networks.stacks]


def critic_stacks(engine, part="networks"):
    """Return the parameters of all critics, in their agents' order, and those of all members."""
    method, kinds = engine.algorithm, range(len(engine.team.groups))
    critics = stacks_of(getattr(method.critics, part))
    local = [critics[kind] for kind in kinds]
    if not getattr(method, "ensemble", None):
        return local, [torch.empty(0, 0) for _ in kinds]
    members = stacks_of(getattr(method.ensemble, part))
    return local, [torch.cat(members[kind :: len(kinds)]) for kind in kinds]


def twins(team, config, dtype=torch.float64, seed=3, cores=None):
    engine = Engine(config, team, seed, dtype=dtype, cores=cores)
    local, members = critic_stacks(engine)
    return engine, Oracle(config, team, stacks_of(engine.algorithm.actors.networks), local, members)


def differences(engine, oracle):
    """Yield the largest difference for each kind of parameter."""

    def gap(stacks, networks):
        rows = torch.cat([stack.flatten() for stack in stacks])
        return float((rows - torch.cat([network.flat() for network in networks])).abs().max())

    actors = engine.algorithm.actors
    local, members = critic_stacks(engine)
    target_local, target_members = critic_stacks(engine, "target")
    yield "actors", gap(stacks_of(actors.networks), oracle.actors)
    yield "critics", gap(local, oracle.critics)
    yield "target critics", gap(target_local, oracle.target_critics)
    if engine.config.uses_ensemble:
        yield "members", gap(members, [m for group in oracle.members for m in group])
        yield "target members", gap(target_members, [m for group in oracle.target_members for m in group])


def same_state(a, b):
    return all(torch.equal(tensor, b.tensors()[name]) for name, tensor in a.tensors().items())


@pytest.mark.parametrize("team", [TEAM, UNEVEN], ids=["team", "uneven"])
@pytest.mark.parametrize("switch", SWITCHES)
def test_twenty_updates_equal_the_loop_over_agents(switch, team):
    """Twenty updates end at the parameters of the loop over agents, by torch and on one core and three."""
    config = replace(BASE, **SWITCHES[switch])
    engine, oracle = twins(team, config, cores=1)
    engines = [engine, *(twins(team, config, cores=cores)[0] for cores in (0, 3))]
    start = engine.algorithm.actors.networks.flat.detach().clone()
    for batch in batches(team, config, 20):
        for engine in engines:
            engine.update(batch)
        oracle.update(batch)
    assert float((engines[0].algorithm.actors.networks.flat.detach() - start).abs().max()) > 1e-3
    for engine in engines:
        for name, gap in differences(engine, oracle):
            assert gap < 1e-9, f"{name} differ by {gap}"


def test_float32_follows_the_loop_for_a_few_updates():
    """In float32 the first updates agree with the loop over agents to rounding."""
    engine, oracle = twins(TEAM, BASE, torch.float32)
    for batch in batches(TEAM, BASE, 5, torch.float32):
        engine.update(batch)
        oracle.update(batch)
    for name, gap in differences(engine, oracle):
        assert gap < 1e-4, f"{name} differ by {gap}"


def test_diagnostics_are_those_of_the_equations():
    """An update reports the errors of step 3, the objective of step 6 and the targets, and changes nothing by it."""
    config = replace(BASE, ensemble_loss="mixture", ensemble_copy_rate=0.2)
    engine, oracle = twins(TEAM, config)
    silent, _ = twins(TEAM, config)
    (batch,) = batches(TEAM, config, 1)
    observations = oracle.split(batch.observation, "observation_size")
    actions = oracle.split(batch.action, "action_size")
    targets = oracle._targets(batch, oracle.split(batch.next_observation, "observation_size"))
    diagnostics = engine.update(batch, diagnostics=True)
    silent.update(batch)
    assert diagnostics is not None
    assert same_state(engine, silent)
    for i, critic in enumerate(oracle.critics):
        x = oracle.view(i, observations, actions)
        prediction = oracle.mix(critic(x), oracle.members[oracle.kind[i]], x, True)
        torch.testing.assert_close(diagnostics.target[i], targets[i])
        torch.testing.assert_close(diagnostics.td_error[i], (prediction - targets[i]).detach())
    oracle.update(batch)
    decided = [a(o) for a, o in zip(twins(TEAM, config)[1].actors, observations, strict=True)]
    for i, critic in enumerate(oracle.critics):
        x = oracle.view(i, observations, [*actions[:i], decided[i], *actions[i + 1 :]])
        objective = oracle.mix(critic(x), oracle.members[oracle.kind[i]], x, True)
        torch.testing.assert_close(diagnostics.objective[i], objective.detach())


@pytest.mark.parametrize("cores", [0, 1])
@pytest.mark.parametrize("switch", SWITCHES)
def test_diagnostics_change_nothing(switch, cores):
    """Asking for diagnostics changes no bit of the state, by torch and by kernels."""
    config = replace(BASE, **SWITCHES[switch])
    silent, some, every = (Engine(config, TEAM, 3, cores=cores) for _ in range(3))
    for number, batch in enumerate(batches(TEAM, config, 6, torch.float32)):
        assert silent.update(batch) is None
        assert (some.update(batch, diagnostics=number % 2 == 1) is None) == (number % 2 == 0)
        assert every.update(batch, diagnostics=True) is not None
    assert same_state(silent, some)
    assert same_state(silent, every)


def test_actors_start_as_everybody_draws_them():
    """The engine's first actors are TeamActors.initial's, those of one type alike."""
    for mine, theirs in zip(
        Engine(BASE, TEAM, 5).actors().flat, TeamActors.initial(TEAM, BASE.hidden, 5).flat, strict=True
    ):
        assert np.array_equal(mine, theirs)
        assert (mine[0] == mine[1]).all()


def test_critics_start_alike_and_members_apart():
    """Local critics of a type start as one network, SEC members as different ones, targets as copies."""
    engine = Engine(BASE, TEAM, 5)
    local, members = critic_stacks(engine)
    for stack, group in zip(local, members, strict=True):
        assert (stack == stack[0]).all()
        assert not torch.equal(group[0], group[1])
    for trained in (engine.algorithm.critics, engine.algorithm.ensemble):
        assert torch.equal(trained.networks.flat, trained.target.flat)


def test_parameters_survive_loading_and_exporting():
    """Actors put in are the actors that come out."""
    engine = Engine(BASE, UNEVEN, 5)
    generator = np.random.default_rng(0)
    flat = tuple(generator.normal(size=stack.shape).astype(np.float32) for stack in engine.actors().flat)
    engine.algorithm.actors.load(flat)
    for mine, theirs in zip(engine.actors().flat, flat, strict=True):
        assert np.array_equal(mine, theirs)


def test_same_seed_same_updates():
    """Two engines of one seed stay bit-equal over the same batches, and one of another seed does not."""
    engines = [Engine(BASE, TEAM, seed) for seed in (7, 7, 8)]
    for batch in batches(TEAM, BASE, 5, torch.float32):
        for engine in engines:
            engine.update(batch)
    assert same_state(engines[0], engines[1])
    assert not same_state(engines[0], engines[2])
