"""MADDPG, MATD3 and MASAC: the stacked engine against the per-agent oracles, option by option."""

import numpy as np
import pytest
import torch

from eia_sec.common.actors import TeamActors
from eia_sec.common.config import EiaSecConfig
from eia_sec.common.seeds import stream
from eia_sec.learner.off_policy.engine import NOISE, Engine
from eia_sec.learner.off_policy.inputs import view_columns
from tests.learner.off_policy.peers import MaddpgOracle, MasacOracle, Matd3Oracle
from tests.learner.off_policy.test_engine import TEAM, UNEVEN, batches, same_state, stacks_of
from tests.learner.off_policy.variants import variant

ORACLES = {"maddpg": MaddpgOracle, "matd3": Matd3Oracle, "masac": MasacOracle}
BASE = EiaSecConfig(hidden=11, batch=16, actor_rate=2e-3, critic_rate=5e-3, target_rate=0.05)
OPTIONS = {
    "default": {},
    "clipped": {"gradient_clip": 0.05},
    "others by their policies": {"others": "policy"},
    "the team's critics": {"others": "team", "gradient_clip": 0.05},
    "uneven": {},
}


def in_own_order(team, kind, hidden, flat):
    """Return joint critics' parameters [n_v, P] with the first layer's rows in the order of each agent's own view."""
    width = team.observation_size + team.action_size
    first, rest = flat[:, : width * hidden].view(-1, width, hidden), flat[:, width * hidden :]
    rows = [agent[columns] for agent, columns in zip(first, view_columns(team, kind), strict=True)]
    return torch.cat([torch.stack(rows).flatten(1), rest], dim=1)


def critics_of(engine, part):
    method, kinds, hidden = engine.algorithm, len(engine.team.groups), engine.config.hidden
    stacks = stacks_of(getattr(method.critics, part))
    own = [in_own_order(engine.team, number % kinds, hidden, flat) for number, flat in enumerate(stacks)]
    return [own[k * kinds : (k + 1) * kinds] for k in range(method.critics_each)]


@pytest.mark.parametrize("option", OPTIONS)
@pytest.mark.parametrize("name", ORACLES)
def test_twenty_updates_equal_the_loop_over_agents(name, option):
    """Twenty updates end at the parameters of the loop over agents, by torch and on one core and three."""
    team = UNEVEN if option == "uneven" else TEAM
    assert_equal_to_the_loop(variant(BASE, name, **OPTIONS[option]), team, ORACLES[name])


def assert_equal_to_the_loop(config, team, oracle_class):
    """Hold every network after twenty updates against an oracle's, by torch and on one core and three."""
    engines = [Engine(config, team, 3, dtype=torch.float64, cores=cores) for cores in (1, 0, 3)]
    method, noise = engines[0].algorithm, stream(3, NOISE)
    actors = method.actors.networks
    oracle = oracle_class(config, team, stacks_of(actors), critics_of(engines[0], "networks"))
    start = actors.flat.detach().clone()
    for batch in batches(team, config, 20):
        drawn = noise.standard_normal((method.noise_blocks, config.batch * team.action_size), np.float32)
        for engine in engines:
            engine.update(batch)
        oracle.update(batch, torch.from_numpy(drawn).double())
    assert float((actors.flat.detach() - start).abs().max()) > 1e-3
    for engine in engines:
        for part, gap in differences(engine, oracle):
            assert gap < 1e-9, f"{part} differ by {gap}"


def differences(engine, oracle):
    """Yield the largest difference for each kind of parameter."""
    method = engine.algorithm

    def gap(stacks, networks):
        rows = torch.cat([stack.flatten() for stack in stacks])
        return float((rows - torch.cat([network.flat() for network in networks])).abs().max())

    yield "actors", gap(stacks_of(method.actors.networks), oracle.actors)
    if method.has_target_actors():
        yield "target actors", gap(stacks_of(method.actors.target), oracle.target_actors)
    for part, theirs in ("networks", oracle.critics), ("target", oracle.target_critics):
        for k, stacks in enumerate(critics_of(engine, part)):
            yield f"{part} {k}", gap(stacks, theirs[k])
    if method.head == "gaussian":
        yield "log alpha", float((method.log_alpha - torch.stack(oracle.log_alpha).detach()).abs().max())


@pytest.mark.parametrize("name", ORACLES)
def test_diagnostics_change_nothing(name):
    """An update that reports its diagnostics does what a silent one does, and they are of every agent and row."""
    config = variant(BASE, name)
    measured, silent = (Engine(config, TEAM, 3) for _ in range(2))
    for batch in batches(TEAM, config, 4, torch.float32):
        diagnostics = measured.update(batch, diagnostics=True)
        assert silent.update(batch) is None
        assert diagnostics is not None
        assert diagnostics.member_std is None
    assert {tuple(tensor.shape) for tensor in diagnostics[:3]} == {(TEAM.agents, config.batch)}
    assert same_state(measured, silent)


def test_twin_critics_start_apart_and_agents_alike():
    """The two critics of an agent start as different networks, those of a type's agents as one."""
    engine = Engine(variant(BASE, "matd3"), TEAM, 5)
    first, second = critics_of(engine, "networks")
    for a, b in zip(first, second, strict=True):
        assert not torch.equal(a, b)
        assert (a == a[0]).all()


def test_gaussian_actors_act_by_their_mean_and_explore_by_their_std():
    """MASAC's exported actors decide tanh(m), and their samples are tanh(m + s n)."""
    actors = Engine(variant(BASE, "masac"), TEAM, 5).actors()
    draw = np.random.default_rng(0)
    observation = draw.normal(size=(4000, TEAM.observation_size)).astype(np.float32)
    noise = draw.normal(size=(4000, TEAM.action_size)).astype(np.float32)
    action, sample = actors.act(observation), actors.explore(observation, noise, 0.0)
    assert actors.head == "gaussian"
    assert actors.noise_free().head == "deterministic"
    np.testing.assert_allclose(actors.noise_free().act(observation), action, atol=1e-6)
    np.testing.assert_array_equal(actors.explore(observation, np.zeros_like(noise), 1.0), action)
    std = (np.arctanh(sample.astype(np.float64)) - np.arctanh(action.astype(np.float64))) / noise
    std = std[np.abs(noise) > 0.5]
    assert (std > 0).all()
    assert 0.8 < np.median(std) < 1.2


def test_deterministic_actors_explore_by_the_given_noise_std():
    """A deterministic head adds noise_std times noise and stays in range."""
    actors = TeamActors.initial(TEAM, 8, 0)
    draw = np.random.default_rng(0)
    observation = draw.normal(size=(50, TEAM.observation_size)).astype(np.float32)
    noise = draw.normal(size=(50, TEAM.action_size)).astype(np.float32)
    expected = np.clip(actors.act(observation) + np.float32(0.7) * noise, -1, 1)
    np.testing.assert_array_equal(actors.explore(observation, noise, 0.7), expected)
    assert np.abs(expected).max() == 1


@pytest.mark.skipif(not torch.cuda.is_available(), reason="there is no CUDA device")
@pytest.mark.parametrize("name", ["eia-sec", *ORACLES])
def test_captured_updates_equal_those_of_the_processor(name):
    """Updates replayed from CUDA graphs follow those on the CPU to rounding, with and without a step of the actors."""
    config = variant(BASE, name)
    host = Engine(config, TEAM, 3, dtype=torch.float64)
    device = Engine(config, TEAM, 3, "cuda", torch.float64)
    for number, batch in enumerate(batches(TEAM, config, 12)):
        host.update(batch, diagnostics=number % 4 == 0)
        device.update(type(batch)(*(tensor.cuda() for tensor in batch)), diagnostics=number % 4 == 0)
    for tensor_name, tensor in host.tensors().items():
        torch.testing.assert_close(device.tensors()[tensor_name].cpu(), tensor, atol=1e-9, rtol=1e-7)
