"""Exported actors: they act as the policy does, wherever they are run."""

import json
import re
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import onnxruntime
import pytest
from safetensors.numpy import load_file

from eia_sec.common.actions.adapters import SIGNS, MirroredAxes
from eia_sec.common.actions.descriptions import ADAPTERS
from eia_sec.common.actions.sampling import best_options
from eia_sec.common.actors import TeamActors
from eia_sec.common.config import (
    ControlConfig,
    EnvConfig,
    FarmConfig,
    MasacConfig,
    ObservationConfig,
    ReplayConfig,
    RunConfig,
)
from eia_sec.common.config.files import to_toml
from eia_sec.common.config.presets import preset
from eia_sec.common.farm import farm_team
from eia_sec.common.policy_file import save_policy
from eia_sec.common.team import GroupSpec, TeamSpec
from eia_sec.common.transitions import TRANSITION, Chunk, Rows
from eia_sec.deploy.cli import dispatch
from eia_sec.deploy.exit_codes import run_command
from eia_sec.deploy.policies.export import agent_names, tensor_names
from eia_sec.deploy.policies.onnx_actions import NODES
from eia_sec.learner.off_policy.trainer import OffPolicyTrainer
from eia_sec.rollout.sim.batch import FarmBatch

PAGE = Path(__file__).resolve().parents[3] / "docs" / "how-to" / "export.md"


CHOICES = ControlConfig(communication="headings", monitoring="moves", collection="moves", monitoring_inset=0.36)
"""Discrete control of every type; steps end inside cells, not at their centres."""


@pytest.fixture(params=["farm", "mirrored", "other", "choices", "mirrored choices", "masked"])
def run(request, tmp_path):
    """A run directory with a policy of random parameters, its actors, and rows of observations."""
    config, draw = preset("eia-sec"), np.random.default_rng(4)
    if "choices" in request.param:
        mirrored = replace(config.farm.observation, mirrored="mirrored" in request.param)
        config = replace(config, farm=replace(config.farm, control=CHOICES, observation=mirrored))
    if request.param == "mirrored":
        mirrored = replace(config.farm.observation, mirrored=True)
        config = replace(config, farm=replace(config.farm, observation=mirrored))
    team = farm_team(config.farm)
    if request.param == "other":
        config = replace(config, env=EnvConfig("some.module:env"))
        team = TeamSpec((GroupSpec("walker", 2, 5, 3), GroupSpec("flyer", 1, 4, 1)))
    if request.param == "masked":
        config = replace(config, env=EnvConfig("some.module:env"))
        team = TeamSpec((GroupSpec("chooser", 2, 9, 2, choices=(4, 3), masked=True), GroupSpec("flyer", 1, 4, 1)))
    actors = TeamActors.initial(team, 24, 3, per_type=False, shared=request.param == "masked")
    actors = TeamActors(team, 24, tuple(flat * np.float32(5.0) for flat in actors.flat))
    (tmp_path / "config.toml").write_text(to_toml(config))
    save_policy(tmp_path / "policy.safetensors", actors, {"seed": "3", "episodes": "12"})
    rows = draw.uniform(-1, 1, (50, team.observation_size)).astype(np.float32)
    for group, own in zip(team.groups, team.split_observations(rows), strict=True):
        if MirroredAxes() in group.adapters:
            own[..., SIGNS] = draw.choice([-1.0, 1.0], own[..., SIGNS].shape)
    return tmp_path, actors, rows


def by_agent(actors, rows):
    """Return each agent's observations and actions by its name."""
    team = actors.team
    seen, done = team.split_observations(rows), team.split_environment_actions(actors.environment_actions(rows))
    both = [(o[:, i], a[:, i]) for o, a in zip(seen, done, strict=True) for i in range(o.shape[1])]
    return dict(zip(agent_names(actors), both, strict=True))


def test_onnx_models_act_as_the_policy_does(run, capsys):
    """In onnxruntime every agent's model returns the actors's actions, for one observation and for many."""
    directory, actors, rows = run
    assert dispatch(["export", "--run-dir", str(directory)]) == 0
    printed = capsys.readouterr().out.split()
    for name, (observation, action) in by_agent(actors, rows).items():
        path = directory / "export" / f"{name}.onnx"
        assert str(path) in printed
        model = onnxruntime.InferenceSession(path)
        assert np.ptp(action) > 0.3
        for part in (slice(0, 50), slice(7, 8)):
            (found,) = model.run(["action"], {"observation": observation[part]})
            np.testing.assert_allclose(found, action[part], atol=2e-6)
        metadata = model.get_modelmeta().custom_metadata_map
        assert len(json.loads(metadata["observation"])) == observation.shape[1]
        assert len(json.loads(metadata["action"])) == action.shape[1]
        assert metadata["sha256"] == actors.digest()
        assert json.loads(metadata["origin"])["seed"] == "3"


def test_what_masac_trained_is_exported(tmp_path):
    """Models of MASAC's actors act as these without noise do."""
    team, draw = TeamSpec((GroupSpec("walker", 2, 5, 3), GroupSpec("flyer", 1, 4, 1))), np.random.default_rng(4)
    config = replace(
        preset("eia-sec").with_algorithm("masac"),
        env=EnvConfig("some.module:env"),
        algorithm=MasacConfig(hidden=8, batch=16, actor_rate=0.05),
        replay=ReplayConfig(capacity=320, warmup_steps=0),
    )
    flag = np.full(200, TRANSITION, np.uint8)
    flag[-1] = 0
    seen = draw.normal(3.0, 5.0, (200, team.observation_size)).astype(np.float32)
    tried = draw.uniform(-1, 1, (200, team.action_size)).astype(np.float32)
    trainer = OffPolicyTrainer(config, team)
    trainer.absorb(Chunk(Rows(seen, tried, draw.normal(size=(200, team.agents)).astype(np.float32), flag)))
    trainer.train(20)
    actors = trainer.actors()
    assert actors.head == "gaussian"
    (tmp_path / "config.toml").write_text(to_toml(config))
    save_policy(tmp_path / "policy.safetensors", actors, {"seed": "3"})
    assert dispatch(["export", "--run-dir", str(tmp_path)]) == 0
    for name, (observation, action) in by_agent(actors.noise_free(), seen).items():
        (found,) = onnxruntime.InferenceSession(tmp_path / "export" / f"{name}.onnx").run(
            ["action"], {"observation": observation}
        )
        np.testing.assert_allclose(found, action, atol=2e-5)
        assert np.ptp(action) > 0.01


def test_plain_tensors_are_the_policys_own(run, tmp_path_factory):
    """The file holds six arrays for each agent, whose arithmetic gives the actors's actions."""
    directory, actors, rows = run
    out = tmp_path_factory.mktemp("elsewhere")
    assert dispatch(["export", "--run-dir", str(directory), "--format", "safetensors", "--out", str(out)]) == 0
    tensors = load_file(out / "actors.safetensors")
    assert len(tensors) == 6 * actors.team.agents
    for name, (observation, action) in by_agent(actors, rows).items():
        h, group = observation, next(group for group in actors.team.groups if name.startswith(group.name))
        for layer in "123":
            h = h @ tensors[f"{name}.w{layer}"] + tensors[f"{name}.b{layer}"]
            h = h if layer == "3" else np.maximum(h, 0)
        h = best_options(group, observation, h) if group.choices else np.tanh(h)
        np.testing.assert_allclose(group.adapt(observation, h), action, atol=2e-6)


def test_the_pages_code_runs_and_gives_the_policys_actions(run, monkeypatch, capsys):
    """What docs/how-to/export.md shows is run as it stands there."""
    directory, actors, rows = run
    if not actors.team.groups[0].name.startswith("communication"):
        pytest.skip("the page's code names a UAV of the farm")
    for kind in ("onnx", "safetensors"):
        dispatch(["export", "--run-dir", str(directory), "--format", kind])
    monkeypatch.chdir(directory)
    onnx_code, plain_code = re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.DOTALL)
    first, second = {}, {}
    exec(onnx_code, first)
    exec(plain_code, second)
    zeros = by_agent(actors, np.zeros_like(rows[:1]))
    np.testing.assert_allclose(first["action"], zeros["communication-0"][1], atol=2e-6)
    for name, (observation, action) in by_agent(actors, rows).items():
        np.testing.assert_allclose(second["act"](name, observation), action, atol=2e-6)
    assert "collection-" in capsys.readouterr().out


@pytest.mark.parametrize("name", ["../../pwned", "{outside}/pwned"])
@pytest.mark.parametrize("kind", ["onnx", "safetensors"])
def test_a_policy_cannot_name_files_elsewhere(tmp_path, capsys, name, kind):
    """A file whose team has a path for a name is refused before anything is written."""
    directory, outside = tmp_path / "runs" / "mine", tmp_path / "outside"
    directory.mkdir(parents=True)
    outside.mkdir()
    team = TeamSpec((GroupSpec("walker", 1, 5, 3),))
    (directory / "config.toml").write_text(to_toml(RunConfig(env=EnvConfig("some.module:env"))))
    save_policy(directory / "policy.safetensors", TeamActors.initial(team, 8, 1, per_type=False), {})
    data = (directory / "policy.safetensors").read_bytes()
    header = json.loads(data[8 : 8 + int.from_bytes(data[:8], "little")])
    hostile = name.format(outside=outside)
    described = json.loads(header["__metadata__"]["team"])
    described["groups"][0]["name"] = hostile
    header["__metadata__"]["team"] = json.dumps(described)
    header[hostile] = header.pop("walker")
    text = json.dumps(header).encode()
    body = data[8 + int.from_bytes(data[:8], "little") :]
    (directory / "policy.safetensors").write_bytes(len(text).to_bytes(8, "little") + text + body)
    before = sorted(tmp_path.rglob("*"))
    assert run_command(lambda: dispatch(["export", "--run-dir", str(directory), "--format", kind])) == 2
    assert "must be 1 to 63 letters" in capsys.readouterr().err
    assert sorted(tmp_path.rglob("*")) == before


@pytest.mark.parametrize(("kind", "name"), [("onnx", "walker-0.onnx"), ("safetensors", "actors.safetensors")])
def test_export_follows_no_link(tmp_path, capsys, kind, name):
    """A link in the place of a file is replaced, and one in the place of the run's own folder is refused."""
    team, outside = TeamSpec((GroupSpec("walker", 1, 5, 3),)), tmp_path / "outside"
    outside.mkdir()
    (outside / "file").write_text("mine")
    directory = tmp_path / "run"
    (directory / "export").mkdir(parents=True)
    (directory / "config.toml").write_text(to_toml(RunConfig(env=EnvConfig("some.module:env"))))
    save_policy(directory / "policy.safetensors", TeamActors.initial(team, 8, 1, per_type=False), {})
    (directory / "export" / name).symlink_to(outside / "file")
    arguments = ["export", "--run-dir", str(directory), "--format", kind]
    assert run_command(lambda: dispatch(arguments)) == 0
    assert not (directory / "export" / name).is_symlink()
    (directory / "export").rename(directory / "before")
    (directory / "export").symlink_to(outside)
    assert run_command(lambda: dispatch(arguments)) == 2
    assert "symbolic link" in capsys.readouterr().err
    assert [(path.name, path.read_text()) for path in outside.iterdir()] == [("file", "mine")]


@pytest.mark.parametrize(
    "observation",
    [ObservationConfig(), ObservationConfig(sensors=30, form="printed"), ObservationConfig(mirrored=True)],
)
def test_every_number_has_a_name_of_its_own(observation):
    """Names are as many as numbers, and no two are equal."""
    config = RunConfig(farm=FarmConfig(observation=observation))
    for group in farm_team(config.farm).groups:
        names = tensor_names(config, group).observation
        assert len(names) == len(set(names)) == group.observation_size
        assert len(tensor_names(config, group).action) == group.environment_action_size


@pytest.mark.parametrize("mirrored", [False, True])
def test_names_stand_where_the_simulator_writes(mirrored):
    """Own place, signs, AoI, VDF and distances are found under their names in a real observation."""
    config = RunConfig(farm=FarmConfig(observation=ObservationConfig(mirrored=mirrored)))
    farms = FarmBatch(config.farm, 1)
    farms.reset(0, 0, 0)
    for _ in range(30):
        farms.step(np.random.default_rng(1).uniform(-1, 1, (1, farms.team.environment_action_size)).astype(np.float32))
    for group, seen in zip(farms.team.groups, farms.team.split_observations(farms.observation), strict=True):
        named = [dict(zip(tensor_names(config, group).observation, row, strict=True)) for row in seen[0]]
        for numbers in named:
            signs = [value for name, value in numbers.items() if name.startswith("sign_")]
            assert len(signs) == 2 * mirrored
            assert set(signs) <= {-1.0, 1.0}
            assert all(0.0 <= value <= 1.0 for name, value in numbers.items() if name.endswith(("distance", "aoi")))
            assert all(0.0 <= value <= 1.0 for name, value in numbers.items() if name.startswith("vdf_"))
            for kind in ("d_vdf", "d_aoi"):
                if f"{kind}_x" in numbers:
                    length = np.hypot(numbers[f"{kind}_x"], numbers[f"{kind}_y"])
                    assert length == pytest.approx(0.0) or length == pytest.approx(1.0, abs=1e-5)
            sensors = [
                np.hypot(numbers[f"sensor_{i}_dx"], numbers[f"sensor_{i}_dy"])
                for i in range(3)
                if "sensor_0_dx" in numbers
            ]
            assert sensors == sorted(sensors) or any(numbers[f"sensor_{i}_aoi"] == 0 for i in range(3))


def test_what_cannot_be_exported_is_said(tmp_path, monkeypatch, capsys, run):
    """A folder without a run or a policy, a missing package, and a folder that cannot be written are one sentence."""
    directory = run[0]
    monkeypatch.setitem(sys.modules, "onnx", None)
    cases = {
        "there is no directory": ["--run-dir", str(tmp_path / "none")],
        "needs the package onnx": ["--run-dir", str(directory)],
        "cannot be written": ["--run-dir", str(directory), "--format", "safetensors", "--out", "config.toml/x"],
    }
    monkeypatch.chdir(directory)
    (tmp_path / "taken" / "actors.safetensors").mkdir(parents=True)
    cases["actors.safetensors cannot be written"] = [*cases["cannot be written"][:-1], str(tmp_path / "taken")]
    for words, arguments in cases.items():
        assert run_command(lambda arguments=arguments: dispatch(["export", *arguments])) == 2
        assert words in capsys.readouterr().err
    (directory / "policy.safetensors").unlink()
    assert run_command(lambda: dispatch(["export", "--run-dir", str(directory)])) == 2
    assert "has not saved a policy yet" in capsys.readouterr().err


def test_every_kind_of_adapter_can_be_exported():
    """An adapter without ONNX nodes would end an export in a traceback."""
    assert set(NODES) == set(ADAPTERS)


@pytest.mark.parametrize("form", ["onnx", "safetensors"])
def test_a_policy_of_another_team_is_refused(tmp_path, capsys, form):
    """Files with another team's actors and this run's description would be wrong; none is written."""
    config = preset("eia-sec")
    other = replace(config.farm, world=replace(config.farm.world, monitoring_uavs=1))
    (tmp_path / "config.toml").write_text(to_toml(config))
    save_policy(tmp_path / "policy.safetensors", TeamActors.initial(farm_team(other), 8, 0), {})
    words = ["export", "--run-dir", str(tmp_path), "--format", form]
    assert run_command(lambda: dispatch(words)) == 2
    error = capsys.readouterr().err
    assert "the policy is for " in error
    assert error.count("\n") == 1
    assert not (tmp_path / "export").exists()
