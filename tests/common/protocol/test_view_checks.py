"""A view is drawn only when it shows the farm that was announced."""

import dataclasses
import io

import numpy as np
import pytest
from PIL import Image

from eia_sec.common.errors import SchemaError
from eia_sec.common.protocol.messages import StepsMessage, ViewMessage
from eia_sec.common.protocol.view_checks import (
    FRAMES,
    MOST_PICTURE,
    MOST_PICTURES,
    MOST_SENTENCE,
    MOST_SIDE,
    check_steps,
    check_view,
)
from eia_sec.common.team import GroupSpec, TeamSpec
from eia_sec.rollout.sim.batch import REWARD_PARTS
from tests.deploy.monitor.web.stage import CONDITIONS, CONFIG

WORLD = CONFIG.farm.world


def a_view(frames=3):
    """Return a whole view of the small farm."""
    served = WORLD.monitoring_uavs + WORLD.collection_uavs
    return ViewMessage(
        farm=1,
        episode=2,
        first=0,
        skipped=0,
        noise_std=0.1,
        uniform=False,
        position=np.full((frames, WORLD.uavs, 2), 50.0, np.float32),
        assignment=np.zeros((frames, served), np.uint8),
        quality=np.zeros((frames, served), np.float32),
        aoi=np.zeros((frames, WORLD.sensors), np.uint8),
        vdf=np.zeros((frames, WORLD.plots_x, WORLD.plots_y), np.uint8),
        level=np.zeros((frames, 2), np.float32),
        parts=np.zeros((frames, 3, len(REWARD_PARTS)), np.float32),
    )


def a_view_of_conditions(frames=3):
    """Return a whole view of the farm with batteries, a UAV that fails, and patches of stress."""
    return dataclasses.replace(
        a_view(frames),
        gone=np.zeros((frames, WORLD.uavs), np.uint8),
        charge=np.full((frames, WORLD.uavs), 255, np.uint8),
        known=np.ones((frames, CONDITIONS.farm.stress.patches), np.uint8),
    )


def test_a_whole_view_passes():
    """A view that fits raises nothing, at the last step too."""
    assert check_view(a_view(), CONFIG.farm, len(REWARD_PARTS)) is None
    assert check_view(dataclasses.replace(a_view(), first=WORLD.steps - 2), CONFIG.farm, len(REWARD_PARTS)) is None


def spoilt(name, value):
    array = getattr(a_view(), name).copy()
    array.flat[-1] = value
    return {name: array}


@pytest.mark.parametrize(
    "change",
    [
        {"first": WORLD.steps - 1},
        {"position": np.zeros((3, 4, 2), np.float32)},
        {"position": np.zeros((0, 5, 2), np.float32)},
        {"position": np.float32(1.0).reshape(())},
        {"aoi": np.zeros((3, 31), np.uint8)},
        {"aoi": np.zeros((2, 30), np.uint8)},
        {"vdf": np.zeros((3, 4, 5), np.uint8)},
        {"parts": np.zeros((3, 3, len(REWARD_PARTS) + 1), np.float32)},
        spoilt("position", np.nan),
        spoilt("position", WORLD.field_y + 1.0),
        spoilt("position", -1.0),
        spoilt("assignment", WORLD.communication_uavs),
        spoilt("quality", np.inf),
        spoilt("level", -1.0),
        spoilt("level", WORLD.vdf_max + 1.0),
        spoilt("parts", np.nan),
    ],
)
def test_what_does_not_fit_is_refused(change):
    """Other shapes, numbers out of range, and numbers that are not finite are SchemaErrors."""
    with pytest.raises(SchemaError):
        check_view(dataclasses.replace(a_view(), **change), CONFIG.farm, len(REWARD_PARTS))


@pytest.mark.parametrize("name", ["gone", "charge", "known"])
def test_an_optional_array_is_sent_where_the_farm_has_a_use_for_it(name):
    """A farm that has a use for it needs it in its shape; other farms refuse it."""
    parts, whole = len(REWARD_PARTS), a_view_of_conditions()
    array = getattr(whole, name)
    assert check_view(whole, CONDITIONS.farm, parts) is None
    with pytest.raises(SchemaError, match=f"array {name} is missing"):
        check_view(dataclasses.replace(whole, **{name: None}), CONDITIONS.farm, parts)
    for odd in (array[:, 1:].copy(), array[:2].copy(), array[0]):
        with pytest.raises(SchemaError, match=f"array {name} is"):
            check_view(dataclasses.replace(whole, **{name: odd}), CONDITIONS.farm, parts)
    with pytest.raises(SchemaError, match=f"array {name} is of no use"):
        check_view(dataclasses.replace(a_view(), **{name: array}), CONFIG.farm, parts)


@pytest.mark.parametrize("name", ["gone", "known"])
def test_a_flag_is_0_or_1(name):
    """Other numbers are refused."""
    whole = a_view_of_conditions()
    getattr(whole, name).flat[-1] = 2
    with pytest.raises(SchemaError, match="flag"):
        check_view(whole, CONDITIONS.farm, len(REWARD_PARTS))


def test_too_many_frames_are_refused():
    """A view has at most FRAMES frames."""
    with pytest.raises(SchemaError, match="frames"):
        check_view(a_view(FRAMES + 1), CONFIG.farm, len(REWARD_PARTS))


TEAM = TeamSpec((GroupSpec("runner", 2, 3, 2), GroupSpec("keeper", 1, 4, 1, choices=(5,))))


def a_picture(wide=4, high=3):
    """Return a PNG file of one colour."""
    file = io.BytesIO()
    Image.new("RGB", (wide, high), (10, 20, 30)).save(file, "PNG")
    return np.frombuffer(file.getvalue(), np.uint8)


def some_steps(frames=3):
    """Return a whole message of an environment that is no farm, with a picture of the second frame."""
    picture = a_picture()
    return StepsMessage(
        scenario=1,
        episode=2,
        first=0,
        skipped=0,
        noise_std=0.1,
        uniform=False,
        reward=np.zeros((frames, TEAM.agents), np.float32),
        action=np.zeros((frames, TEAM.action_size), np.float32),
        seen=np.zeros((frames, TEAM.agents, 3), np.float32),
        alive=np.ones((frames, TEAM.agents), np.uint8),
        pictures=picture,
        ends=np.minimum(np.arange(frames), 1) * len(picture),
        silence="",
    )


def test_whole_steps_pass():
    """A message that fits raises nothing, without pictures too."""
    assert check_steps(some_steps(), TEAM) is None
    assert check_steps(some_steps(FRAMES), TEAM) is None
    empty = {"pictures": np.zeros(0, np.uint8), "ends": np.zeros(3, np.int64)}
    assert check_steps(dataclasses.replace(some_steps(), **empty), TEAM) is None


def _with_picture(picture):
    return {"pictures": picture, "ends": np.array([0, len(picture), len(picture)])}


@pytest.mark.parametrize(
    "change",
    [
        {"reward": np.zeros((3, 4), np.float32)},
        {"reward": np.full((3, 3), np.nan, np.float32)},
        {"action": np.zeros((3, 4), np.float32)},
        {"action": np.full((3, 5), np.inf, np.float32)},
        {"seen": np.zeros((3, 3), np.float32)},
        {"alive": np.full((3, 3), 2, np.uint8)},
        {"ends": np.zeros((3, 1), np.int64)},
        {"ends": np.zeros(0, np.int64)},
        {"ends": np.zeros(FRAMES + 1, np.int64)},
        {"ends": np.array([0, 1, 2])},
        {"ends": np.array([5, 1, len(a_picture())])},
        {"ends": np.array([-5, 1, len(a_picture())])},
        {"pictures": np.zeros((1, len(a_picture())), np.uint8)},
        {"first": 100_000 - 1},
        {"silence": "x" * (MOST_SENTENCE + 1)},
        _with_picture(np.zeros(100, np.uint8)),
        _with_picture(a_picture()[:20]),
        _with_picture(a_picture(wide=MOST_SIDE + 1)),
        _with_picture(a_picture(high=MOST_SIDE + 1)),
        _with_picture(np.pad(a_picture(), (0, MOST_PICTURE))),
        {"pictures": np.tile(np.pad(a_picture(), (0, MOST_PICTURE // 2)), 9), "ends": np.array([0, 0, 1])},
    ],
)
def test_other_steps_are_refused(change):
    """Shapes, numbers and pictures that do not fit the team, or are too large, are refused."""
    with pytest.raises(SchemaError):
        check_steps(dataclasses.replace(some_steps(), **change), TEAM)


def test_the_pictures_of_a_message_are_bounded_together():
    """Pictures that are each allowed may be too many bytes in one message."""
    picture = np.pad(a_picture(), (0, MOST_PICTURE - len(a_picture())))
    count = MOST_PICTURES // MOST_PICTURE
    for more, fits in ((0, True), (1, False)):
        ends = np.cumsum(np.full(count + more, len(picture)))
        message = dataclasses.replace(
            some_steps(count + more), pictures=np.tile(picture, count + more), ends=ends.astype(np.int64)
        )
        if fits:
            assert check_steps(message, TEAM) is None
        else:
            with pytest.raises(SchemaError, match="too many bytes"):
                check_steps(message, TEAM)
