"""The page of `eia-sec watch` in a real browser, where there is one."""

import os
import shutil
from contextlib import contextmanager

import numpy as np
import pytest

from eia_sec.deploy.monitor.web import packets
from eia_sec.deploy.monitor.web.hub import Hub
from eia_sec.deploy.monitor.web.server import WebServer
from eia_sec.rollout.rendering.palette import AGE_STOPS, SOIL_STOPS, rgb
from eia_sec.rollout.sim.layout import make_layout
from research.pages.pictures import serving
from tests.deploy.monitor.web.stage import CONDITIONS, CONFIG, DRAWN, RUN, flying, until

playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
CHROMIUM = os.environ.get("CHROMIUM") or shutil.which("chromium") or shutil.which("chromium-browser")
pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="there is no chromium on this machine")

WORLD = CONFIG.farm.world
VARIED = """(() => { const p = watching.past;
for (let n = p.last; n > p.first; n--) { const f = p.at(n); const a = f.packet.arrays.vdf;
const w = a.length / a.shape[0];
if (f.step > 5 && new Set(a.subarray(f.i * w, (f.i + 1) * w)).size > 1) return n } })()"""
"""Number of the newest frame whose plots differ in age."""


@contextmanager
def looking(config=CONFIG):
    """Open the page of a worker that flies; yield the page, the worker and what the browser complained of."""
    with (
        flying(config=config) as (endpoint, view_service),
        serving(endpoint, RUN) as address,
        playwright.sync_playwright() as driver,
    ):
        browser = driver.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        page = browser.new_page(viewport={"width": 1440, "height": 900}, color_scheme="light")
        complaints = []
        page.on("console", lambda m: complaints.append(m.text) if m.type == "error" else None)
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.on("requestfailed", lambda request: complaints.append(request.url))
        page.goto(address)
        until(lambda: page.evaluate("window.watching && watching.past.frames.length > 45"), "frames in the page")
        yield page, view_service, complaints
        browser.close()
        until(lambda: view_service.watchers == 0, "the end of the watching")


def test_the_page_shows_what_the_worker_flies():
    """Numbers, colours on the map and words are those of the frames; pause, slider and speeds do what they say."""
    with looking() as (page, view_service, complaints):
        jump(page, VARIED, "a frame with plots of several ages")
        frame = page.evaluate(
            """() => { const f = watching.past.at(Math.floor(watching.view.head)); const a = f.packet.arrays;
            const row = (n) => { const w = a[n].length / a[n].shape[0];
            return [...a[n].subarray(f.i * w, (f.i + 1) * w)] };
            return {farm: f.packet.farm, step: f.step, vdf: row('vdf'), aoi: row('aoi'), parts: row('parts'),
            level: row('level'), sensor: [...a.sensor], position: row('position')} }"""
        )
        until(
            lambda: f"farm {frame['farm']}, step {frame['step']} of {WORLD.steps}" in page.inner_text("#headline"), "it"
        )
        np.testing.assert_allclose(
            np.reshape(frame["sensor"], (-1, 2)), make_layout(CONFIG.farm, frame["farm"]).sensor_xy, atol=1e-4
        )
        assert page.inner_text("#fresh tbody tr:nth-child(1) td:nth-child(2)") == f"{frame['level'][0]:.2f}"
        fresh = np.mean(np.array(frame["vdf"]) == 0)
        assert page.inner_text("#fresh tbody tr:nth-child(2) td:nth-child(3)") == f"{100 * fresh:.0f} %"
        monitoring = np.reshape(frame["parts"], (3, -1))[1].sum()
        shown = page.inner_text("#reward tbody tr:nth-child(2) td:nth-child(2)").replace("\N{MINUS SIGN}", "-")
        assert float(shown) == pytest.approx(monitoring, abs=0.0051)
        assert colours_match(page, frame)
        step = page.evaluate("watching.view.head")
        page.keyboard.press("Escape")
        page.select_option("#speed", "100")
        page.click("#newest")
        until(lambda: page.evaluate("watching.view.head") != step, "playing again")
        assert "run watched, worker w" in page.inner_text("#who")
        assert page.inner_text("#sentence") == "watching"
        assert view_service.watchers == 1
        assert complaints == []


def jump(page, wanted, what):
    """Pause at the frame whose number a script finds."""
    page.click("#play")
    until(lambda: page.inner_text("#play") == "play", "the pause")
    target = until(lambda: page.evaluate(wanted), what)
    until(lambda: int(page.get_attribute("#slider", "max")) >= target, "the slider's new end")
    page.evaluate(
        "n => { const s = document.getElementById('slider'); s.value = n; s.dispatchEvent(new Event('input')) }",
        target,
    )
    until(lambda: page.evaluate("Math.floor(watching.view.head)") == target, "the jump")


def colours_match(page, frame):
    """Return whether most plots have the colour of their VDF and most sensors that of their AoI.

    Looked at are the plots' corners and the sensors' middles; a sensor hides a few.
    """
    # Reach tints most of this small field, and UAVs fly from corner to corner.
    page.evaluate(
        """() => { const { field } = watching.view;
        Object.assign(field.scene.reach, {monitoring: 0, collection: 0});
        for (const hiding of ['drawUavs', 'drawLinks', 'drawTrails']) field[hiding] = () => {} }"""
    )
    page.evaluate("watching.view.drawn = ''")
    until(lambda: page.evaluate("watching.view.drawn !== ''"), "another drawing")
    steps = np.array([WORLD.plots_x, WORLD.plots_y])
    corners = (np.indices(steps).reshape(2, -1).T + 0.03) / steps * [WORLD.field_x, WORLD.field_y]
    soil = matching(page, corners, frame["vdf"], SOIL_STOPS)
    return soil and matching(page, np.reshape(frame["sensor"], (-1, 2)), frame["aoi"], AGE_STOPS)


def matching(page, places, levels, stops):
    """Return whether most places of the field, in m, have the colours of their levels, and these are not all one."""
    found = page.evaluate(
        """places => { const { field } = watching.view; const pen = field.canvas.getContext('2d');
        const at = metres => Math.round(metres * devicePixelRatio);
        return places.map(([x, y]) =>
            [...pen.getImageData(at(field.x(x)), at(field.y(y)), 1, 1).data].slice(0, 3)) }""",
        np.asarray(places).tolist(),
    )
    known = np.array([rgb(stop) for stop in stops], np.float64)
    share = np.array(levels) / 255
    wanted = np.stack([np.interp(share, np.linspace(0, 1, len(known)), known[:, c]) for c in range(3)], axis=1)
    close = np.abs(np.array(found) - wanted).max(axis=1) <= 2
    return close.mean() >= 0.9 and len(np.unique(wanted, axis=0)) > 1


OVERLAPS = """() => {
    const shown = new Set(['CANVAS', 'svg', 'BUTTON', 'SELECT', 'INPUT']), found = [];
    const hit = (a, b) => Math.min(a.right, b.right) - Math.max(a.left, b.left) > 1
        && Math.min(a.bottom, b.bottom) - Math.max(a.top, b.top) > 1;
    const boxes = root => [...root.querySelectorAll('*')].flatMap(e => {
        if (e.closest('#tip') || e.parentElement.closest('svg, button, select')) return [];
        if (shown.has(e.tagName)) return [[e.id || e.tagName, e.getBoundingClientRect()]];
        return [...e.childNodes].filter(n => n.nodeType === Node.TEXT_NODE && n.data.trim()).flatMap(n => {
            const range = document.createRange();
            range.selectNodeContents(n);
            return [...range.getClientRects()].map(box => [n.data.trim(), box]);
        });
    }).filter(([, box]) => box.width > 0 && box.height > 0);
    const compare = named => named.forEach(([a, first], k) => named.slice(k + 1).forEach(([b, second]) => {
        if (hit(first, second)) found.push(`${a} / ${b}`);
    }));
    document.querySelectorAll('header, footer, #stage, .card').forEach(part => compare(boxes(part)));
    const parts = [...document.querySelectorAll('header, #headline, #field-box, .card')];
    compare(parts.map(e => [e.id || e.tagName, e.getBoundingClientRect()]));
    return found }"""
"""Names what lies over one another: texts, pictures and controls of each part, and the parts themselves.

The footer is left out of the latter: it stays at the bottom while the rest of a small window scrolls beneath it.
"""


PIXEL = """() => { const canvas = document.getElementById('picture');
return [...canvas.getContext('2d').getImageData(20, 20, 1, 1).data] }"""
DRAWN_FRAME = """(() => { const p = watching.past;
for (let n = p.last; n > p.first; n--) { const f = p.at(n);
    if (f.step > 5 && f.packet.arrays.ends[f.i] > (f.i ? f.packet.arrays.ends[f.i - 1] : 0)) return n } })()"""
"""Number of the newest frame with a picture."""


def test_the_page_shows_any_environment():
    """The picture is that of the step, and each agent's row has its reward, action and what it saw."""
    with looking(DRAWN) as (page, _, complaints):
        assert "toy_pictures:Drawn" in page.inner_text("#title")
        assert not page.is_visible("#field")
        assert not page.is_visible("#legend-card")
        jump(page, DRAWN_FRAME, "a frame with a picture")
        frame = page.evaluate(
            """() => { const f = watching.past.at(Math.floor(watching.view.head)); const a = f.packet.arrays;
            const row = (n) => { const w = a[n].length / a[n].shape[0];
            return [...a[n].subarray(f.i * w, (f.i + 1) * w)] };
            return {step: f.step, sum: [...f.sum], parts: row('parts'), action: row('action'), seen: row('seen')} }"""
        )
        until(lambda: page.evaluate(PIXEL) == [*[frame["step"]] * 3, 255], "the picture")
        assert f"step {frame['step']} of an episode" in page.inner_text("#headline")
        rows = page.locator("#agents tbody tr")
        assert rows.count() == 3
        cells = rows.nth(0).locator("th, td").all_inner_texts()
        numbers = [float(text.replace("\N{MINUS SIGN}", "-")) for text in (*cells[1:3], *cells[4:])]
        wanted = [frame["parts"][0], frame["sum"][0], *frame["seen"][:3]]
        assert cells[0].strip() == "runner_0"
        assert numbers == pytest.approx(wanted, abs=0.051)
        told = [float(text.replace("\N{MINUS SIGN}", "-")) for text in cells[3].split(", ")]
        assert told == pytest.approx(frame["action"][:2], abs=0.0051)
        assert complaints == []


MENU = """() => { const menu = document.getElementById('worker');
return [menu.checkVisibility(), [...menu.options].map((option) => option.value), menu.value] }"""
"""Whether the menu of workers is visible, whom it offers, and whom it marks."""


def test_one_chooses_another_worker_once_the_chosen_one_is_gone():
    """The menu hides only where there is no other, and marks the worker that is shown, also while it has the focus."""
    hub = Hub()
    with WebServer(hub, "127.0.0.1", 0) as web, playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        page = browser.new_page()
        page.goto(f"http://127.0.0.1:{web.port}/")
        until(lambda: hub.seats == 1, "the stream")
        for workers, chosen, visible, marked in (
            (["a", "b"], "b", True, "b"),
            (["a"], "b", True, ""),
            (["a", "b"], "b", True, "b"),
            (["b"], "b", False, "b"),
            ([], "b", False, ""),
            (["a", "b", "c"], "c", True, "c"),
        ):
            hub.report(packets.state("", {"wrong": False, "worker": chosen, "workers": workers}))
            until(lambda wanted=workers: page.evaluate(MENU)[1] == wanted, "the menu")
            assert page.evaluate(MENU) == [visible, workers, marked]
            if visible:
                page.focus("#worker")
        hub.report(packets.state("", {"wrong": False, "worker": "b", "workers": ["a"]}))
        until(lambda: page.evaluate(MENU)[1] == ["a"], "the menu")
        page.select_option("#worker", "a")
        until(lambda: hub.wanted == "a", "the choice")
        browser.close()


def test_a_page_that_falls_far_behind_jumps_to_the_newest_episode():
    """It says so; whoever has stopped stays where they are."""
    with looking() as (page, _, complaints):
        page.evaluate("document.getElementById('speed').options[0].value = 0")
        page.select_option("#speed", index=0)
        page.evaluate("watching.view.head = watching.past.first")
        more = """() => { const { past, view } = watching; const { packet } = past.at(past.last);
            while (past.last - view.head <= 1600) past.add({...packet, first: 0});
            past.add = () => {} }"""
        page.click("#play")
        head = page.evaluate("watching.view.head")
        page.evaluate(more)
        assert page.evaluate("watching.past.last - watching.view.head") > 1500
        assert not page.is_visible("#notice")
        assert page.evaluate("watching.view.head") == head
        page.click("#play")
        until(lambda: page.is_visible("#notice"), "the notice")
        assert "steps behind: jumped to the newest episode." in page.inner_text("#notice")
        assert page.evaluate("watching.view.head") == page.evaluate("watching.past.beginOf(watching.past.last)")
        assert complaints == []


@pytest.mark.parametrize("config", [CONFIG, CONDITIONS, DRAWN])
def test_nothing_overlaps_or_sticks_out(config):
    """In wide and in narrow windows nothing lies over another or runs out of its box, and controls can be reached."""
    with looking(config) as (page, _, complaints):
        for width, height in ((1440, 900), (1280, 800), (1024, 768), (390, 844)):
            page.set_viewport_size({"width": width, "height": height})
            sticking = page.evaluate(
                """() => [...document.querySelectorAll('header *, footer *, .card *, #headline')]
                .filter(e => !e.closest('.wide')).filter(e => e.getBoundingClientRect().right > innerWidth + 1
                || (e.children.length === 0 && e.scrollWidth > e.clientWidth + 1 && e.clientWidth > 0))
                .map(e => e.id || e.className || e.textContent)"""
            )
            assert sticking == []
            assert page.evaluate(OVERLAPS) == []
            assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
            if width >= 1280:
                aside = page.locator("aside")
                assert aside.evaluate("e => e.scrollHeight") == aside.evaluate("e => e.clientHeight")
            for name in ("#play", "#slider", "#speed", "#newest", "#theme"):
                box = page.locator(name).bounding_box()
                assert box["y"] >= 0
                assert box["y"] + box["height"] <= height
            field = page.locator("#field-box").bounding_box()
            assert min(field["width"], field["height"]) >= 300
        page.click("#theme")
        assert page.evaluate("document.documentElement.dataset.theme") == "dark"
        page.set_viewport_size({"width": 1440, "height": 900})
        above, below = ("agents-card", "rewards-card") if config is DRAWN else ("fresh-card", "legend-card")
        page.evaluate(f"document.getElementById('{below}').style.marginTop = '-30px'")
        page.evaluate("document.getElementById('newest').style.marginLeft = '-40px'")
        assert {f"{above} / {below}", "speed / newest"} <= set(page.evaluate(OVERLAPS))
        assert complaints == []
