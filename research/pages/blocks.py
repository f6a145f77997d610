"""Generated blocks of Markdown pages.

A page is written by hand, except for what stands between two marks:

    <!-- generated:NAME begin -->
    <!-- generated:NAME end -->
"""

import json
import re
import textwrap
from collections.abc import Callable
from pathlib import Path
from typing import Any

Block = Callable[[Path], str]
"""Makes a block from the files of a repository, given its root."""
_BEGIN = re.compile(r"<!-- generated:([\w-]+) begin -->")


def marks(name: str) -> tuple[str, str]:
    """Return the marks around a block."""
    return f"<!-- generated:{name} begin -->", f"<!-- generated:{name} end -->"


def names(text: str) -> list[str]:
    """Return the names of a page's blocks, in order."""
    return _BEGIN.findall(text)


def replaced(text: str, name: str, body: str) -> str:
    """Return a page with one block replaced.

    Raises:
        ValueError: the page does not hold both marks once, in order.
    """
    begin, end = marks(name)
    if text.count(begin) != 1 or text.count(end) != 1 or text.index(begin) > text.index(end):
        raise ValueError(f"the page has no block {name}: it needs {begin} and {end} once each.")
    head, _, rest = text.partition(begin)
    _, _, tail = rest.partition(end)
    return f"{head}{begin}\n{body.strip()}\n{end}{tail}"


def table(head: list[str], rows: list[list[str]]) -> str:
    """Return a Markdown table."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines)


def wrapped(text: str) -> str:
    """Return a paragraph in lines of at most 118 characters."""
    return textwrap.fill(" ".join(text.split()), 118, break_long_words=False, break_on_hyphens=False)


def read_json(path: Path) -> Any:
    """Return what a JSON file holds, or None where there is no file."""
    return json.loads(path.read_text(encoding="utf-8")) if path.is_file() else None
