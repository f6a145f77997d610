"""A hook of MkDocs: what the site takes from outside docs/.

The pages and pictures of research/results are below results/, README and the pages beside it below project/; notebooks
of docs/ become pages. Where the checkout's origin is on the web, pages link to it, and to where they can be edited.
"""

import json
import posixpath
import re
import subprocess
import tomllib
from pathlib import Path
from typing import Final

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

SHOWN: Final = {".md", ".png", ".svg", ".json"}
PROJECT: Final = ("README.md", "CONTRIBUTING.md", "CHANGELOG.md", "SECURITY.md", "LICENSE")
LINK: Final = re.compile(r"(\]\()([^)#\s:]+)(?=[)#])")
ORIGIN: Final = re.compile(r"(?:https://(?:[^@/]+@)?|ssh://git@|git@)([\w.-]+)[/:]([\w./-]+?)(?:\.git)?/?")
"""Host and path of a repository, in the forms that Git clones from."""


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Put the version at the foot of every page, and a link to the repository at its head."""
    project = tomllib.loads((_root(config) / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    config.copyright = f"{config.site_name} {project['version']}, {project['license']}"
    config.repo_url = repository_url(_origin(_root(config)))
    if config.repo_url:
        config.repo_name = config.repo_url.split("/", 3)[3]
    return config


def repository_url(origin: str) -> str | None:
    """Return the web page of the repository at a Git address; None of one that is not on the web."""
    found = ORIGIN.fullmatch(origin)
    return f"https://{found[1]}/{found[2]}" if found else None


def _origin(root: Path) -> str:
    command = ["git", "-C", str(root), "config", "--get", "remote.origin.url"]
    try:
        return subprocess.run(command, capture_output=True, text=True, check=False).stdout.strip()
    except OSError:  # an archive of the sources, on a machine without Git
        return ""


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add every page, picture and table of results, and the project's own pages."""
    root = _root(config)
    for path in sorted((root / "research" / "results").rglob("*")):
        if path.suffix in SHOWN:
            files.append(_file(path.relative_to(root / "research").as_posix(), path, config))
    for name in PROJECT:
        files.append(_file(f"project/{name}", root / name, config))
    for path in sorted(Path(config.docs_dir).rglob("*.ipynb")):
        place = path.relative_to(config.docs_dir).with_suffix(".md").as_posix()
        files.append(File.generated(config, place, content=_notebook_page(path)))
    return files


def on_pre_page(page: Page, config: MkDocsConfig, files: Files) -> Page:
    """Link a page to its source in the repository, where it can be edited."""
    source = _in_repository(page.file.src_uri)
    notebook = re.sub(r"\.md$", ".ipynb", source)
    if (_root(config) / notebook).exists():
        source = notebook
    page.edit_url = f"{config.repo_url}/edit/main/{source}" if config.repo_url else None
    return page


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Point links, which lead somewhere in the repository, to places of the site."""
    here = page.file.src_uri
    source = posixpath.dirname(_in_repository(here))

    def moved(link: re.Match[str]) -> str:
        place = _on_site(posixpath.normpath(posixpath.join(source, link[2])))
        if place is None:
            return link[0]
        if not place.startswith(posixpath.splitext(here)[0]):  # the page of a notebook leads to the notebook itself
            place = re.sub(r"\.ipynb$", ".md", place)
        return link[1] + posixpath.relpath(place, posixpath.dirname(here))

    return LINK.sub(moved, markdown)


def _root(config: MkDocsConfig) -> Path:
    return Path(config.docs_dir).parent


def _file(place: str, path: Path, config: MkDocsConfig) -> File:
    return File.generated(config, place, abs_src_path=str(path))


def _notebook_page(path: Path) -> str:
    """Return the page of a notebook: its texts and its code."""
    cells = [(cell["cell_type"], "".join(cell["source"])) for cell in json.loads(path.read_text("utf-8"))["cells"]]
    parts = [text if kind == "markdown" else f"```python\n{text}\n```" for kind, text in cells]
    parts.insert(1, f"[The notebook]({path.name}) has all of this page's code.")
    return "\n\n".join(parts) + "\n"


def _in_repository(place: str) -> str:
    """Return where a file of the site lies in the repository."""
    if place.startswith("results/"):
        return f"research/{place}"
    return place.removeprefix("project/") if place.startswith("project/") else f"docs/{place}"


def _on_site(path: str) -> str | None:
    """Return where a file of the repository lies on the site, or None."""
    if path in PROJECT:
        return f"project/{path}"
    for folder in ("docs/", "research/"):
        if path.startswith(folder):
            return path.removeprefix(folder)
    return None
