"""Networks of a plug-in learn on policy: they train, part, resume and act as the learner says."""

import sys
from dataclasses import replace
from itertools import pairwise
from types import ModuleType

import numpy as np
import pytest
import torch
from torch import nn

import eia_sec
from eia_sec.common import plugins
from eia_sec.common.config.files import digest, from_toml, read_saved, to_toml, with_values
from eia_sec.common.config.presets import preset
from eia_sec.common.errors import ConfigError, PluginError, PolicyError, SchemaError
from eia_sec.common.protocol.chunk_messages import to_message
from eia_sec.common.protocol.chunk_rules import ChunkRules
from eia_sec.common.protocol.message_sizes import chunk_bytes
from eia_sec.common.protocol.messages import ChunkMessage
from eia_sec.learner.on_policy import updates as on_policy_updates
from eia_sec.learner.on_policy.experience import step_rows
from eia_sec.learner.on_policy.mappo import joined_images
from eia_sec.learner.trainers import make_trainer
from eia_sec.rollout.envs.networks import require_networks
from eia_sec.rollout.envs.registry import environment_spec
from eia_sec.rollout.start_policy import start_parameters
from eia_sec.rollout.worker.collector import Collector

pytestmark = pytest.mark.usefixtures("nothing_stays_loaded")

SMALL = {
    "algorithm.network.name": "cnn",
    "algorithm.network.channels": 2,
    "algorithm.network.width": 8,
    "algorithm.iteration_steps": 80,
    "algorithm.minibatch_steps": 40,
    "algorithm.epochs": 2,
    "rollout.environments": 2,
    "rollout.chunk_steps": 20,
}
PARTED = {"algorithm.shared_until": 0.3, "elite.cycle": 2}


def configured(settings=SMALL, algorithm="ippo", env="pictures.env:Lights"):
    """Return a configuration of the generic preset, with the example plug-in loaded."""
    for name in ("mytask", "pictures"):
        plugins.load(name)
    return with_values(preset("generic").with_environment(env).with_algorithm(algorithm), settings)


class Layers(nn.Module):
    """Reads vectors."""

    def __init__(self, shape, outputs, options):
        super().__init__()
        self.layers = nn.Sequential(nn.Linear(*shape, 8), nn.Tanh(), nn.Linear(8, outputs))

    def forward(self, x):
        return self.layers(x)


class Keeping(Layers):
    """Keeps what it has computed, as attention weights are kept to be looked at."""

    def forward(self, x):
        self.seen = super().forward(x)
        return self.seen


VECTORS = {key: value for key, value in SMALL.items() if "network." not in key} | {"algorithm.precision": "float32"}


@pytest.fixture
def vectors(monkeypatch):
    """A plug-in with networks for vectors."""
    module = ModuleType("mine")
    module.Layers, module.Keeping = Layers, Keeping
    networks = {name.lower(): plugins.PluginNetwork(f"mine:{name}") for name in ("Layers", "Keeping")}
    module.plugin = plugins.Plugin(networks=networks)
    monkeypatch.setitem(sys.modules, "mine", module)
    plugins.load("mine")


@pytest.mark.parametrize(("algorithm", "more"), [("ippo", {}), ("mappo", {}), ("eia-ppo", PARTED)])
def test_a_cnn_is_trained(algorithm, more):
    """The same seed gives the same actors; parted agents have rows of their own."""
    first, again = (
        eia_sec.train("lights", algorithm=algorithm, plugins=["pictures"], steps=400, settings=SMALL | more).actors
        for _ in range(2)
    )
    assert first.digest() == again.digest()
    assert len(first.flat[0]) == (2 if more else 1)
    assert np.isfinite(first.flat[0]).all()


@pytest.mark.slow
def test_a_cnn_learns_from_pictures():
    """Well beyond random actions, after 24,000 steps of the example as it is."""
    run = eia_sec.train(
        "lights", plugins=["pictures"], steps=24_000, seed=1, settings={"algorithm.network.name": "cnn"}
    )
    random = eia_sec.evaluate("random", "lights", plugins=["pictures"], farms=range(1000, 1050))
    assert run.evaluate(scenarios=50).interval[0] > random.interval[1] + 3.0


def collected(config, actors, chunks=1, start=0):
    """Return chunks of a collector with these actors."""
    collector = Collector(config, "0", start)
    return [collector.collect(actors, 0.0, uniform=False) for _ in range(chunks)]


def test_images_travel_and_are_kept_as_bytes():
    """A pixel of a channel takes one byte in rows, in messages and in the learner, whatever `precision` says."""
    config = configured()
    collector = Collector(config, "0", 0)
    trainer = make_trainer(config, collector.team)
    (chunk,) = collected(config, trainer.actors())
    seen = chunk.rows.observation
    assert (seen.dtype, seen.shape[1]) == (np.uint8, 2 * 6 * 6 * 3)
    assert set(np.unique(seen)) == {0, 255}
    message = to_message(chunk, collector.team, 1, chunk.rows.steps)
    rules = ChunkRules.of(config, collector.environments.spec)
    sent = message.encode()
    assert len(sent) < min(2 * seen.nbytes, chunk_bytes(config, collector.environments.spec))
    found = rules.chunk_of(ChunkMessage.decode(sent), collector.team)
    np.testing.assert_array_equal(found.rows.observation, seen)
    for wrong in (seen.astype(np.float32), seen.astype(np.uint16)):
        forged = replace(message, observation=wrong)
        with pytest.raises(SchemaError, match=r"observation is .*, not uint8"):
            rules.chunk_of(ChunkMessage.decode(forged.encode()), collector.team)
    trainer.absorb(found, 1)
    assert trainer.snapshot()[0]["iteration.observation"].dtype == torch.uint8


def test_a_run_of_images_continues_bit_equal():
    """From a checkpoint between iterations, in the midst of one, and while updates are due."""
    config = configured()
    fresh = make_trainer(config, Collector(config, "0", 0).team)
    chunks = collected(config, fresh.actors(), 6)

    def played(trainer, some, restarts=()):
        for index, chunk in enumerate(some):
            trainer.absorb(chunk, 1, "0", index + 1)
            for _ in range(trainer.updates_due()):
                trainer.train(1)
                if (index, trainer.updates) in restarts:
                    again = make_trainer(config, trainer.team)
                    again.restore(*trainer.state())
                    trainer = again
        return trainer

    whole = played(fresh, chunks)
    again = played(make_trainer(config, whole.team), chunks, {(1, 1), (1, 4), (3, 6), (3, 7)})
    assert whole.updates == again.updates == 12
    assert whole.actors().digest() == again.actors().digest()
    largest = sum(tensor.nbytes for name, tensor in again.state()[0].items() if tensor.nbytes > 4096)
    assert largest <= again.largest_checkpoint()


@pytest.mark.parametrize("algorithm", ["ippo", "mappo"])
def test_actors_of_vectors_read_observations_as_they_are(vectors, algorithm):
    """The learner's networks read scaled observations, published ones raw ones; both give the same logits."""
    config = configured(VECTORS | {"algorithm.network.name": "layers"}, algorithm, "mytask.env:Cover")
    assert config.on_policy.normalise_observations
    trainer = make_trainer(config, Collector(config, "0", 0).team)
    for index, chunk in enumerate(collected(config, trainer.actors(), 4)):
        trainer.absorb(chunk, 1, "0", index + 1)
        trainer.train(trainer.updates_due())
    updates = trainer._updates
    shift, scale = updates._scales.of_type(0)
    assert not torch.equal(scale, torch.ones_like(scale))
    rows = torch.randn(7, 2, 4)
    inside = updates.policies.stacks[0]((rows - shift) / scale).detach().numpy()
    ((_, _, outside),) = trainer.actors().outputs(rows.flatten(1).numpy())
    np.testing.assert_allclose(outside, inside, atol=1e-5)
    before = trainer.actors()
    trainer.load_actors(before.flat)
    np.testing.assert_allclose(trainer.actors().flat[0], before.flat[0], atol=1e-5)


@pytest.mark.parametrize("algorithm", ["ippo", "mappo"])
def test_actors_learn_from_the_inputs_that_they_acted_on(vectors, algorithm, monkeypatch):
    """Ratios of policies are 1 before an iteration's first update, though scales move with every iteration."""
    config = configured(VECTORS | {"algorithm.network.name": "layers"}, algorithm, "mytask.env:Cover")
    collector = Collector(config, "0", 0)
    trainer = make_trainer(config, collector.team)
    updates, begin, scales = trainer._updates, trainer._updates.begin, [trainer._updates._scales.of_type(0)[1]]

    def begin_and_compare(rows, steps):
        begin(rows, steps)
        used = step_rows(rows)
        newest = updates._newest_log_probability(rows).numpy()
        np.testing.assert_allclose(newest[used], rows.log_probability[used], atol=1e-4)

    monkeypatch.setattr(updates, "begin", begin_and_compare)
    for number in range(1, 7):
        trainer.absorb(collector.collect(trainer.actors(), 0.0, uniform=False), 1, "0", number)
        if trainer.updates_due():
            trainer.train(trainer.updates_due())
            scales.append(updates._scales.of_type(0)[1])
    assert trainer.iterations == 3
    assert not any(torch.equal(one, other) for one, other in pairwise(scales))


def test_few_rows_of_large_images_are_read_at_once(monkeypatch):
    """Values are the same whatever the number of rows, which images of eight agents would else make gigabytes of."""
    config = configured(SMALL | {"algorithm.precision": "float32"})
    collector, most = Collector(config, "0", 0), []
    trainer = make_trainer(config, collector.team)
    trainer.absorb(collector.collect(trainer.actors(), 0.0, uniform=False), 1, "0", 1)
    updates, value = trainer._updates, trainer._updates.values[0].value
    monkeypatch.setattr(updates.values[0], "value", lambda team, own: most.append(len(own)) or value(team, own))
    updates._load(trainer.experience.rows())
    whole = updates._values_of(0)
    monkeypatch.setattr(on_policy_updates, "MOST_INPUTS", 7 * 2 * 6 * 6 * 3)
    parts = updates._values_of(0)
    assert (most[0], max(most[1:])) == (len(whole), 7)
    torch.testing.assert_close(parts, whole)


def test_a_module_may_keep_what_it_computes(vectors):
    """Its parameters are published after each iteration all the same."""
    run = eia_sec.train(
        "mytask.env:Cover",
        plugins=["mytask", "mine"],
        steps=160,
        settings=VECTORS | {"algorithm.network.name": "keeping"},
    )
    assert run.config.on_policy.normalise_observations
    assert np.isfinite(run.actors.flat[0]).all()


def test_joined_images_have_the_channels_of_all_agents():
    """A pixel's channels are those of the first agent, then those of the second, and so on."""
    team = Collector(configured(), "0", 0).team
    image = torch.arange(5 * 2 * 6 * 6 * 3).remainder(251).to(torch.uint8).view(5, 2, 6, 6, 3)
    joined = joined_images(team, image.reshape(5, -1)).view(5, 6, 6, 6)
    for agent in range(2):
        assert torch.equal(joined[..., 3 * agent : 3 * agent + 3], image[:, agent])
    assert team.seen == (6, 6, 6)


def test_a_run_begins_as_a_policy_of_the_same_network(tmp_path):
    """It acts as the policy does before the first update; another network, or other options, are refused."""
    run = eia_sec.train("lights", plugins=["pictures"], steps=80, settings=SMALL)
    run.policy.save(path := tmp_path / "policy.safetensors")
    begun = {"algorithm.start_policy.all": str(path)}
    config = configured(SMALL | begun)
    team = run.actors.team
    trainer = make_trainer(config, team)
    trainer.begin_with(start_parameters(config, team))
    assert trainer.actors().digest() == run.actors.digest()
    with pytest.raises(PolicyError, match="fits no type of this run"):
        start_parameters(configured(SMALL | begun | {"algorithm.network.width": 9}), team)


def test_a_configuration_names_its_network():
    """It reads back as it was, with the network's options; a run without one has the digest that it had."""
    config = configured()
    assert config.on_policy.module.channels == 2
    assert read_saved(to_toml(config)) == config
    assert digest(config) != digest(configured(SMALL | {"algorithm.network.channels": 3}))
    plain = preset("generic")
    assert plain.module is None
    assert digest(from_toml('algorithm.network.name = "mlp"', plain)) == digest(plain)
    with pytest.raises(ConfigError, match=r"algorithm\.network\.name must be one of mlp, cnn, not 'rnn'"):
        from_toml('algorithm.network.name = "rnn"', plain)
    with pytest.raises(ConfigError, match=r"algorithm\.network has no effect with maddpg; it is an option of ippo"):
        from_toml('algorithm.network.name = "cnn"', plain.with_algorithm("maddpg"))
    with pytest.raises(ConfigError, match="memory gru is one of network mlp; cnn has none"):
        with_values(config, {"algorithm.memory": "gru", "algorithm.minibatch_steps": 80})


@pytest.mark.parametrize(
    ("settings", "algorithm", "env", "said"),
    [
        ({}, "ippo", "pictures.env:Lights", r"see images of \[6, 6, 3\], which the perceptrons .*--plugin pictures"),
        ({}, "masac", "pictures.env:Lights", "see images of .*, from which masac does not learn; ippo, .*eia-ppo"),
        (
            SMALL,
            "ippo",
            "mytask.env:Cover",
            "see vectors of 4 numbers, and the network cnn of the plug-in",
        ),
    ],
)
def test_networks_that_cannot_read_are_refused(settings, algorithm, env, said):
    """One sentence, with the agents, what they see, and what could read it."""
    config = configured(settings, algorithm, env)
    team = Collector(configured(env=env), "0", 0).team
    with pytest.raises(ConfigError, match=said):
        require_networks(config, team)


def test_options_that_no_network_can_have_are_refused_before_a_process_starts():
    """A network without channels has a size, and is made without memory for it; only a call shows what is wrong."""
    with pytest.raises(PluginError, match=r"plug-in pictures: pictures\.networks\.Cnn.* raised "):
        environment_spec(configured(SMALL | {"algorithm.network.channels": 0}))
