"""The page of a farm with patches of stress, stations, batteries, a UAV that fails and links that count."""

import numpy as np

from eia_sec.common.farm import COMMUNICATION
from eia_sec.rollout.rendering.palette import COLOURS, GONE, LINK_DOWN, STRESS, rgb
from tests.deploy.monitor.web import test_watch_page as pages
from tests.deploy.monitor.web.stage import CHAINED, CONDITIONS, CONFIG, until
from tests.deploy.monitor.web.test_watch_page import jump, looking

pytestmark = pages.pytestmark
FARM = CONDITIONS.farm
RADIUS = 12.0
"""Of patches as the page draws them, m; those of the farm would cover all of it."""
SIGNS = ("link out of range, 40 m", "charging station", "UAV that has failed", "patch of stress", "area of faster")
"""The legend's lines for what only some farms have."""
EVENTFUL = """(() => { const p = watching.past;
const row = (f, name) => { const a = f.packet.arrays[name]; const w = a.length / a.shape[0];
    return [...a.subarray(f.i * w, (f.i + 1) * w)] };
for (let n = p.last; n > p.first; n--) { const f = p.at(n);
    const lives = f.packet.patches.filter(([, , first, end]) => first <= f.step && f.step < end);
    const down = row(f, "linked").some((up, k) => !up && row(f, "assignment")[k] < 255);
    if (f.step > 10 && lives.length && down) return n }
})()"""
"""Number of the newest frame with a patch, and a link that is out of range."""
FRAME = """() => { const f = watching.past.at(Math.floor(watching.view.head)); const a = f.packet.arrays;
const row = (n) => { const w = a[n].length / a[n].shape[0]; return [...a[n].subarray(f.i * w, (f.i + 1) * w)] };
return {step: f.step, patches: f.packet.patches, known: row("known"), gone: row("gone"), charge: row("charge"),
    linked: row("linked"), assignment: row("assignment"), position: row("position")} }"""
PIXELS = """places => { const { field } = watching.view; const { canvas } = field;
const all = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height).data;
const at = pixels => Math.round(pixels * devicePixelRatio);
return places.map(([x, y, right, down]) => {
    const begin = 4 * (at(field.y(y) + down) * canvas.width + at(field.x(x) + right));
    return [...all.subarray(begin, begin + 3)] }) }"""
"""Colours at places of the field in m, each moved by so many pixels."""
COUNT = """([colour, most]) => { const { canvas } = watching.view.field; let count = 0;
const all = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height).data;
for (let k = 0; k < all.length; k += 4) count += colour.every((value, c) => Math.abs(all[k + c] - value) <= most);
return count }"""
"""Number of pixels whose colour is close to one."""


def pixels(page, places, right=0.0, down=0.0):
    """Return the colours at places of the field, [N, 3]."""
    return np.array(page.evaluate(PIXELS, [[float(x), float(y), right, down] for x, y in places]), np.float64)


def redraw(page, change):
    """Change what is shown, and wait for another drawing."""
    page.evaluate(change)
    page.evaluate("watching.view.drawn = ''")
    until(lambda: page.evaluate("watching.view.drawn !== ''"), "another drawing")


def close(found, colour, most=12.0):
    """Return which colours are close to one, [N]."""
    return np.abs(found - rgb(colour)).max(axis=1) <= most


def test_a_farm_without_conditions_has_no_signs_of_them():
    """The legend of such a farm does not name what it does not have."""
    with looking(CONFIG) as (page, _, complaints):
        legend = page.inner_text("#signs")
        assert "relay and whom it serves" in legend
        assert not any(sign in legend for sign in SIGNS)
        assert complaints == []


def test_the_page_shows_what_only_some_farms_have():
    """Bars, crosses, red links, hexagons and tinted patches are where the frame says, and the legend explains them."""
    with looking(CONDITIONS) as (page, _, complaints):
        jump(page, EVENTFUL, "a frame with a patch and a link out of range")
        page.evaluate("watching.past.add = () => {}")  # so that this frame is never too old to be kept
        frame = page.evaluate(FRAME)
        position = np.reshape(frame["position"], (-1, 2))
        gone = np.array(frame["gone"], bool)
        assert gone.tolist() == [False, False, False, False, True]
        assert all(sign in page.inner_text("#signs") for sign in SIGNS)
        redraw(page, "Object.assign(watching.view.scene.reach, {monitoring: 0, collection: 0})")
        redraw(page, f"watching.view.scene.stress.radius = {RADIUS}")
        assert close(pixels(page, position[gone]), GONE).all()
        assert bars_match(page, position[~gone], np.array(frame["charge"])[~gone] / 255)
        assert links_are_red(page)
        assert stations_are_drawn(page)
        assert areas_are_outlined(page)
        assert patches_are_tinted(page, frame)
        assert complaints == []


def test_the_page_shows_chains():
    """The legend names base station and hops, whose lines and mark vanish with the base station."""
    with looking(CHAINED) as (page, _, complaints):
        assert "base station" in page.inner_text("#signs")
        assert "hop to it, at most 70 m" in page.inner_text("#signs")
        assert "link out of range, 40 m, or without hops" in page.inner_text("#signs")
        until(lambda: page.evaluate("watching.past.last > 3"), "some frames")
        page.evaluate("watching.view.playing = false; watching.past.add = () => {}")
        redraw(page, "watching.past.at(Math.floor(watching.view.head)).packet.arrays.joined.fill(1)")
        blue, dark = COLOURS[COMMUNICATION], "#222222"
        before = count(page, blue, 30), count(page, dark, 20)  # what is transparent counts as black, 34 away
        redraw(page, "delete watching.view.scene.base")
        assert count(page, blue, 30) < before[0] - 30
        assert count(page, dark, 20) < before[1] - 40
        assert complaints == []


def bars_match(page, places, share):
    """Return whether most bars are dark up to the charge and white behind it; UAVs and bars may hide others."""
    assert ((share > 0.1) & (share < 0.9)).all()
    dark = pixels(page, places, right=-11.0, down=18.0)
    ends = [pixels(page, [xy], 24.0 * part - 14.0, 18.0)[0] for xy, part in zip(places, share, strict=True)]
    empty = [pixels(page, [xy], 24.0 * part - 10.0, 18.0)[0] for xy, part in zip(places, share, strict=True)]
    whole = close(dark, "#222222") & close(np.array(ends), "#222222") & close(np.array(empty), "#ffffff")
    return whole.mean() > 0.5


def count(page, colour, most=12):
    """Return the number of pixels of the map that are close to a colour."""
    return page.evaluate(COUNT, [list(rgb(colour)), most])


def links_are_red(page):
    """Return whether there is more red than without links, until all links are within range.

    Trails within patches are red, too, where both are drawn over each other.
    """
    frame = "watching.past.at(Math.floor(watching.view.head)).packet.arrays"
    out_of_range = count(page, LINK_DOWN, 30)
    redraw(page, f"{frame}.linked.fill(1)")
    within_range = count(page, LINK_DOWN, 30)
    redraw(page, f"{frame}.assignment.fill(255)")
    without = count(page, LINK_DOWN, 30)
    return out_of_range > without + 50 and within_range < without + 20


def stations_are_drawn(page):
    """Return whether the map is less dark without the stations' hexagons."""
    before = count(page, "#222222", 40)
    redraw(page, "watching.view.scene.stations.length = 0")
    return count(page, "#222222", 40) < before - 40


def areas_are_outlined(page):
    """Return whether the map has less of the stress's colour without the areas."""
    before = count(page, STRESS, 60)
    redraw(page, "watching.view.scene.areas.outlines.length = 0")
    return count(page, STRESS, 60) < before - 100


def patches_are_tinted(page, frame):
    """Return whether plots within the patches of this step, and no others, lose a tint when these are taken away."""
    grid = np.stack(np.meshgrid(np.arange(0.5, 100.0, 2.0), np.arange(0.5, 80.0, 2.0)), axis=-1).reshape(-1, 2)
    with_patches = pixels(page, grid)
    redraw(page, "watching.past.at(Math.floor(watching.view.head)).packet.patches.length = 0")
    without = pixels(page, grid)
    changed = np.abs(with_patches - without).max(axis=1) > 2
    lives = [(x, y) for x, y, first, end in frame["patches"] if first <= frame["step"] < end]
    apart = np.min([np.hypot(*(grid - place).T) for place in lives], axis=0)
    radius = RADIUS
    nearer = [np.abs(colours[changed] - rgb(STRESS)).sum(axis=1).mean() for colours in (with_patches, without)]
    assert nearer[0] < nearer[1]
    return changed[apart < radius - 1].mean() > 0.6 and not changed[apart > radius + 1].any()
