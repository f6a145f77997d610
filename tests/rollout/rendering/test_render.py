"""Pictures and texts of the farm show its state at the right places."""

import io
import re
import sys
import types
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.backend_bases import FigureCanvasBase
from matplotlib.figure import Figure
from pettingzoo.test import render_test
from rich.console import Console
from rich.text import Text

from eia_sec.common.config import CameraConfig, FarmConfig, RadioConfig, WindConfig, WorldConfig, ZoneConfig
from eia_sec.common.errors import SimulationError
from eia_sec.common.farm import LETTERS
from eia_sec.rollout.envs.parallel_env import env, parallel_env
from eia_sec.rollout.rendering import render
from eia_sec.rollout.rendering.airspace import WindArrow
from eia_sec.rollout.rendering.palette import AGE_STOPS, COLOURS, SOIL_STOPS, TYPES, rgb, shade
from eia_sec.rollout.rendering.picture import SIZE, FarmPicture
from eia_sec.rollout.rendering.render import Renderer, Terminal, Window
from eia_sec.rollout.rendering.scene import TRAIL_STEPS, Observer, camera_radius, radio_radius
from eia_sec.rollout.rendering.terminal import EXTRA_LINES, fitting_width, terminal_text
from eia_sec.rollout.sim.batch import FarmBatch
from tests.constants import with_constants

SPARSE = FarmConfig(
    world=WorldConfig(
        communication_uavs=1,
        monitoring_uavs=1,
        collection_uavs=1,
        sensors=10,
        sensor_spacing=60.0,
        plots_x=4,
        plots_y=4,
        steps=60,
    )
)
PLACES = np.array([[50.0, 350.0], [250.0, 150.0], [350.0, 310.0]])


def observed(config=SPARSE, steps=0):
    """Return a batch of one after some still steps with its UAVs at PLACES, and its observer."""
    batch = FarmBatch(config, 1)
    observer = Observer(batch, 0)
    batch.reset(0, 3, 4)
    batch.position[0] = PLACES
    observer.observe()
    for _ in range(steps):
        batch.step(np.zeros((1, 6), np.float32))
        observer.observe()
    return batch, observer


def picture_of(observer):
    scene = observer.scene()
    drawer = FarmPicture(scene)
    return drawer, drawer.draw(scene)


def near(pixels, at, colour, reach):
    """Count the pixels of a colour within a square of `reach` pixels around a place."""
    row, column = at
    window = pixels[row - reach : row + reach + 1, column - reach : column + reach + 1].astype(int)
    return int((np.abs(window - np.array(colour)).max(axis=-1) <= 3).sum())


def darkest(pixels, at):
    """Return the least brightness right around a place."""
    row, column = at
    return int(pixels[row - 1 : row + 2, column - 1 : column + 2].max(axis=-1).min())


def test_pettingzoos_render_test(capsys):
    """Every mode that the metadata names returns what PettingZoo wants, over several steps."""
    render_test(lambda render_mode: env(SPARSE, render_mode=render_mode))
    assert capsys.readouterr().out.count("mean AoI") >= 5


def test_a_picture_is_an_array_of_its_own():
    """uint8 [H, W, 3] with even sides; the next picture does not change it, and differs after a step."""
    farm = parallel_env(render_mode="rgb_array")
    farm.reset(seed=0)
    first = farm.render()
    kept = first.copy()
    assert first.shape == (int(SIZE[1] * 100), int(SIZE[0] * 100), 3)
    assert first.dtype == np.uint8
    assert not first.shape[0] % 2
    assert not first.shape[1] % 2
    np.testing.assert_array_equal(farm.render(), first)
    farm.step({agent: np.ones(2, np.float32) for agent in farm.agents})
    second = farm.render()
    np.testing.assert_array_equal(first, kept)
    assert (first != second).any(axis=-1).sum() > 500
    farm.close()
    farm.reset(seed=0)
    assert (farm.render() == first).all(axis=-1).mean() > 0.999


def test_uavs_stand_where_they_are():
    """The colour of its type surrounds the place of each UAV, and goes away with it."""
    batch, observer = observed()
    drawer, pixels = picture_of(observer)
    for name, (x, y) in zip(TYPES, PLACES, strict=True):
        at = drawer.pixel(x, y)
        assert near(pixels, at, rgb(COLOURS[name]), 8) > 40
        assert near(pixels, drawer.pixel(y, x), rgb(COLOURS[name]), 8) == 0
    batch.position[0] = PLACES[:, ::-1]
    moved = drawer.draw(observer.scene())
    for name, (x, y) in zip(TYPES[:2], PLACES[:2], strict=True):
        assert near(moved, drawer.pixel(y, x), rgb(COLOURS[name]), 8) > 40
        assert near(moved, drawer.pixel(x, y), rgb(COLOURS[name]), 8) == 0


def test_plots_have_the_colour_of_their_vdf():
    """Each plot's pixels show its own level: not mirrored, not turned, and anew after every change."""
    batch, observer = observed(replace(SPARSE, camera=with_constants(CameraConfig(), image_distance=1.0)))
    drawer = FarmPicture(observer.scene())
    for seed in range(2):
        batch.vdf[0] = np.random.default_rng(seed).integers(0, 6, (4, 4))
        pixels = drawer.draw(observer.scene())
        expected = shade(SOIL_STOPS, batch.vdf[0] / 5.0)
        for column in range(4):
            for row in range(4):
                at = drawer.pixel(100.0 * column + 3.0, 100.0 * row + 3.0)
                assert tuple(pixels[at]) == tuple(expected[column, row])


def test_sensors_have_the_colour_of_their_age():
    """A sensor far from all UAVs shows its AoI at its place."""
    batch, observer = observed()
    batch.aoi[0] = np.arange(10) % 6
    drawer, pixels = picture_of(observer)
    sensors = batch.layout(0).sensor_xy
    away = np.linalg.norm(sensors[:, None] - PLACES, axis=2).min(axis=1) > 60.0
    assert away.sum() >= 3
    for (x, y), age in zip(sensors[away], batch.aoi[0][away], strict=True):
        row, column = drawer.pixel(x, y)
        assert np.abs(pixels[row, column].astype(int) - shade(AGE_STOPS, np.array(age / 5.0))).max() < 25


def test_links_run_from_relay_to_served():
    """Dark dots lead from the relay to both UAVs that it serves, and there are no others."""
    _, observer = observed()
    drawer, pixels = picture_of(observer)
    for served in (1, 2):
        dark = [
            darkest(pixels, drawer.pixel(*(PLACES[0] + share * (PLACES[served] - PLACES[0])))) < 110
            for share in np.linspace(0.15, 0.85, 120)
        ]
        assert np.mean(dark) > 0.6
    beside = [darkest(pixels, drawer.pixel(60.0 + 2.0 * k, 200.0 - k)) < 110 for k in range(60)]
    assert np.mean(beside) < 0.1


def test_circles_have_their_radius():
    """The outline of each circle is found at its radius from its UAV, in the UAV's colour."""
    config = replace(SPARSE, camera=with_constants(CameraConfig(), image_distance=50.0))
    _, observer = observed(config)
    drawer, pixels = picture_of(observer)
    for name, (x, y), radius in (
        (TYPES[1], PLACES[1], camera_radius(config)),
        (TYPES[2], PLACES[2], radio_radius(config)),
    ):
        for angle in (0.4, 2.5, 4.2):
            along = [
                pixels[drawer.pixel(x + r * np.cos(angle), y + r * np.sin(angle))].astype(int)
                for r in np.arange(radius - 6.0, radius + 6.0, 0.25)
            ]
            closest = np.abs(np.array(along) - rgb(COLOURS[name])).sum(axis=1).argmin()
            assert abs(0.25 * closest - 6.0) < 1.5


def test_radii_by_hand():
    """sqrt(25^2 - 20^2) = 15 m for cameras; the radio reaches some 30 m, farther with more power, or nowhere."""
    assert camera_radius(FarmConfig()) == pytest.approx(15.0)
    assert camera_radius(FarmConfig(camera=with_constants(CameraConfig(), image_distance=10.0))) == 0.0
    assert 28.0 < radio_radius(FarmConfig()) < 35.0
    assert radio_radius(FarmConfig(radio=with_constants(RadioConfig(), sensor_power_dbm=12.0))) > 35.0
    assert radio_radius(FarmConfig(radio=with_constants(RadioConfig(), sensor_power_dbm=-100.0))) == 0.0
    assert radio_radius(FarmConfig(radio=with_constants(RadioConfig(), sensor_power_dbm=200.0))) == pytest.approx(
        np.hypot(400, 400)
    )


def test_a_scene_remembers_the_way():
    """The trail holds the last positions and the chart every step; a reset forgets both."""
    batch, observer = observed(steps=50)
    batch.position[0, 0] += 5.0
    scene = observer.scene()
    assert scene.trail.shape == (TRAIL_STEPS + 1, 3, 2)
    assert scene.course.shape == (51, 2)
    assert scene.course[-1].tolist() == [batch.aoi.mean(), batch.vdf.mean()]
    assert not np.isnan(scene.course).any()
    assert scene.reward["mean"] == pytest.approx(np.mean(batch.summary(0).reward))
    assert scene.headline == "farm 3, step 50 of 60"
    batch.reset(0, 5, 0)
    observer.observe()
    assert observer.scene().trail.shape == (1, 3, 2)
    assert observer.scene().course.shape == (1, 2)
    assert observer.scene().headline.startswith("farm 5, step 0")


def test_the_readings_are_those_of_the_batch():
    """Headline, rewards, mean AoI and mean VDF of the picture are the simulator's numbers."""
    batch, observer = observed(steps=45)
    drawer, _ = picture_of(observer)
    readings = {name: text.get_text() for name, text in drawer._readings.items()}
    reward = batch.summary(0).reward
    assert readings["monitoring"] == f"{reward[1]:.1f}".replace("-", "\N{MINUS SIGN}")
    assert readings["mean"] == f"{np.mean(reward):.1f}".replace("-", "\N{MINUS SIGN}")
    assert readings["aoi"] == f"mean AoI {batch.aoi.mean():.2f}"
    assert readings["vdf"] == f"mean VDF {batch.vdf.mean():.2f}"
    assert drawer._headline.get_text() == "farm 3, step 45 of 60"


def test_the_text_shows_uavs_plots_and_sensors():
    """Each UAV's letter and number stand in its cell; plots and waiting sensors have their colours."""
    batch, observer = observed(replace(SPARSE, camera=with_constants(CameraConfig(), image_distance=1.0)))
    batch.vdf[0] = np.arange(16).reshape(4, 4) % 6
    batch.aoi[0] = 5.0
    text = terminal_text(observer.scene(), 40)
    lines = text.split("\n")
    assert len(lines) == 20 + EXTRA_LINES - 1
    field = [line.plain for line in lines[1:21]]
    assert all(len(line) == 40 for line in field)
    for name, (x, y) in zip(TYPES, PLACES, strict=True):
        row, column = 19 - int(y / 400 * 20), int(x / 400 * 40)
        assert field[row][column : column + 2] == f"{LETTERS[name]}0"
        assert style_at(lines[1 + row], column).bgcolor.name == COLOURS[name].lower()
    corner = style_at(lines[20], 0)
    assert corner.bgcolor.triplet == tuple(shade(SOIL_STOPS, np.array(batch.vdf[0, 0, 0] / 5.0)))
    corner = style_at(lines[1], 39)
    assert corner.color.triplet == tuple(shade(SOIL_STOPS, np.array(batch.vdf[0, 3, 3] / 5.0)))
    assert count_colour(lines[1:21], rgb(AGE_STOPS[-1])) >= 8
    batch.aoi[0] = 0.0
    assert count_colour(terminal_text(observer.scene(), 40).split("\n")[1:21], rgb(AGE_STOPS[-1])) == 0


def style_at(line, column):
    (span,) = [span for span in line.spans if span.start <= column < span.end]
    return span.style


def count_colour(lines, colour):
    styles = [span.style for line in lines for span in line.spans]
    return sum(colour in (s.color and s.color.triplet, s.bgcolor and s.bgcolor.triplet) for s in styles)


def test_ansi_is_text_with_colours():
    """The text carries 24-bit colours, and nothing but them and the plain text."""
    farm = parallel_env(SPARSE, render_mode="ansi")
    farm.reset(seed=0, options={"farm": 7})
    text = farm.render()
    assert "\x1b[" in text
    plain = Text.from_ansi(text).plain
    assert plain.startswith("farm 7, step 0 of 60")
    assert re.sub(r"\x1b\[[0-9;]*m", "", text).strip() == plain.strip()


def test_people_without_a_window_get_text(capsys):
    """In human mode every reset and step is shown, without control characters where there is no terminal."""
    farm = parallel_env(SPARSE, render_mode="human")
    farm.reset(seed=0)
    farm.step({agent: np.zeros(2, np.float32) for agent in farm.agents})
    assert farm.render() is None
    farm.close()
    shown = capsys.readouterr().out
    assert [int(n) for n in re.findall(r"step (\d+) of 60", shown)] == [0, 1, 1]
    assert "\x1b" not in shown


def test_on_a_terminal_a_scene_takes_the_place_of_the_last():
    """The first scene clears the terminal, the next ones begin at its corner, and they fit it."""
    _, observer = observed()
    file = io.StringIO()
    terminal = Terminal(
        Console(file=file, force_terminal=True, width=60, height=25, color_system="truecolor", legacy_windows=False)
    )
    terminal.show(observer.scene())
    first = file.getvalue()
    terminal.show(observer.scene())
    second = file.getvalue()[len(first) :]
    assert first.startswith("\x1b[2J\x1b[H")
    assert second.startswith("\x1b[H")
    assert "\x1b[2J" not in second
    lines = Text.from_ansi(first).plain.splitlines()
    assert len(lines) <= 25
    assert fitting_width(60, 25, SPARSE.world) == 2 * (25 - EXTRA_LINES)
    assert fitting_width(60, 100, SPARSE.world) == 60


def test_people_with_a_window_get_a_picture(monkeypatch):
    """Where matplotlib has an interactive backend, the picture is shown in one window that is updated and closed."""
    drawn, closed = [], []

    class Canvas(FigureCanvasBase):
        def draw_idle(self):
            drawn.append(self.figure.images[0].get_array().copy())

        def flush_events(self):
            pass

    def figure(name, figsize, dpi):
        import matplotlib.figure  # noqa: PLC0415 - what pyplot would do here

        made = matplotlib.figure.Figure(figsize=figsize, dpi=dpi)
        Canvas(made)
        made.show = lambda: None
        return made

    pyplot = types.SimpleNamespace(get_backend=lambda: "TkAgg", figure=figure, close=closed.append)
    monkeypatch.setitem(sys.modules, "matplotlib.pyplot", pyplot)
    batch, _ = observed()
    renderer = Renderer(batch, 0)
    renderer.observe()
    renderer.render("human")
    batch.step(np.ones((1, 6), np.float32))
    renderer.observe()
    renderer.render("human")
    assert isinstance(renderer._screen, Window)
    assert len(drawn) == 2
    assert not np.array_equal(*drawn)
    np.testing.assert_array_equal(drawn[1], renderer.render("rgb_array"))
    renderer.close()
    assert len(closed) == 1


def test_without_a_display_there_is_no_window():
    """The backend that matplotlib falls back to draws into memory, so people get the terminal."""
    assert isinstance(render.open_screen(), Terminal)


def test_nothing_is_shown_before_the_first_reset():
    """There is no scene yet; without a mode nothing is ever shown."""
    with pytest.raises(SimulationError):
        parallel_env(SPARSE, render_mode="rgb_array").render()
    farm = parallel_env(SPARSE)
    farm.reset(seed=0)
    with pytest.warns(UserWarning, match="render_mode"):
        assert farm.render() is None


def test_large_teams_and_long_fields_are_drawn():
    """64 UAVs of a type, a field four times as long as deep, and one plot."""
    world = WorldConfig(
        communication_uavs=12,
        monitoring_uavs=1,
        collection_uavs=2,
        field_x=800.0,
        field_y=200.0,
        plots_x=1,
        plots_y=1,
        sensors=40,
        sensor_cycles=(40,),
        steps=5,
    )
    for mode in ("rgb_array", "ansi"):
        farm = parallel_env(FarmConfig(world=world), render_mode=mode)
        farm.reset(seed=0)
        assert len(farm.render()) > 100


def test_zones_and_wind_are_shown():
    """A zone's colour lies over its middle, and picture and text name the wind; without them nothing is there."""
    zone = ((100.0, 100.0), (180.0, 100.0), (180.0, 180.0), (100.0, 180.0))
    config = replace(SPARSE, zones=ZoneConfig((zone,)), wind=WindConfig(speed=4.0))
    observer, plain = observed(config, 1)[1], observed(SPARSE, 1)[1]
    x, y = observer.scene().wind
    assert np.hypot(x, y) == pytest.approx(4.0)
    drawer, image = picture_of(observer)
    _, without = picture_of(plain)
    row, column = drawer.pixel(140.0, 140.0)
    here = image[row - 8 : row + 8, column - 8 : column + 8].astype(int)
    there = without[row - 8 : row + 8, column - 8 : column + 8].astype(int)
    assert (there - here)[..., 1:].mean() > 20.0
    text = terminal_text(observer.scene()).plain
    assert f"wind 4.0 m/s from {np.degrees(np.arctan2(-x, -y)) % 360.0:.0f}" in text
    assert "no-fly zone" in text
    assert "wind" not in terminal_text(plain.scene()).plain


@pytest.mark.parametrize(("speed", "inches"), [(0.5, 0.246), (20.0, 0.48), (40.0, 0.48)])
def test_a_breeze_is_an_arrow_that_can_be_seen(speed, inches):
    """The arrow grows with the wind, from a length that shows where it blows."""
    arrow = WindArrow(Figure().subplots(), top=20.0)
    arrow.update(np.array([0.6, -0.8]) * speed)
    drawn = arrow.artists[0]
    assert [drawn.U[0], drawn.V[0]] == pytest.approx([0.6 * inches, -0.8 * inches])
    assert (drawn.scale, drawn.scale_units) == (1.0, "inches")
