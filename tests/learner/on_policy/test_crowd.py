"""The example of attention over neighbours: order and absence count for nothing, and a team of another size acts."""

import json

import numpy as np
import onnxruntime
import pytest
import torch
from crowd.env import NEIGHBOUR, OWN, Meet
from crowd.networks import Attention
from crowd.options import AttentionOptions

import eia_sec
from eia_sec.common.errors import PluginError
from eia_sec.common.policy_file import load_policy, save_policy
from eia_sec.deploy.policies.export import export_onnx
from eia_sec.rollout.policies import fitted

pytestmark = pytest.mark.usefixtures("nothing_stays_loaded")

SETTINGS = {
    "algorithm.network.name": "attention",
    "algorithm.network.width": 16,
    "algorithm.normalise_observations": False,
}
ROOM = 9


def test_neighbours_count_in_any_order_and_only_those_that_are_there():
    """Outputs depend on who is there, not on the slots; one neighbour more changes them."""
    torch.manual_seed(0)
    network = Attention((OWN + ROOM * NEIGHBOUR,), 5, AttentionOptions())
    torch.nn.init.orthogonal_(network.last.weight)
    seen = torch.randn(8, ROOM, NEIGHBOUR)
    seen[..., 0] = (torch.arange(ROOM) < 5).float()
    own = torch.randn(8, OWN)

    def outputs(neighbours):
        return network(torch.cat([own, neighbours.flatten(1)], dim=1))

    before = outputs(seen)
    torch.testing.assert_close(outputs(seen[:, torch.randperm(ROOM)]), before, rtol=0, atol=1e-5)
    noise = torch.where(seen[..., :1] > 0, seen, torch.cat([seen[..., :1], torch.randn(8, ROOM, 3)], dim=2))
    torch.testing.assert_close(outputs(noise), before, rtol=0, atol=1e-5)
    more = seen.clone()
    more[:, 5, 0] = 1.0
    assert ((outputs(more) - before).abs().max(dim=1).values > 1e-3).all()


def test_it_is_trained_exported_and_acts_in_a_team_of_another_size(tmp_path):
    """Four walkers learn a little; the same file flies two and nine of them, and its model acts as it does."""
    small = {"algorithm.iteration_steps": 80, "algorithm.minibatch_steps": 40, "algorithm.epochs": 2}
    small |= {"rollout.environments": 2, "rollout.chunk_steps": 20}
    run = eia_sec.train("meet", algorithm="ippo", plugins=["crowd"], steps=400, settings=SETTINGS | small)
    save_policy(tmp_path / "policy.safetensors", run.actors, {})
    for agents in (2, 9):
        arguments = {"env.arguments": json.dumps({"agents": agents})}
        found = eia_sec.evaluate(
            tmp_path / "policy.safetensors", "meet", plugins=["crowd"], settings=arguments, farms=range(1000, 1003)
        )
        assert np.isfinite(found.total.reward)
    paths = export_onnx(tmp_path / "export", run.config, load_policy(tmp_path / "policy.safetensors")[0], {})
    seen, _ = Meet(agents=4).reset(seed=3)
    rows = np.stack(list(seen.values()))
    team = run.actors.team
    actions = run.actors.act(rows.reshape(1, -1))[0]
    for index, path in enumerate(sorted(path for path in paths if path.suffix == ".onnx")):
        (acted,) = onnxruntime.InferenceSession(path).run(["action"], {"observation": rows[index : index + 1]})
        assert acted.item() == actions[index]
    assert len(paths) == team.agents + 1
    assert fitted(run.actors, team) is run.actors


def test_an_observation_of_another_layout_is_refused():
    """One sentence names plug-in and class, before anything is trained."""
    with pytest.raises(
        PluginError, match=r"plug-in crowd: crowd\.networks\.Attention raised ValueError: 4 numbers are"
    ):
        eia_sec.train("cover", plugins=["crowd", "mytask"], steps=400, settings=SETTINGS)


@pytest.mark.slow
def test_four_learn_what_nine_can_do():
    """After 24,000 steps of four walkers, nine of them come much closer to one another than by chance."""
    run = eia_sec.train("meet", plugins=["crowd"], steps=24_000, seed=1, settings=SETTINGS)
    nine = {"env.arguments": json.dumps({"agents": 9})}
    found, chance = (
        eia_sec.evaluate(policy, "meet", plugins=["crowd"], settings=nine, farms=range(1000, 1030)).interval
        for policy in (run.policy, "random")
    )
    assert found[0] > chance[1] + 6.0
