"""The documentation builds as a site, and every relative link leads somewhere, in the repository and on the site."""

import json
import os
import re
import shutil
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote

import pytest

from research.pages.site import repository_url

ROOT = Path(__file__).resolve().parents[3]
PAGES = sorted(
    path.relative_to(ROOT).as_posix()
    for path in [*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md"), *(ROOT / "research" / "results").rglob("*.md")]
)
ORIGIN = "git@example.org:robots/eia-sec.git"
CODE_FOLDERS = ("common", "rollout", "learner", "elite", "deploy", "research", "tests", "docs")
LINK = re.compile(r"\]\(([^)\s]+)\)")
CODE = re.compile(r"^```.*?^```|`[^`\n]*`", re.MULTILINE | re.DOTALL)


def broken_links(page: Path) -> list[str]:
    """Return the relative links of a page that lead to no file, or to no heading of a page."""
    found = []
    for target in LINK.findall(CODE.sub("", page.read_text(encoding="utf-8"))):
        if re.match(r"[a-z]+:", target):
            continue
        name, _, anchor = target.partition("#")
        file = (page.parent / name).resolve() if name else page
        if not file.exists() or (anchor and file.suffix == ".md" and anchor not in anchors(file)):
            found.append(target)
    return found


def anchors(page: Path) -> set[str]:
    """Return the anchors of a page's headings."""
    headings = re.findall(r"^#+ (.*)$", page.read_text(encoding="utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).strip().replace(" ", "-") for heading in headings}


def test_relative_links_lead_somewhere():
    """Every relative link of README, docs and results names a file, and every anchor a heading."""
    assert {page: broken for page in PAGES if (broken := broken_links(ROOT / page))} == {}


def missing_files(text: str, tracked: set[str]) -> list[str]:
    """Return the source files that a page names in backticks and that do not exist, by their whole path or its end."""
    named = [name for name in re.findall(r"`([\w/.-]+\.py)`", text) if not name.endswith("NAME.py")]
    return [name for name in named if not any(path == name or path.endswith(f"/{name}") for path in tracked)]


def test_named_source_files_exist():
    """A page names no module that was moved or removed."""
    tracked = {path.relative_to(ROOT).as_posix() for folder in CODE_FOLDERS for path in (ROOT / folder).rglob("*.py")}
    texts = {page: (ROOT / page).read_text(encoding="utf-8") for page in PAGES if "research/results" not in page}
    assert {page: missing for page, text in texts.items() if (missing := missing_files(text, tracked))} == {}


class Anchors(HTMLParser):
    """The targets and the links of a page."""

    def __init__(self, text):
        super().__init__()
        self.targets, self.links = set(), []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        found = dict(attrs)
        self.targets |= {found[name] for name in ("id", "name") if found.get(name)}
        self.links += [found[name] for name in ("href", "src") if found.get(name)]


def broken_on_site(site):
    """Return the links of a built site, by page, that lead to no file of it, or to nothing on its page."""
    pages = {
        path: Anchors(path.read_text(encoding="utf-8")) for path in site.rglob("*.html") if path.name != "404.html"
    }
    broken = {}
    for path, page in pages.items():
        for link in page.links:
            name, _, anchor = link.partition("#")
            target = (path.parent / unquote(name)).resolve() if name else path
            target = target / "index.html" if target.is_dir() else target
            missing = not target.is_file() or (
                anchor and target in pages and unquote(anchor) not in pages[target].targets
            )
            if missing and not re.match(r"[a-z]+:", link):
                broken.setdefault(path.relative_to(site).as_posix(), []).append(link)
    return broken


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The site, built strictly: broken links, missing pages and unknown modules are errors."""
    folder = tmp_path_factory.mktemp("site").resolve()
    line = [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", str(folder)]
    origin = {f"GIT_CONFIG_{name}_0": value for name, value in (("KEY", "remote.origin.url"), ("VALUE", ORIGIN))}
    environment = os.environ | origin | {"GIT_CONFIG_COUNT": "1"}
    done = subprocess.run(line, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return folder


def test_the_site_has_the_interfaces(site):
    """The API reference finds the modules."""
    environments = (site / "reference" / "api" / "environments.html").read_text(encoding="utf-8")
    assert 'id="eia_sec.rollout.envs.vector.FarmVectorEnv"' in environments


def test_every_link_of_the_site_leads_somewhere(site):
    """Those to README, to notebooks and to results, too; strict builds do not look outside docs/."""
    assert (site / "project" / "index.html").is_file()
    assert broken_on_site(site) == {}


def test_every_page_leads_to_its_source(site):
    """Where the origin is on the web, each page has a link to the file of the repository that it is made from."""
    edited = "https://example.org/robots/eia-sec/edit/main/"
    pages = [page.read_text(encoding="utf-8") for page in site.rglob("*.html") if page.name != "404.html"]
    sources = [re.findall(rf'href="{edited}([^"]+)"', page) for page in pages]
    assert len(pages) > len(PAGES) // 2
    assert all(len(found) == 1 and (ROOT / found[0]).is_file() for found in sources)


@pytest.mark.parametrize(
    ("origin", "page"),
    [
        ("https://example.org/robots/eia-sec.git", "https://example.org/robots/eia-sec"),
        ("https://token@example.org/robots/eia-sec", "https://example.org/robots/eia-sec"),
        ("ssh://git@example.org/robots/eia-sec.git", "https://example.org/robots/eia-sec"),
        (ORIGIN, "https://example.org/robots/eia-sec"),
        ("/srv/git/eia-sec.git", None),
        ("file:///srv/git/eia-sec", None),
        ("", None),
    ],
)
def test_an_origin_on_the_web_has_a_page(origin, page):
    """No secret of an address gets into the site."""
    assert repository_url(origin) == page


def test_every_setting_is_found_by_itself(site):
    """The search has an entry of its own for each."""
    entries = json.loads((site / "search" / "search_index.json").read_text(encoding="utf-8"))["docs"]
    places = {entry["location"] for entry in entries}
    assert {"reference/configuration.html#farmworldfield_x", "reference/configuration.html#algorithmclip"} <= places


@pytest.mark.slow
@pytest.mark.parametrize("width", [390, 1280])
def test_no_page_scrolls_sideways(site, width):
    """On a phone and on a laptop; wide tables scroll within themselves."""
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    chromium = os.environ.get("CHROMIUM") or shutil.which("chromium") or shutil.which("chromium-browser")
    if chromium is None:
        pytest.skip("there is no chromium on this machine")
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        page = browser.new_page(viewport={"width": width, "height": 844})
        wide = []
        for path in sorted(site.rglob("*.html")):
            page.goto(path.as_uri())
            if page.evaluate("document.documentElement.scrollWidth") > width:
                wide.append(path.relative_to(site).as_posix())
        browser.close()
    assert wide == []
