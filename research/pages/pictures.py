"""The pictures of the policy that ships, as the documentation shows them.

    python -m research.pages.pictures [FOLDER]      # docs/images; needs Playwright and a Chromium

`watch.png` is the page of `eia-sec watch` while a worker flies that policy, `watch-mpe.png` the same page while
untrained agents act in an environment that is no farm, `replay.png` one picture of a film against the strongest
heuristic, `replay.gif` that film in small. `pictures.json` says which parameters they show, by the start of their
digest, and a test compares it with the policy's.
"""

import json
import os
import shutil
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path

from eia_sec.common.actors import TeamActors
from eia_sec.common.config import EnvConfig, IppoConfig, RunConfig
from eia_sec.common.config.files import to_toml, with_values
from eia_sec.common.config.presets import preset
from eia_sec.common.config.run import RolloutConfig
from eia_sec.common.errors import EiaSecError, UsageError
from eia_sec.common.policy_file import load_policy
from eia_sec.common.process import Presence
from eia_sec.common.transport.bus import Bus
from eia_sec.common.transport.endpoint import Endpoint, free_endpoint
from eia_sec.deploy.monitor.web.hub import Hub
from eia_sec.deploy.monitor.web.server import WebServer
from eia_sec.deploy.monitor.web.source import Source
from eia_sec.deploy.policies.replay import Comparison, scenes_of
from eia_sec.deploy.reports.provenance import provenance
from eia_sec.rollout.envs.registry import environment_spec
from eia_sec.rollout.rendering.side_by_side import SideBySidePicture
from eia_sec.rollout.shipped_policies import shipped_file
from eia_sec.rollout.worker.collector import Collector
from eia_sec.rollout.worker.view_service import ViewService

FOLDER = Path("docs/images")
RUN, WORKER = "farm", "0"
SHOWN = "trained"
"""The policy that the pictures show."""
FARM, STEP = 1003, 300
"""Farm and step of the film's picture; the page shows the worker's own farm at that step."""
FILM_STEPS, FILM_EVERY = 240, 10
"""Steps that the small film shows, and steps from one frame to the next."""
FILM_WIDTH, FILM_COLOURS, FILM_MILLISECONDS = 640, 64, 200
"""Its pixels, its colours, and how long a frame stands."""
PATIENCE = 120.0
OTHER, OTHER_RUN, OTHER_STEP = "mpe2:simple_spread_v3", "spread", 20
"""An environment that is no farm, its run's name, and the step of it that the page shows."""
FIND = """wanted => { if (!window.watching) return -1;
const p = watching.past; const step = (n) => n >= p.first && p.at(n) ? p.at(n).step : -1;
for (let n = p.first; n <= p.last; n++) if (step(n) === wanted && step(n - wanted + 1) === 1) return n;
return -1 }"""
"""Number of the frame of that step of an episode that was seen from its start, or -1."""


def replay_pictures(picture_path: Path, film_path: Path) -> None:
    """Save one picture, and a small film, of the policy that ships against the heuristic horizon."""
    from PIL import Image  # noqa: PLC0415  (loaded only where a picture is made)

    names = ("EIA-SEC (shipped policy)", "horizon")
    comparison = Comparison(preset("inertial").farm, (SHOWN, "horizon"), names, FARM, 0)
    picture, frames = None, []
    for scenes in scenes_of(comparison):
        picture = picture or SideBySidePicture(comparison.names, scenes)
        picture.note(scenes)
        step = scenes[0].step
        if step == STEP or step % FILM_EVERY == 0:
            drawn = Image.fromarray(picture.draw(scenes)).convert("RGB")
            if step == STEP:
                drawn.save(picture_path)
            if step <= FILM_STEPS:
                small = drawn.resize((FILM_WIDTH, round(drawn.height * FILM_WIDTH / drawn.width)))
                frames.append(small.quantize(FILM_COLOURS, Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE))
    frames[0].save(film_path, save_all=True, append_images=frames[1:], duration=FILM_MILLISECONDS, loop=0)


@contextmanager
def flying(
    config: RunConfig, actors: TeamActors, run: str, name: str, endpoint: Endpoint | None = None, noise: float = 0.0
) -> Iterator[tuple[Endpoint, ViewService]]:
    """Fly and show on a thread, as a worker does, with a listening bus of its own and no learner."""
    where, over = endpoint or free_endpoint(), threading.Event()
    with Bus.listen(where, "control") as bus:
        collector = Collector(config, name, 1)
        view_service = ViewService(bus, run, name, 1, collector, to_toml(config))
        presence = Presence(bus, run, "rollout", name, 1)

        def loop() -> None:
            while not over.wait(0.005):
                view_service.poll(0, noise, False)
                collector.collect(actors, noise, False)

        thread = threading.Thread(target=loop)
        thread.start()
        try:
            yield where, view_service
        finally:
            over.set()
            thread.join()
            del presence


@contextmanager
def serving(endpoint: Endpoint, run: str) -> Iterator[str]:
    """Serve the page of `eia-sec watch` for whatever worker there is; give its address."""
    with Bus.connect(endpoint, "control", wait=PATIENCE) as bus:
        hub, over = Hub(), threading.Event()
        source = Source(bus, run, None, hub)

        def tend() -> None:
            while not over.wait(0.02):
                source.tend(hub.seats > 0)

        thread = threading.Thread(target=tend)
        thread.start()
        try:
            with WebServer(hub, "127.0.0.1", 0) as web:
                yield f"http://127.0.0.1:{web.port}/"
        finally:
            over.set()
            thread.join()


def farm_page(path: Path) -> None:
    """Save the page while a worker flies the policy that ships, on one farm alone, so that no page waits for others."""
    config = with_values(preset("inertial"), {"rollout.environments": 1})
    _page(path, flying(config, load_policy(shipped_file(SHOWN))[0], RUN, WORKER), RUN, STEP)


def environment_page(path: Path) -> None:
    """Save the page while untrained agents act in an environment that is no farm."""
    rollout = RolloutConfig(environments=1, chunk_steps=25)
    config = RunConfig(env=EnvConfig(OTHER), rollout=rollout, algorithm=IppoConfig())
    actors = TeamActors.initial(environment_spec(config).team, config.algorithm.hidden, 0, head="gaussian")
    _page(path, flying(config, actors, OTHER_RUN, WORKER), OTHER_RUN, OTHER_STEP)


def _page(path: Path, worker: AbstractContextManager[tuple[Endpoint, ViewService]], run: str, step: int) -> None:
    """Save the page at a step in the middle of an episode, as a browser shows it.

    Raises:
        UsageError: there is no Chromium.
        EiaSecError: the page has not shown that step in time.
    """
    from playwright.sync_api import sync_playwright  # noqa: PLC0415  (loaded only where a picture is made)

    chromium = os.environ.get("CHROMIUM") or shutil.which("chromium") or shutil.which("chromium-browser")
    if chromium is None:
        raise UsageError("there is no Chromium on the path; name one in the variable CHROMIUM.")
    with worker as (endpoint, _), serving(endpoint, run) as address, sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        page = browser.new_page(viewport={"width": 1440, "height": 900}, color_scheme="light")
        page.goto(address)
        place, deadline = -1, time.monotonic() + PATIENCE
        while place < 0 and time.monotonic() < deadline:
            time.sleep(0.2)
            place = page.evaluate(FIND, step)
        if place < 0:
            raise EiaSecError("the page did not show the wanted step in time.")
        page.click("#play")
        slide = "n => {const s = document.getElementById('slider'); s.value = n; s.dispatchEvent(new Event('input'))}"
        page.evaluate(slide, place)
        time.sleep(1.0)
        page.screenshot(path=str(path))
        browser.close()


def main(arguments: list[str]) -> None:
    """Make the pictures and note whose they are."""
    folder = Path(arguments[0]) if arguments else FOLDER
    folder.mkdir(parents=True, exist_ok=True)
    # Before the pictures, which would make a commit that holds them look changed.
    notes = {**provenance("research.pages.pictures"), "policy": load_policy(shipped_file(SHOWN))[0].digest()[:16]}
    replay_pictures(folder / "replay.png", folder / "replay.gif")
    farm_page(folder / "watch.png")
    environment_page(folder / "watch-mpe.png")
    (folder / "pictures.json").write_text(json.dumps(notes, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
