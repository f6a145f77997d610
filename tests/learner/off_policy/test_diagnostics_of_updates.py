"""What updates report of themselves, beside the per-agent oracles: values of the mixture, losses, norms and entropy."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from torch.utils._python_dispatch import TorchDispatchMode

from eia_sec.common.config import ReplayConfig
from eia_sec.common.config.presets import preset
from eia_sec.common.seeds import stream
from eia_sec.common.transitions import TERMINATED, TRANSITION, Chunk, Rows
from eia_sec.learner.off_policy.diagnostics import RETURN_PERIOD, RunningDiagnostics
from eia_sec.learner.off_policy.engine import NOISE, Engine
from eia_sec.learner.off_policy.trainer import OffPolicyTrainer
from eia_sec.learner.registry import OFF_POLICY
from tests.learner.off_policy.test_engine import BASE, CHOOSERS, SWITCHES, TEAM, batches, stacks_of, twins
from tests.learner.off_policy.test_peers import ORACLES, critics_of
from tests.learner.off_policy.variants import variant

CLIP = 0.003
READ_BACK = {"aten::item", "aten::_local_scalar_dense", "aten::is_nonzero", "aten::nonzero", "aten::masked_select"}
"""Operations for which the host waits for the device."""
FORMS = ("default", "no ensemble", "mixture loss", "copy only", "printed", "local bootstrap", "three members")


def diagnosed(diagnostics):
    """Return the running means [agents] by name after one update."""
    running = RunningDiagnostics(TEAM, "cpu")
    running.note(diagnostics)
    return running.means


def peers(name, **options):
    """Return an engine of a peer, its oracle, a batch and the update's noise, all in float64."""
    config = variant(BASE, name, **options)
    engine = Engine(config, TEAM, 3, dtype=torch.float64)
    method, (batch,) = engine.algorithm, batches(TEAM, config, 1)
    oracle = ORACLES[name](config, TEAM, stacks_of(method.actors.networks), critics_of(engine, "networks"))
    noise = stream(3, NOISE).standard_normal((method.noise_blocks, config.batch * TEAM.action_size), np.float32)
    return engine, oracle, batch, torch.from_numpy(noise).double()


def seen(oracle, batch):
    """Return what each agent's critic sees of a batch's own actions."""
    observations = oracle.split(batch.observation, "observation_size")
    actions = oracle.split(batch.action, "action_size")
    return [oracle.view(i, observations, actions) for i in range(TEAM.agents)]


@pytest.mark.parametrize("form", FORMS)
def test_q_is_that_of_the_mixture_whatever_the_losses(form):
    """Mean Q, and its excess over realised returns, are of eps Q_i + (1 - eps) mean Q_s,k, and of Q_i without SEC."""
    engine, oracle = twins(TEAM, replace(BASE, **SWITCHES[form]))
    (batch,) = batches(TEAM, engine.config, 1)
    with torch.no_grad():
        pairs = zip(oracle.critics, oracle.kind, seen(oracle, batch), strict=True)
        q = torch.stack([oracle.mix(critic(x), oracle.members[kind], x, True) for critic, kind, x in pairs]).float()
    diagnostics = engine.update(batch, diagnostics=True)
    torch.testing.assert_close(diagnosed(diagnostics)["q_mean"], q.mean(dim=1))
    chosen, running = np.array([1, 4, 5]), RunningDiagnostics(TEAM, "cpu")
    returns = torch.randn(BASE.batch, TEAM.agents, generator=torch.Generator().manual_seed(0))
    running.compare(diagnostics, returns, chosen)
    wanted = q[:, chosen].mean(dim=1) - returns[chosen].mean(dim=0)
    torch.testing.assert_close(running.means["overestimation"], wanted)


@pytest.mark.parametrize("clip", [0.0, CLIP])
@pytest.mark.parametrize("form", FORMS)
def test_losses_and_norms_are_those_of_autograd(form, clip):
    """A member's loss and gradient are reported, and all norms are from before the clip, which acts nevertheless."""
    config = replace(BASE, gradient_clip=clip, **SWITCHES[form])
    engine, oracle = twins(TEAM, config)
    (batch,) = batches(TEAM, config, 1)
    targets = oracle._targets(batch, oracle.split(batch.next_observation, "observation_size"))
    with torch.no_grad():
        losses = [
            [(member(x) - y).square().mean() for member in oracle.members[kind]]
            for kind, x, y in zip(oracle.kind, seen(oracle, batch), targets, strict=True)
        ]
    means = diagnosed(engine.update(batch, diagnostics=True))
    oracle.update(batch)
    critics, actors = ([network.norm for network in networks] for networks in (oracle.critics, oracle.actors))
    torch.testing.assert_close(means["critic_gradient"], torch.tensor(critics))
    torch.testing.assert_close(means["actor_gradient"], torch.tensor(actors))
    assert ("member_loss" in means) == config.uses_ensemble
    assert ("member_gradient" in means) == (config.uses_ensemble and config.ensemble_gradient)
    if "member_loss" in means:
        torch.testing.assert_close(means["member_loss"], torch.tensor(losses).mean(dim=1).float())
    if "member_gradient" in means:
        members = [np.mean([member.norm for member in oracle.members[kind]]) for kind in oracle.kind]
        torch.testing.assert_close(means["member_gradient"], torch.tensor(members, dtype=torch.float32))
    shortened = engine.algorithm.critics.networks.norms()
    if clip:
        assert max(critics) > 2 * clip
        torch.testing.assert_close(shortened, torch.tensor(critics).clamp_max(clip).double())


@pytest.mark.parametrize("clip", [0.0, CLIP])
@pytest.mark.parametrize("name", ORACLES)
def test_norms_of_twin_critics_are_of_both(name, clip):
    """The norm of an agent's critic gradient is the mean over its critics, from before the clip; so is the actor's."""
    engine, oracle, batch, noise = peers(name, gradient_clip=clip)
    engine.updates.fill_(1)
    oracle.updates = 1
    means = diagnosed(engine.update(batch, diagnostics=True))
    oracle.update(batch, noise)
    norms = torch.tensor([[network.norm for network in critics] for critics in oracle.critics])
    assert norms.max() > 2 * CLIP
    torch.testing.assert_close(means["critic_gradient"], norms.mean(dim=0))
    torch.testing.assert_close(means["actor_gradient"], torch.tensor([actor.norm for actor in oracle.actors]))


def test_entropy_is_reported_beside_the_soft_value():
    """MASAC reports alpha and mean log pi of every agent's draws; the others have neither."""
    engine, oracle, batch, noise = peers("masac")
    engine.algorithm.log_alpha.fill_(math.log(0.3))
    observations = oracle.split(batch.observation, "observation_size")
    own = zip(oracle.actors, observations, oracle.noise(noise[1]), strict=True)
    with torch.no_grad():
        density = torch.stack([oracle.sample(*given)[1].mean() for given in own]).float()
    means = diagnosed(engine.update(batch, diagnostics=True))
    torch.testing.assert_close(means["log_probability"], density)
    torch.testing.assert_close(means["temperature"], torch.full((TEAM.agents,), 0.3))
    for name in ("maddpg", "matd3"):
        other, _, batch, _ = peers(name)
        assert not {"log_probability", "temperature"} & diagnosed(other.update(batch, diagnostics=True)).keys()


@pytest.mark.parametrize("name", ["eia-sec", *ORACLES])
def test_a_soft_value_is_not_compared_with_rewards(name):
    """Where Q counts entropy, the returns are reported and its excess over them is not; elsewhere both are."""
    algorithm = variant(BASE, name, discount=0.5)
    replay = ReplayConfig(capacity=512, warmup_steps=0)
    trainer = OffPolicyTrainer(
        replace(preset("eia-sec").with_algorithm(name), algorithm=algorithm, replay=replay), TEAM
    )
    flag = np.full(256, TRANSITION, np.uint8)
    flag[7::8] = 0
    flag[6::8] |= TERMINATED
    draw = np.random.default_rng(3)
    widths = TEAM.observation_size, TEAM.action_size, TEAM.agents
    trainer.absorb(Chunk(Rows(*(draw.uniform(-0.9, 0.9, (256, w)).astype(np.float32) for w in widths), flag)))
    trainer.train(RETURN_PERIOD + 1)
    assert trainer.diagnostics.comparisons == 2
    names = {key.partition("/")[0] for key in trainer.statistics()}
    assert "realised_return" in names
    assert ("overestimation" in names) == (name != "masac")


class Operations(TorchDispatchMode):
    """Notes the names of all operations."""

    def __init__(self):
        super().__init__()
        self.names = set()

    def __torch_dispatch__(self, function, types, args=(), kwargs=None):
        self.names.add(function.name())
        return function(*args, **(kwargs or {}))


@pytest.mark.parametrize("clip", [0.0, CLIP])
@pytest.mark.parametrize("name", sorted(OFF_POLICY))
def test_an_update_asks_the_device_for_nothing(name, clip):
    """No operation of an update with diagnostics reads a number back, so it can be captured as a graph."""
    config = variant(BASE, name, gradient_clip=clip, ensemble_copy_rate=0.1)
    team = TEAM if config.continuous_actions else CHOOSERS
    engine = Engine(config, team, 3, cores=0)
    for step, batch in enumerate(batches(team, BASE, 2, torch.float32)):
        noise = torch.zeros(engine.algorithm.noise_blocks, BASE.batch * team.action_size)
        with Operations() as seen:
            engine.algorithm.update(batch, noise, actor_step=bool(step), diagnostics=True)
        assert ("aten::baddbmm" if team is TEAM else "aten::addmm") in seen.names
        assert not READ_BACK & seen.names


def test_the_guard_of_capture_notices_a_number():
    """A number that is read back is among the operations that the guard sees."""
    with Operations() as seen:
        torch.ones(3).sum().item()
    assert READ_BACK & seen.names
