"""What the browser gets of a farm: nothing of what the farm does not have, and everything of what it has."""

import json
import struct
from dataclasses import replace

import numpy as np

from eia_sec.common.config import StressConfig
from eia_sec.common.protocol.messages import WatchTerms
from eia_sec.common.protocol.view_checks import NO_RELAY
from eia_sec.deploy.monitor.web import packets
from eia_sec.rollout.rendering.palette import GONE, LINK_DOWN, STRESS
from eia_sec.rollout.sim.batch import REWARD_PARTS
from eia_sec.rollout.sim.conditions.stress import patches
from eia_sec.rollout.sim.layout import make_layout
from eia_sec.rollout.sim.stations import station_places
from tests.common.protocol.test_view_checks import a_view, a_view_of_conditions
from tests.deploy.monitor.web.stage import AREA, CHAINED, CONDITIONS, CONFIG

TERMS = WatchTerms("", REWARD_PARTS, 4.0, 25.0)
DTYPES = {"f4": np.float32, "u1": np.uint8}


def unpacked(packet):
    """Return a packet's header and its arrays."""
    (length,) = struct.unpack_from("<I", packet.data)
    header = json.loads(packet.data[4 : 4 + length])
    arrays = {}
    for name, dtype, shape, place in header["arrays"]:
        flat = np.frombuffer(packet.data, DTYPES[dtype], int(np.prod(shape)), 4 + length + place)
        arrays[name] = flat.reshape(shape)
    return header, arrays


def frames(message, farm):
    return unpacked(packets.frames(message, farm, make_layout(farm, message.farm), 3))


def test_a_farm_without_conditions_sends_nothing_of_them():
    """Scene and frames have the fields and arrays that they had before there were any of these."""
    scene, _ = unpacked(packets.scene("run", "w", CONFIG.farm, TERMS))
    assert not {"link_down", "base", "gone", "stations", "stress", "areas"} & set(scene)
    header, arrays = frames(a_view(), CONFIG.farm)
    assert "patches" not in header
    sent = ["position", "assignment", "quality", "aoi", "vdf", "level", "parts", "sensor", "kind"]
    assert [*arrays] == sent


def test_a_scene_says_what_the_farm_has():
    """Stations, radii and colours are those of the configuration and of the other pictures."""
    scene, _ = unpacked(packets.scene("run", "w", CONDITIONS.farm, TERMS))
    assert scene["stations"] == station_places(CONDITIONS.farm).tolist()
    assert scene["stress"] == {"colour": STRESS, "radius": 60.0}
    assert scene["areas"] == {"colour": STRESS, "outlines": [[list(corner) for corner in AREA]]}
    assert scene["link_down"] == {"colour": LINK_DOWN, "range": 40.0}
    assert scene["gone"] == GONE


def test_areas_alone_bring_no_patches():
    """A farm with areas and without patches sends outlines, and nothing of patches."""
    farm = replace(CONFIG.farm, stress=StressConfig(areas=((2, AREA),)))
    scene, _ = unpacked(packets.scene("run", "w", farm, TERMS))
    assert "areas" in scene
    assert "stress" not in scene
    assert "patches" not in frames(a_view(), farm)[0]


def test_frames_have_the_patches_of_their_episode():
    """Place and time come from the seeds, what the team knows from the message."""
    message = a_view_of_conditions()
    header, arrays = frames(message, CONDITIONS.farm)
    place, time = patches(CONDITIONS.farm, message.farm, message.episode)
    np.testing.assert_allclose(np.array(header["patches"]), np.concatenate([place, time], axis=1))
    for name in ("gone", "charge", "known"):
        np.testing.assert_array_equal(arrays[name], getattr(message, name))


def test_links_are_up_within_their_range():
    """The range is a distance in space; a UAV without a relay has no link."""
    message = a_view_of_conditions(2)
    position, assignment = message.position.copy(), message.assignment.copy()
    position[:, 0] = 0.0, 0.0
    position[0, 1:] = [[39.9, 0.0], [40.1, 0.0], [39.9, 0.0], [1.0, 0.0]]  # data collection flies lower
    position[1, 1:] = 1.0, 0.0
    assignment[1, 2] = NO_RELAY
    _, arrays = frames(replace(message, position=position, assignment=assignment), CONDITIONS.farm)
    assert arrays["linked"].tolist() == [[1, 0, 0, 1], [1, 1, 0, 1]]


def test_links_count_while_their_relay_is_joined():
    """The base station is at (50, 0), and the hops' range 70 m; the third relay is too far from the others."""
    header, _ = unpacked(packets.scene("run", "w", CHAINED.farm, TERMS))
    assert header["base"] == {"place": [50.0, 0.0], "height": 22.0, "range": 70.0}
    assert "base" not in unpacked(packets.scene("run", "w", CONDITIONS.farm, TERMS))[0]
    relays = np.array([[50.0, 60.0], [0.0, 80.0], [100.0, 80.0]], np.float32)
    message = a_view()
    position = np.concatenate([np.broadcast_to(relays, (len(message.position), 3, 2)), message.position[:, 1:]], axis=1)
    assignment = np.broadcast_to(np.array([0, 1, 2, 2], np.uint8), message.assignment.shape)
    position[:, 3:] = relays[[0, 1, 2, 2]]
    _, arrays = frames(replace(message, position=position, assignment=assignment), CHAINED.farm)
    assert (arrays["joined"] == [1, 1, 1]).all()
    assert (arrays["linked"] == 1).all()
    position[:, 2] = 100.0, 79.9
    position[:, 0] = 30.0, 40.0
    _, arrays = frames(replace(message, position=position, assignment=assignment), CHAINED.farm)
    assert (arrays["joined"] == [1, 1, 0]).all()
    assert (arrays["linked"][:, 2:] == 0).all()


def test_views_of_earlier_workers_are_shown():
    """A worker that sends neither failures nor charge is shown without them."""
    header, arrays = frames(a_view(), CONDITIONS.farm)
    assert len(header["patches"]) == CONDITIONS.farm.stress.patches
    assert not {"gone", "charge", "known"} & set(arrays)
