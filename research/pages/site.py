"""A hook of MkDocs: the pages and pictures of research/results are part of the site, below results/."""

import posixpath
import re
from pathlib import Path
from typing import Final

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

ROOTS: Final = {"results": "research/results", "": "docs"}
"""Where the parts of the site lie in the repository."""
SHOWN: Final = {".md", ".png", ".svg", ".json"}
LINK: Final = re.compile(r"(\]\()([^)#\s:]+)(?=[)#])")


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add every page, picture and table of results."""
    folder = Path(config.docs_dir).parent / "research"
    for path in sorted((folder / "results").rglob("*")):
        if path.suffix in SHOWN:
            name = path.relative_to(folder).as_posix()
            files.append(File(name, str(folder), config.site_dir, config.use_directory_urls))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Point links between docs/ and research/results, which lead somewhere in the repository, to places of the site."""
    here = page.file.src_uri
    source = posixpath.dirname(f"research/{here}" if here.startswith("results/") else f"docs/{here}")

    def moved(link: re.Match[str]) -> str:
        target = posixpath.normpath(posixpath.join(source, link[2]))
        for place, root in ROOTS.items():
            if target.startswith(f"{root}/"):
                found = posixpath.join(place, target.removeprefix(f"{root}/"))
                return link[1] + posixpath.relpath(found, posixpath.dirname(here))
        return link[0]

    return LINK.sub(moved, markdown)
