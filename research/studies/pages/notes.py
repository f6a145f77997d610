"""The notes of notes.md, filled in and wrapped for a page."""

import functools
import re
import textwrap
from pathlib import Path
from typing import Any, Final

TEMPLATE: Final = Path(__file__).with_suffix(".md")
WIDTH: Final = 118
"""Characters of a line of prose."""


def note(name: str, **values: Any) -> str:
    """Return a note as a paragraph; raise KeyError when there is none of that name, or a value is missing."""
    return filled(_sections()[name].format(**values))


def filled(text: str) -> str:
    """Return a text as one paragraph of lines of WIDTH."""
    return textwrap.fill(text, WIDTH, break_on_hyphens=False, break_long_words=False) + "\n"


@functools.cache
def _sections() -> dict[str, str]:
    parts = re.split(r"^## (\w+)\n", TEMPLATE.read_text(encoding="utf-8"), flags=re.MULTILINE)[1:]
    return {name: " ".join(text.split()) for name, text in zip(parts[::2], parts[1::2], strict=True)}
