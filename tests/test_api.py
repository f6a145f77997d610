"""The public face: what `import eia_sec` offers."""

import subprocess
import sys

import numpy as np
import pytest

import eia_sec
from eia_sec.common.config.files import with_values
from eia_sec.common.config.presets import preset
from eia_sec.common.errors import ConfigError, PolicyError
from eia_sec.common.policy_file import save_policy

SHORT = {"farm.world.steps": 20, "episodes": 2, "rollout.environments": 2, "rollout.chunk_steps": 20}


def test_importing_it_loads_neither_torch_nor_the_simulator():
    """A bare import is cheap; the first use of a name loads what it needs."""
    code = "import sys, eia_sec; print(sorted({'torch', 'numba', 'numpy'} & set(sys.modules)), dir(eia_sec))"
    printed = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert printed.strip() == f"[] {sorted(eia_sec.__all__)}"


def test_an_unknown_name_is_an_attribute_error():
    """The lazy loading does not invent names."""
    with pytest.raises(AttributeError, match="no attribute 'tain'"):
        _ = eia_sec.tain


def test_a_policy_is_trained_saved_loaded_and_evaluated(tmp_path):
    """What comes back from the file scores what the trained policy scores, and a configuration is as good as a name."""
    policy = eia_sec.train("quick", SHORT)
    save_policy(tmp_path / "policy.safetensors", policy, {})
    assert eia_sec.load_policy(tmp_path / "policy.safetensors").digest() == policy.digest()
    found = eia_sec.evaluate(policy, "quick", settings=SHORT, farms=[1000, 1001])
    held = with_values(preset("quick"), SHORT)
    again = eia_sec.evaluate(tmp_path / "policy.safetensors", held, farms=[1000, 1001])
    assert found.total == again.total
    assert found.farms == (1000, 1001)


def test_a_policy_acts_in_an_environment():
    """A shipped policy's actions for the observations of all agents are steps of the environment."""
    policy, env = eia_sec.load_policy("trained"), eia_sec.make_env(settings={"farm.world.steps": 3})
    observations, _ = env.reset(seed=0)
    while env.agents:
        row = np.concatenate([observations[agent] for agent in env.agents])
        actions = policy.environment_actions(row[None])[0].reshape(len(env.agents), -1)
        observations, rewards, *_ = env.step(dict(zip(env.agents, actions, strict=True)))
    assert len(rewards) == len(env.possible_agents)


def test_mistakes_are_named():
    """A preset, a policy and an environment that do not fit are errors of one sentence."""
    with pytest.raises(ConfigError, match="there is no preset 'fast'"):
        eia_sec.train("fast")
    with pytest.raises(PolicyError, match="nothing-here"):
        eia_sec.evaluate("nothing-here")
    with pytest.raises(ConfigError, match="make_env makes farms"):
        eia_sec.make_env(settings={"env.name": "mpe2:simple_spread_v3"})
