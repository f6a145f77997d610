"""Images of a PettingZoo environment: bytes stay bytes."""

import numpy as np
import pytest
from gymnasium import spaces
from pictures.env import Lights

import eia_sec
from eia_sec.common.config import EnvConfig
from eia_sec.common.errors import ContractError
from eia_sec.common.team import GroupSpec, TeamSpec
from eia_sec.rollout.agent_policy import Policy
from eia_sec.rollout.envs.pettingzoo_batch import PettingZooBatch
from eia_sec.rollout.envs.pettingzoo_observations import AgentView

IMAGE = spaces.Box(0, 255, (2, 3, 4), np.uint8)


def view_of(space, choices=(5,), informed=False):
    """Return an agent's view."""
    return AgentView.of("a", space, choices, informed=informed)


@pytest.mark.parametrize(
    ("space", "image"),
    [
        (IMAGE, (2, 3, 4)),
        (spaces.Dict({"observation": IMAGE, "action_mask": spaces.MultiBinary(5)}), (2, 3, 4)),
        (spaces.Box(0, 255, (2, 3), np.uint8), ()),
        (spaces.Box(0, 1, (2, 3, 4), np.float32), ()),
        (spaces.Dict({"picture": IMAGE, "speed": spaces.Box(-1, 1, (2,), np.float32)}), ()),
    ],
)
def test_bytes_of_three_dimensions_are_an_image(space, image):
    """With a mask or without; anything else is numbers, as before."""
    assert view_of(space).image == image


def test_a_mask_comes_behind_the_image():
    """Everything is bytes, also for an agent that has left."""
    view = view_of(spaces.Dict({"observation": IMAGE, "action_mask": spaces.MultiBinary(5)}))
    seen = {"observation": np.arange(24, dtype=np.uint8).reshape(2, 3, 4), "action_mask": np.array([0, 1, 0, 0, 1])}
    numbers = view.numbers("a", seen, {})
    assert numbers.dtype == view.absent().dtype == np.uint8
    assert numbers.tolist() == [*range(24), 0, 1, 0, 0, 1]
    assert view.absent().tolist() == [0] * 24 + [1] * 5


@pytest.mark.parametrize("wrong", [np.full((2, 3, 4), 0.5), np.full((2, 3, 4), 300), [[[1]]]])
def test_other_numbers_than_bytes_are_refused(wrong):
    """Flattening would make bytes of them, 0 of 0.5 and 44 of 300."""
    with pytest.raises(ContractError, match="and not uint8; PettingZoo asks for one in its observation_space"):
        view_of(IMAGE).numbers("a", wrong, {})


@pytest.mark.parametrize("wrong", [np.zeros((2, 3, 4), np.uint8), {}, None])
def test_an_image_without_its_dict_is_refused(wrong):
    """Whatever comes in place of the image and its mask."""
    view = view_of(spaces.Dict({"observation": IMAGE, "action_mask": spaces.MultiBinary(5)}))
    with pytest.raises(ContractError, match="PettingZoo asks for one in its observation_space"):
        view.numbers("a", wrong, {})


def test_a_batch_of_images_holds_bytes():
    """The team says how large they are; its description survives a file, and teams without images have the old one."""
    batch = PettingZooBatch(EnvConfig("pictures.env:Lights"), 3, boxes=False)
    group = batch.team.groups[0]
    assert (group.image, group.seen, batch.team.in_bytes) == ((6, 6, 3), (3, 6, 6), True)
    batch.reset(1, 0, 0)
    assert batch.observation.dtype == np.uint8
    assert batch.observation[1].max() == 255
    assert TeamSpec.from_dict(batch.team.to_dict()) == batch.team
    assert "image" not in GroupSpec("a", 1, 2, 3).to_dict()


def test_vectors_beside_images_make_rows_of_numbers():
    """Only where all agents see images are rows bytes."""
    seer, walker = GroupSpec("seer", 1, 12, 1, choices=(2,), image=(2, 2, 3)), GroupSpec("walker", 1, 4, 2)
    assert TeamSpec((seer,)).in_bytes
    assert not TeamSpec((seer, walker)).in_bytes


@pytest.mark.usefixtures("nothing_stays_loaded")
def test_a_policy_acts_on_what_the_environment_returns():
    """By the agents' names, with images as they come."""
    run = eia_sec.train(
        "lights",
        plugins=["pictures"],
        steps=40,
        settings={
            "algorithm.network.name": "cnn",
            "algorithm.iteration_steps": 40,
            "rollout.environments": 1,
            "rollout.chunk_steps": 40,
        },
    )
    seen, _ = Lights().reset(seed=3)
    found = run.policy.act(seen)
    assert Policy(run.actors).act(seen) == found
    assert set(found) == {"walker_0", "walker_1"}
    assert all(0 <= action < 5 for action in found.values())
