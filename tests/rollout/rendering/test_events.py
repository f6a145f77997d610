"""Pictures of what not every farm has: links out of range, UAVs that are gone, patches of stress."""

from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.collections import LineCollection, PathCollection
from matplotlib.colors import to_rgb

from eia_sec.common.config import BatteryConfig, FarmConfig, RelayConfig, StressConfig
from eia_sec.rollout.rendering.farm_map import FarmMap, _bars, _events
from eia_sec.rollout.rendering.palette import LINK_DOWN, STRESS
from eia_sec.rollout.rendering.render import Renderer
from eia_sec.rollout.rendering.scene import Observer, chain_of, hop_lines, links_up
from eia_sec.rollout.rendering.terminal import ALARM, terminal_text
from eia_sec.rollout.sim.batch import FarmBatch
from tests.constants import with_constants


def flown(config, steps):
    """Return farms after so many steps in which all UAVs stay."""
    farms = FarmBatch(config, 1)
    farms.reset(0, 5, 2)
    for _ in range(steps):
        farms.step(np.zeros((1, 24), np.float32))
    return farms


def colours(config, steps):
    """Return the colours in a picture, [N, 3]."""
    farms = flown(config, steps)
    renderer = Renderer(farms, 0)
    renderer.observe()
    return renderer.render("rgb_array").reshape(-1, 3) / 255.0


def has(pixels, colour):
    """Return whether any pixel is close to a colour."""
    return bool((np.abs(pixels - to_rgb(colour)).max(axis=1) < 0.12).any())


@pytest.mark.parametrize("some", [False, True])
def test_patches_and_broken_links_are_drawn_where_there_are_any(some):
    """Their colours are in the picture only of farms that have them."""
    config = FarmConfig()
    if some:
        stress = with_constants(StressConfig(patches=6), seconds=500.0)
        config = replace(config, stress=stress, relay=replace(config.relay, require_link=True, link_range=20.0))
    pixels = colours(config, 400)
    assert has(pixels, STRESS) == some
    assert has(pixels, LINK_DOWN) == some


def test_a_scene_has_the_patches_that_there_are_now():
    """Those before their first step and after their last one are not shown."""
    farms = flown(FarmConfig(stress=with_constants(StressConfig(patches=8), radius=30.0, seconds=60.0)), 200)
    scene = Observer(farms, 0).scene()
    first, end = farms.patch_time[0].T
    lives = (first <= 200) & (end > 200)
    assert np.array_equal(scene.stress, farms.patch_place[0, lives])
    assert np.array_equal(scene.known, farms.patch_known[0, lives])


def test_areas_are_drawn_in_pictures_and_in_the_terminal():
    """Their outlines are there without any patch, and those of areas of growth 1 are not."""
    outline = ((100.0, 100.0), (220.0, 100.0), (220.0, 220.0), (100.0, 220.0))
    for growth, some in ((1, False), (2, True)):
        config = FarmConfig(stress=StressConfig(areas=((growth, outline),)))
        assert has(colours(config, 1), STRESS) == some
        text = terminal_text(Observer(flown(config, 1), 0).scene(), 60)
        assert ("area of faster growth" in text.plain) == some
        assert any(STRESS.lower() in str(span.style).lower() for span in text.spans[:-1]) == some


def test_a_link_is_up_within_its_range():
    """The range is a distance in space; a UAV without a relay has no link."""
    config = FarmConfig()
    config = replace(config, relay=replace(config.relay, require_link=True, link_range=100.0))
    position = np.zeros((12, 2))
    position[4:8, 0] = 99.0, 101.0, 0.0, 50.0
    assignment = np.zeros(8, np.int64)
    assignment[2] = -1
    joined = np.ones(4, bool)
    assert links_up(config, position, assignment, joined).tolist() == [True, False, False, *[True] * 5]
    joined[0] = False
    assert not links_up(config, position, assignment, joined).any()


@pytest.mark.parametrize("base", ["", "east"])
def test_a_base_station_and_hops_are_drawn_where_there_is_one(base):
    """The picture has more of the relays' colour, and the terminal a B and a line of its legend."""
    relay = RelayConfig(require_link=True, link_range=150.0, base=base, **({"hop_range": 300.0} if base else {}))
    config = replace(FarmConfig(), relay=relay)
    farms = flown(config, 1)
    farms.position[0, :4] = [[300.0, 200.0], [250.0, 300.0], [250.0, 100.0], [50.0, 200.0]]
    observer = Observer(farms, 0)
    observer.observe()
    scene = observer.scene()
    text = terminal_text(scene, 60)
    assert scene.joined.all()
    assert ("hop to the base station" in text.plain) == bool(base)
    assert text.plain.split("\n", 1)[1].count("B") == (2 if base else 0)
    figure, axes = plt.subplots()
    drawn = FarmMap(axes, scene)
    drawn.update(scene)
    hops = [artist for artist in drawn.artists if isinstance(artist, LineCollection) and artist.get_zorder() == 2.9]
    assert [len(artist.get_segments()) for artist in hops] == ([9] if base else [])
    labels = [handle.get_label() for handle in _events(scene)]
    assert ("base station" in labels) == bool(base)
    plt.close(figure)


def test_hops_join_only_relays_that_are_joined():
    """The first relay is near the base station, the second one near it, the third one near nobody."""
    config = FarmConfig(relay=RelayConfig(require_link=True, base="south", hop_range=105.0))
    position = np.zeros((12, 2))
    position[:4] = [[200.0, 100.0], [200.0, 200.0], [200.0, 310.0], [0.0, 310.0]]
    joined = chain_of(config, position, np.zeros(12, bool))
    assert joined.tolist() == [True, True, False, False]
    ends = [line.tolist() for line in hop_lines(config, position, joined)]
    assert ends == [[[200.0, 100.0], [200.0, 200.0]], [[200.0, 100.0], [200.0, 0.0]]]


def test_batteries_and_stations_are_drawn():
    """A bar has the length of the charge, and the map has a symbol for each station."""
    farms = flown(FarmConfig(battery=BatteryConfig(capacity=8000.0, stations=3)), 100)
    renderer = Renderer(farms, 0)
    renderer.observe()
    scene = Observer(farms, 0).scene()
    renderer.render("rgb_array")
    share = farms.charge[0] / 8000.0
    assert np.allclose(scene.charge, share)
    for bar, part in zip(_bars(scene, scene.charge), share, strict=True):
        assert bar[1, 0] - bar[0, 0] == pytest.approx(0.036 * 400.0 * part)
    figure, axes = plt.subplots()
    drawn = FarmMap(axes, scene)
    assert any(len(artist.get_offsets()) == 3 for artist in drawn.artists if isinstance(artist, PathCollection))
    plt.close(figure)


def test_the_terminal_shows_stations_and_low_charges():
    """A station is an H, and a UAV with little charge has the alarm's colour."""
    config = FarmConfig(battery=BatteryConfig(capacity=8000.0, stations=3))
    farms = FarmBatch(config, 1)
    farms.reset(0, 5, 2)
    farms.position[0] = 20.0, 20.0
    observer = Observer(farms, 0)
    observer.observe()
    text = terminal_text(observer.scene(), 60)
    assert text.plain.count("H") == 3
    farms.charge[0, 11] = 0.1 * 8000.0
    styles = [str(span.style) for span in terminal_text(observer.scene(), 60).spans]
    assert any(ALARM.lower() in style.lower() for style in styles)
    assert not any(ALARM.lower() in str(span.style).lower() for span in text.spans)
