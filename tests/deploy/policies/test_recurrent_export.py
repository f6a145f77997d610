"""Exported actors with memory: ONNX models and plain tensors take and give back a state, and act as the policy does."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import onnxruntime
import pytest
from safetensors.numpy import load_file

from eia_sec.common.actions.sampling import best_options
from eia_sec.common.actors import TeamActors
from eia_sec.common.config import EnvConfig
from eia_sec.common.config.files import to_toml
from eia_sec.common.config.presets import preset
from eia_sec.common.farm import farm_team
from eia_sec.common.policy_file import save_policy
from eia_sec.common.team import GroupSpec, TeamSpec
from eia_sec.deploy.cli import dispatch
from eia_sec.deploy.policies.export import agent_names

PAGE = Path(__file__).resolve().parents[3] / "docs" / "how-to" / "export.md"
HIDDEN, STEPS = 12, 8
OTHER = TeamSpec((GroupSpec("chooser", 2, 9, 2, choices=(4, 3), masked=True), GroupSpec("flyer", 1, 4, 1)))


@pytest.fixture(params=["farm", "shared", "other"])
def run(request, tmp_path):
    """A run directory, its actors, and the observations of three environments over some steps."""
    config = preset("instant")
    team = OTHER if request.param == "other" else farm_team(config.farm)
    if request.param == "other":
        config = replace(config, env=EnvConfig("some.module:env"))
    actors = TeamActors.initial(
        team, HIDDEN, 3, per_type=False, head="gaussian", shared=request.param == "shared", memory="gru"
    )
    actors = replace(actors, flat=tuple(flat * np.float32(4.0) for flat in actors.flat))
    (tmp_path / "config.toml").write_text(to_toml(config))
    save_policy(tmp_path / "policy.safetensors", actors, {"seed": "3"})
    rows = np.random.default_rng(4).uniform(-1, 1, (STEPS, 3, team.observation_size)).astype(np.float32)
    return tmp_path, actors, rows


def played(actors, rows):
    """Yield for each step each agent's observations [3, o], its state after the step [3, h], and its actions."""
    team, state = actors.team, actors.initial_state(3)
    for step in rows:
        done = team.split_environment_actions(actors.environment_actions(step, state))
        both = zip(team.split_observations(step), done, strict=True)
        agents = [(o[:, i], a[:, i]) for o, a in both for i in range(o.shape[1])]
        yield {
            name: (o, state[:, place].copy(), a)
            for place, (name, (o, a)) in enumerate(zip(agent_names(actors), agents, strict=True))
        }


def test_onnx_models_remember_as_the_policy_does(run):
    """Step after step, with the state handed back, every model returns the actors' actions and states."""
    directory, actors, rows = run
    assert dispatch(["export", "--run-dir", str(directory)]) == 0
    models = {n: onnxruntime.InferenceSession(directory / "export" / f"{n}.onnx") for n in agent_names(actors)}
    states = {name: np.zeros((3, HIDDEN), np.float32) for name in models}
    moved = 0.0
    for agents in played(actors, rows):
        for name, (observation, state, action) in agents.items():
            inputs = {"observation": observation, "state": states[name]}
            found, states[name] = models[name].run(["action", "next_state"], inputs)
            np.testing.assert_allclose(states[name], state, atol=1e-5)
            np.testing.assert_allclose(found, action, atol=1e-4)
            moved = max(moved, float(np.ptp(state)))
    assert moved > 0.5
    metadata = models[agent_names(actors)[0]].get_modelmeta().custom_metadata_map
    assert metadata["format"] == "eia-sec recurrent actors 2"
    assert f"`{metadata['format']}`" in PAGE.read_text(encoding="utf-8")
    assert metadata["sha256"] == actors.digest()


def sigmoid(x):
    return 1.0 / (1.0 + np.exp(-x))


def test_plain_tensors_are_those_of_the_stated_formula(run, tmp_path_factory):
    """The file holds eight arrays for each agent, whose arithmetic gives the actors' actions and states."""
    directory, actors, rows = run
    out = tmp_path_factory.mktemp("elsewhere")
    assert dispatch(["export", "--run-dir", str(directory), "--format", "safetensors", "--out", str(out)]) == 0
    tensors, described = load_file(out / "actors.safetensors"), json.loads((out / "actors.json").read_text())
    assert len(tensors) == 8 * actors.team.agents
    assert "next h = n + y (h - n)" in described["network"]
    states = dict.fromkeys(described["agents"], np.zeros((3, HIDDEN)))
    for agents in played(actors, rows):
        for name, (observation, state, action) in agents.items():
            w1, b1, w, b, u, c, w3, b3 = (
                tensors[f"{name}.{layer}"] for layer in ("w1", "b1", "w", "b", "u", "c", "w3", "b3")
            )
            h = states[name]
            p = np.split(np.maximum(observation @ w1 + b1, 0) @ w + b, 3, axis=1)
            q = np.split(h @ u + c, 3, axis=1)
            r, y = sigmoid(p[0] + q[0]), sigmoid(p[1] + q[1])
            n = np.tanh(p[2] + r * q[2])
            states[name] = n + y * (h - n)
            np.testing.assert_allclose(states[name], state, atol=1e-5)
            group = next(group for group in actors.team.groups if name.startswith(group.name))
            z = states[name] @ w3 + b3
            z = best_options(group, observation, z) if group.choices else np.tanh(z)
            np.testing.assert_allclose(group.adapt(observation, z), action, atol=1e-4)
