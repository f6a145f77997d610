"""VDN and QMIX: the stacked engine against a loop over agents and branches, what mixing may do, and a task for two."""

import copy
from dataclasses import replace
from typing import ClassVar

import numpy as np
import onnxruntime
import pytest
import torch
from gymnasium import spaces
from pettingzoo import ParallelEnv
from torch.nn.functional import elu

import eia_sec
from eia_sec.common.config import QmixConfig, RunConfig, VdnConfig
from eia_sec.common.config.files import with_values
from eia_sec.common.errors import ConfigError
from eia_sec.common.policy_file import load_policy, save_policy
from eia_sec.common.team import GroupSpec, TeamSpec
from eia_sec.deploy.policies.export import export_onnx
from eia_sec.learner.off_policy.diagnostics import RunningDiagnostics
from eia_sec.learner.off_policy.engine import Diagnostics, Engine
from eia_sec.learner.off_policy.mixer import Mixer
from eia_sec.learner.off_policy.trainer import OffPolicyTrainer
from eia_sec.rollout.worker.collector import Collector
from tests.learner.off_policy.oracle import Network, follow
from tests.learner.off_policy.test_engine import CHOOSERS, batches, same_state, stacks_of
from tests.learner.off_policy.variants import variant

VDN = VdnConfig(hidden=11, batch=16, actor_rate=2e-3, target_rate=0.05)
QMIX = QmixConfig(hidden=11, batch=16, actor_rate=2e-3, critic_rate=5e-3, target_rate=0.05, mixing_width=7)
ONE = TeamSpec((GroupSpec("a", 1, 4, 1, choices=(3,)),))
CONFIGS = {
    "vdn": VDN,
    "qmix": QMIX,
    "vdn, clipped": variant(VDN, "vdn", gradient_clip=0.05),
    "qmix, clipped": variant(QMIX, "qmix", gradient_clip=0.05),
}


class Loop:
    """An update once more, straight from the papers: agent by agent, branch by branch, mixed row by row."""

    def __init__(self, config, team, values, mixer):
        self.config, self.team = config, team
        self.values = [
            Network(flat[0], group.observation_size, config.hidden, group.options, squash=False)
            for flat, group in zip(values, team.groups, strict=True)
        ]
        self.mixer = None
        if mixer is not None:
            outputs = config.mixing_width * (team.agents + 2) + 1
            self.mixer = Network(mixer[0], team.observation_size, config.hidden, outputs, squash=False)
        self.target_values, self.target_mixer = copy.deepcopy(self.values), copy.deepcopy(self.mixer)
        rates = [(network, config.actor_rate) for network in self.values]
        rates += [(self.mixer, config.critic_rate)] if self.mixer else []
        self.trained = [(network, torch.optim.Adam(network.parameters(), lr=rate)) for network, rate in rates]

    def options(self, group, outputs):
        """Return the values of each branch's options."""
        return outputs.split(list(group.choices), dim=-1)

    def best(self, group, network, seen):
        """Return the legal option of the highest value of each branch, for one row."""
        values, legal = network(seen), torch.ones(group.options)
        if group.masked:
            legal = seen[-group.options :]
        pairs = zip(self.options(group, values), self.options(group, legal), strict=True)
        return [max((k for k in range(len(v)) if mask[k] > 0), key=lambda k: float(v[k])) for v, mask in pairs]

    def worth(self, group, network, seen, options):
        """Return the value of one agent's action in one row."""
        return sum(part[int(option)] for part, option in zip(self.options(group, network(seen)), options, strict=True))

    def mix(self, mixer, values, state):
        """Return the team's value in one row."""
        if mixer is None:
            return values.sum()
        m, n = self.config.mixing_width, self.team.agents
        normal = (state - state.mean()) / (state.var(unbiased=False) + 1e-5).sqrt()
        w1, b1, w2, b2 = mixer(normal).split([m * n, m, m, 1])
        hidden = elu(w1.abs().view(m, n) @ values + b1)
        return w2.abs() @ hidden + b2[0]

    def parts(self, rows, size):
        """Yield the type, its number and the part of rows of each agent."""
        start = 0
        for number, group in enumerate(self.team.groups):
            for _ in range(group.count):
                stop = start + getattr(group, size)
                yield number, group, rows[:, start:stop]
                start = stop

    def update(self, batch):
        config, errors = self.config, []
        seen, following = (list(self.parts(o, "observation_size")) for o in (batch.observation, batch.next_observation))
        taken = list(self.parts(batch.action, "action_size"))
        for b in range(config.batch):
            with torch.no_grad():
                after = [
                    self.worth(g, self.target_values[v], o[b], self.best(g, self.values[v], o[b]))
                    for v, g, o in following
                ]
                team = self.mix(self.target_mixer, torch.stack(after), batch.next_observation[b])
                target = config.reward_scale * batch.reward[b].mean()
                target += config.discount * (1.0 - batch.terminated[b]) * team
            pairs = zip(seen, taken, strict=True)
            now = [self.worth(g, self.values[v], o[b], a[b]) for (v, g, o), (_, _, a) in pairs]
            errors.append(self.mix(self.mixer, torch.stack(now), batch.observation[b]) - target)
        torch.stack(errors).square().mean().backward()
        for network, optimiser in self.trained:
            norm = torch.cat([p.grad.flatten() for p in network.parameters()]).norm()
            if 0.0 < config.gradient_clip < norm:
                for p in network.parameters():
                    p.grad *= config.gradient_clip / norm
            optimiser.step()
            optimiser.zero_grad()
        for target, source in zip(self.target_values, self.values, strict=True):
            follow(target, source, config.target_rate)
        if self.mixer:
            follow(self.target_mixer, self.mixer, config.target_rate)


def networks_of(engine, part):
    """Return the parameters of the agents' values and of the mixing network, or None."""
    mixer = getattr(engine.algorithm, "mixer", None)
    values = stacks_of(getattr(engine.algorithm.actors, part))
    return values, None if mixer is None else stacks_of(getattr(mixer, part))[0]


@pytest.mark.parametrize("team", [CHOOSERS, ONE], ids=["team", "one agent"])
@pytest.mark.parametrize("name", CONFIGS)
def test_updates_equal_the_loop_over_agents(name, team):
    """Eight updates end at the parameters of the loop, by torch and on one core and three."""
    config = CONFIGS[name]
    engines = [Engine(config, team, 3, dtype=torch.float64, cores=cores) for cores in (1, 0, 3)]
    loop = Loop(config, team, *networks_of(engines[0], "networks"))
    start = engines[0].algorithm.actors.networks.flat.detach().clone()
    for batch in batches(team, config, 8):
        for engine in engines:
            engine.update(batch)
        loop.update(batch)
    assert float((engines[0].algorithm.actors.networks.flat.detach() - start).abs().max()) > 1e-3
    for engine in engines:
        for part, values, mixer in (
            ("networks", loop.values, loop.mixer),
            ("target", loop.target_values, loop.target_mixer),
        ):
            found, mixing = networks_of(engine, part)
            for one, other in zip(found, values, strict=True):
                torch.testing.assert_close(one[0], other.flat(), rtol=0, atol=1e-9)
            if mixer:
                torch.testing.assert_close(mixing[0], mixer.flat(), rtol=0, atol=1e-9)


@pytest.mark.parametrize("name", CONFIGS)
def test_diagnostics_are_of_the_team_and_change_nothing(name):
    """Every agent has the team's value, target and error; an update that reports them does what a silent one does."""
    measured, silent = (Engine(CONFIGS[name], CHOOSERS, 3) for _ in range(2))
    for batch in batches(CHOOSERS, CONFIGS[name], 4, torch.float32):
        found = measured.update(batch, diagnostics=True)
        assert silent.update(batch) is None
    assert found.objective is None
    for tensor in (found.td_error, found.target, found.q_value):
        assert tensor.shape == (CHOOSERS.agents, 16)
        assert torch.equal(tensor, tensor[:1].expand_as(tensor))
    torch.testing.assert_close(found.td_error, found.q_value - found.target)
    assert found.actor_gradient_norm.shape == (CHOOSERS.agents,)
    assert (found.critic_gradient_norm is None) == name.startswith("vdn")
    assert same_state(measured, silent)


def test_the_teams_value_rises_with_every_agents():
    """In any state, whatever the mixing network's weights; and by how much depends on the state."""
    torch.manual_seed(0)
    mixer = Mixer(QMIX, CHOOSERS, 0, torch.empty(0, dtype=torch.float64), cores=0)
    for scale in (1.0, -3.0):
        mixer.networks.flat.data.mul_(scale)
        q = torch.randn(CHOOSERS.agents, 16, dtype=torch.float64, requires_grad=True)
        mixer(q, torch.randn(16, CHOOSERS.observation_size, dtype=torch.float64)).sum().backward()
        assert (q.grad >= 0.0).all()
        assert (q.grad > 0.0).any(dim=1).all()
        assert (q.grad.std(dim=1) > 1e-3).all()


@pytest.mark.parametrize("width", [8, 32])
def test_the_mixture_begins_like_the_sum_in_states_of_any_size(width):
    """By how much the team's value rises with an agent's is about 1, where the states' numbers are small and large."""
    config = variant(QMIX, "qmix", batch=64, mixing_width=width)
    mixer = Mixer(config, CHOOSERS, 0, torch.empty(0, dtype=torch.float64), cores=0)
    random = torch.Generator().manual_seed(0)
    states = torch.randn(64, CHOOSERS.observation_size, dtype=torch.float64, generator=random)
    for scale in (0.1, 1.0, 100.0):
        q = torch.zeros(CHOOSERS.agents, 64, dtype=torch.float64, requires_grad=True)
        mixer(q, scale * states).sum().backward()
        assert q.grad.min() > 0.3
        assert q.grad.max() < 3.0
        assert q.grad.mean(dim=1).numpy() == pytest.approx(1.0, abs=0.5)


def test_the_agents_best_options_are_the_teams():
    """No other joint action of three agents has a higher value than the one that each finds by itself."""
    team = TeamSpec((GroupSpec("a", 3, 4, 1, choices=(4,)),))
    config = variant(QMIX, "qmix", batch=64)
    mixer = Mixer(config, team, 0, torch.empty(0, dtype=torch.float64), cores=0)
    values = torch.randn(3, 4, dtype=torch.float64, generator=torch.Generator().manual_seed(1))
    every = torch.cartesian_prod(*[torch.arange(4)] * 3).t()
    for seed in range(20):
        state = torch.randn(1, 12, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))
        found = mixer(values.gather(1, every), state.expand(64, -1))
        assert every[:, int(found.argmax())].tolist() == values.argmax(dim=1).tolist()


@pytest.mark.parametrize("name", ["vdn", "qmix"])
def test_an_option_that_is_forbidden_next_is_worth_nothing(name):
    """However much the networks think of it, targets do not change with its value."""
    targets = []
    for worth in (-50.0, 50.0):
        engine = Engine(CONFIGS[name], CHOOSERS, 3)
        (batch,) = batches(CHOOSERS, CONFIGS[name], 1, torch.float32)
        masked = batch.next_observation[:, CHOOSERS.observation_slices()[1]].unflatten(1, (3, 9))
        masked[..., -6:] = torch.tensor([1.0, 0.0, 1.0, 1.0, 0.0, 1.0])
        for networks in (engine.algorithm.actors.networks, engine.algorithm.actors.target):
            networks.stacks[1].layers[-1][0, [1, 4]] = worth
        targets.append(engine.update(batch, diagnostics=True).target.clone())
    assert torch.equal(*targets)


SIGNALS, STEPS = 3, 10


class Together(ParallelEnv):
    """Both agents are paid 1 where each names the signal that it sees; else nobody is paid."""

    metadata: ClassVar = {"name": "together"}

    def __init__(self):
        self.possible_agents = ["reader_0", "reader_1"]

    def observation_space(self, agent):
        return spaces.Box(0.0, 1.0, (SIGNALS,), np.float32)

    def action_space(self, agent):
        return spaces.Discrete(SIGNALS)

    def reset(self, seed=None, options=None):
        self.agents, self.random, self.time = list(self.possible_agents), np.random.default_rng(seed), 0
        return self._seen(), {agent: {} for agent in self.agents}

    def _seen(self):
        self.signal = {agent: int(self.random.integers(SIGNALS)) for agent in self.possible_agents}
        return {agent: np.eye(SIGNALS, dtype=np.float32)[signal] for agent, signal in self.signal.items()}

    def step(self, actions):
        paid = float(all(actions[agent] == self.signal[agent] for agent in self.agents))
        self.time += 1
        acted, over = self.agents, self.time == STEPS
        self.agents = [] if over else acted
        infos = {agent: {} for agent in acted}
        return self._seen(), dict.fromkeys(acted, paid), dict.fromkeys(acted, False), dict.fromkeys(acted, over), infos


QUICK = {
    "algorithm.hidden": 16,
    "algorithm.batch": 64,
    "algorithm.actor_rate": 5e-3,
    "algorithm.discount": 0.5,
    "algorithm.reward_scale": 1.0,
    "replay.warmup_steps": 200,
    "replay.updates_per_step": 0.5,
    "rollout.environments": 8,
    "rollout.chunk_steps": 10,
}


@pytest.mark.parametrize("name", ["vdn", "qmix"])
def test_two_agents_learn_to_be_right_together(name):
    """By the product's own path: chance earns 10 / 9 an episode, and the end nearly all of 10."""
    run = eia_sec.train(Together, algorithm=name, steps=3000, seed=1, settings=QUICK)
    assert run.actors.flat[0].shape[0] == 1, "the agents of a type share one network"
    untrained = eia_sec.evaluate("random", Together, farms=range(1000, 1050)).total.reward
    assert untrained < 2.0
    assert run.evaluate(scenarios=50).interval[0] > 9.0
    with pytest.raises(ConfigError, match=f"actors of {name} have no distribution to draw actions from"):
        run.evaluate(scenarios=2, sampled=True)


def test_workers_explore_by_epsilon():
    """In the warm-up all options are chance's; later a share that falls along the run, and at 0 none."""
    config = with_values(RunConfig(env=RunConfig().env).with_algorithm("vdn"), {"replay.warmup_steps": 100})
    assert config.exploration_at(0.0, 99) == (1.0, True)
    assert config.exploration_at(0.0, 100) == (1.0, False)
    assert config.exploration_at(0.15, 100)[0] == pytest.approx(0.525)
    assert config.exploration_at(0.9, 100)[0] == pytest.approx(0.05)
    settings = {"rollout.environments": 4, "rollout.chunk_steps": 200, "replay.warmup_steps": 0}
    config = with_values(RunConfig(steps=100).with_environment(f"{__name__}:Together").with_algorithm("vdn"), settings)
    collector = Collector(config, "0", 0)
    actors = OffPolicyTrainer(config, collector.team).actors()
    for epsilon, uniform, wanted in ((0.0, False, 0.0), (0.6, False, 0.4), (0.0, True, 2 / 3)):
        rows = collector.collect(actors, epsilon, uniform).rows
        own = rows.action[rows.flag > 0]
        differ = own != actors.act(rows.observation[rows.flag > 0])
        assert differ.mean() == pytest.approx(wanted, abs=0.05)
    collector.close()


def test_what_is_exported_takes_the_best_legal_option(tmp_path):
    """Models of a type's agents, and the saved policy, act as the networks of the values do, masks included."""
    config = with_values(
        RunConfig().with_environment("some.module:env").with_algorithm("qmix"), {"algorithm.hidden": 9}
    )
    actors = OffPolicyTrainer(config, CHOOSERS).actors()
    actors = replace(actors, flat=tuple(flat * np.float32(5.0) for flat in actors.flat))
    save_policy(tmp_path / "policy.safetensors", actors, {})
    loaded = load_policy(tmp_path / "policy.safetensors")[0]
    assert not loaded.draws
    (batch,) = batches(CHOOSERS, VDN, 1, torch.float32)
    rows = batch.observation.numpy()
    wanted = CHOOSERS.split_actions(actors.act(rows))
    np.testing.assert_array_equal(loaded.act(rows), actors.act(rows))
    export_onnx(tmp_path, config, loaded, {})
    for group, seen, best in zip(CHOOSERS.groups, CHOOSERS.split_observations(rows), wanted, strict=True):
        for index in range(group.count):
            model = onnxruntime.InferenceSession(tmp_path / f"{group.name}-{index}.onnx")
            (found,) = model.run(["action"], {"observation": np.ascontiguousarray(seen[:, index])})
            np.testing.assert_array_equal(found, best[:, index])
            assert len(np.unique(best[:, index], axis=0)) > 1


@pytest.mark.parametrize("name", ["vdn", "qmix"])
def test_other_rates_are_those_of_an_engine_that_begins_with_them(name):
    """Bit for bit, of the values and of the mixing network."""
    other = replace(CONFIGS[name], actor_rate=7e-4, **({"critic_rate": 9e-4} if name == "qmix" else {}))
    tuned, begun, slow = (Engine(config, CHOOSERS, 3) for config in (CONFIGS[name], other, CONFIGS[name]))
    tuned.retune(other)
    for batch in batches(CHOOSERS, other, 3, torch.float32):
        for engine in (tuned, begun, slow):
            engine.update(batch)
    assert same_state(tuned, begun)
    assert not same_state(tuned, slow)


def test_the_teams_values_are_compared_with_the_teams_returns():
    """With the mean of what all agents earned, not with an agent's own."""
    q = torch.full((3, 4), 2.0)
    found = Diagnostics(q * 0.0, None, q, q, of_team=True)
    running = RunningDiagnostics(TeamSpec((GroupSpec("a", 3, 4, 1, choices=(3,)),)), "cpu")
    running.compare(found, torch.tensor([[0.0, 1.0, 5.0]]).expand(4, -1), np.arange(4))
    assert running.means["realised_return"].tolist() == [2.0] * 3
    assert running.means["overestimation"].tolist() == [0.0] * 3
