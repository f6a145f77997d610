"""The documentation builds as a site, and every relative link leads somewhere."""

import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[3]
PAGES = sorted(
    path.relative_to(ROOT).as_posix()
    for path in [*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md"), *(ROOT / "research" / "results").rglob("*.md")]
)
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
    named = [name for name in re.findall(r"`([\w/.-]+\.py)`", text) if not name.endswith("/NAME.py")]
    return [name for name in named if not any(path == name or path.endswith(f"/{name}") for path in tracked)]


def test_named_source_files_exist():
    """A page names no module that was moved or removed."""
    tracked = {path.relative_to(ROOT).as_posix() for folder in CODE_FOLDERS for path in (ROOT / folder).rglob("*.py")}
    texts = {page: (ROOT / page).read_text(encoding="utf-8") for page in PAGES if "research/results" not in page}
    assert {page: missing for page, text in texts.items() if (missing := missing_files(text, tracked))} == {}


def test_a_missing_file_is_found():
    """A file is known by its path or by the end of it, and anything else is missing."""
    assert missing_files("`a/b.py` `b.py` `c.py` `x/b.py` `a/NAME.py`", {"a/b.py"}) == ["c.py", "x/b.py"]


def test_a_broken_link_is_found(tmp_path):
    """A link to a missing file and one to a missing heading are found; links in code and to other sites are not."""
    (tmp_path / "other.md").write_text("# One heading: here\n")
    page = tmp_path / "page.md"
    page.write_text("[a](no.md) [b](other.md#no) [c](other.md#one-heading-here) `[d](no)` [e](https://x.y)\n")
    assert broken_links(page) == ["no.md", "other.md#no"]


def test_the_site_builds_without_a_warning(tmp_path):
    """A strict build fails on broken links, pages missing from disk, and modules that the API reference cannot find."""
    line = [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", str(tmp_path)]
    done = subprocess.run(line, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    environments = (tmp_path / "reference" / "api" / "environments.html").read_text(encoding="utf-8")
    assert 'id="eia_sec.rollout.envs.vector.FarmVectorEnv"' in environments
