"""Generated blocks and pictures are up to date, and pages of prose are Markdown files, not Python strings."""

import ast
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread

from eia_sec.common.config import ALGORITHM_CONFIGS, RunConfig
from eia_sec.common.config.files import flatten, format_value
from research.pages.blocks import marks, names, replaced, wrapped
from research.pages.configuration_tables import SHOWN, configuration_tables, field_docs
from research.pages.pages import PAGES, PICTURES, main, refreshed

ROOT = Path(__file__).resolve().parents[3]
SOURCES = sorted(
    path.relative_to(ROOT).as_posix()
    for folder in ("common", "rollout", "learner", "elite", "deploy", "research")
    for path in (ROOT / folder).rglob("*.py")
)
README_WORDS = 900
PROSE_CHARACTERS = 600


@pytest.mark.parametrize("page", PAGES)
def test_generated_blocks_are_up_to_date(page):
    """Every block is what `make docs` would write, and every mark on a page belongs to a block."""
    text = (ROOT / page).read_text(encoding="utf-8")
    assert refreshed(page, ROOT) == text, "run `make docs`"
    assert sorted(names(text)) == sorted(PAGES[page])


def test_every_page_with_marks_is_refreshed():
    """No page holds a generated block that nothing refreshes."""
    marked = {
        path.relative_to(ROOT).as_posix()
        for path in [ROOT / "README.md", *(ROOT / "docs").rglob("*.md"), *(ROOT / "research" / "results").rglob("*.md")]
        if names(path.read_text(encoding="utf-8"))
    }
    assert marked == set(PAGES)


def test_a_block_replaces_only_itself():
    """What stands before and after the marks stays, and an old block does not."""
    begin, end = marks("x")
    assert replaced(f"before\n{begin}\nold\n{end}\nafter", "x", "new\n") == f"before\n{begin}\nnew\n{end}\nafter"


@pytest.mark.parametrize("text", ["no marks", "{end} {begin}", "{begin} {begin} {end}", "{begin}"])
def test_a_page_without_its_marks_is_refused(text):
    """A missing, repeated or swapped mark is an error, so that no block is dropped or written over prose."""
    begin, end = marks("x")
    with pytest.raises(ValueError, match="has no block x"):
        replaced(text.format(begin=begin, end=end), "x", "new")


def test_paragraphs_are_wrapped():
    """A paragraph has lines of at most 118 characters, however it was written."""
    text = wrapped("word\n   word " * 40)
    assert max(map(len, text.splitlines())) <= 118
    assert text.split() == ["word"] * 80


def pages_in_strings(source):
    """Return the string literals that hold a page: long, with Markdown headings, and no docstring."""
    tree = ast.parse(source)
    documented = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
    docstrings = {
        id(node.body[0].value) for node in ast.walk(tree) if isinstance(node, documented) and is_text(node.body)
    }
    found = []
    for node in ast.walk(tree):
        if isinstance(node, ast.JoinedStr):
            text = "".join(str(part.value) for part in node.values if isinstance(part, ast.Constant))
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in docstrings:
            text = node.value
        else:
            continue
        if len(text) > PROSE_CHARACTERS and re.search(r"^#{2,4} \w", text, re.MULTILINE):
            found.append(text)
    return found


def is_text(body):
    return bool(body) and isinstance(body[0], ast.Expr) and isinstance(body[0].value, ast.Constant)


@pytest.mark.parametrize("name", SOURCES)
def test_no_page_is_written_in_python(name):
    """Prose lives in Markdown files; Python makes tables and blocks only."""
    assert pages_in_strings((ROOT / name).read_text(encoding="utf-8")) == []


def test_a_page_in_python_would_be_found():
    """A long string with a heading is found, plain or formatted; a docstring and a long string without one are not."""
    page = "## Title\\n\\n" + "word " * 200
    assert pages_in_strings(f'TEXT = "{page}"')
    assert pages_in_strings(f'TEXT = f"{page}{{name}}"')
    assert not pages_in_strings(f'"""{page}"""\n')
    assert not pages_in_strings(f'TEXT = "{"word " * 200}"')


def test_the_readme_is_read_in_a_minute():
    """It has at most 900 words, and no commit on it."""
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    assert len(text.split()) <= README_WORDS
    assert not re.search(r"-dirty|\bcommits? [0-9a-f]{7}", text)


def test_configuration_page_has_every_key_with_its_presets():
    """Every key has one row in its section, with its value in each preset and its docstring."""
    rows: dict[str, list[str]] = {}
    section = ""
    for line in configuration_tables().splitlines():
        if line.startswith("## "):
            section = line[4:-1].strip("[]") + "." if "`[" in line else ""
        elif line.startswith("| `"):
            cells = [cell.strip() for cell in line.strip("|").split(" | ")]
            rows.setdefault(section + cells[0].strip("`"), cells)
    others = [flatten(RunConfig(algorithm=kind())) for kind in ALGORITHM_CONFIGS.values()]
    assert set(rows) == {key for config in others for key in config}
    presets = [flatten(config) for config in SHOWN.values()]
    named = {key for config in presets for key in config}
    for key in named:
        cells, values = rows[key], [config[key] for config in presets if key in config]
        texts = [value if isinstance(value, str) else format_value(value) for value in values]
        assert cells[2:-1] == [
            text if value == values[0] else f"**{text}**" for text, value in zip(texts, values, strict=True)
        ]
        assert cells[-1].endswith((".", ")"))
    for key in rows.keys() - named:
        assert rows[key][2] == next(str(config[key]) for config in others if key in config)
        assert rows[key][3].endswith((".", ")"))


def test_field_docs_joins_lines_and_skips_methods():
    """A field's docstring comes back on one line, and a method's is not taken for one."""

    class Section:
        """The section."""

        first: int = 1
        """Spread over
        two lines."""
        second: int = 2

        def method(self) -> None:
            """Do nothing."""

    assert field_docs(Section) == {"first": "Spread over two lines."}


def test_main_refreshes_every_page_and_picture(tmp_path):
    """Run on a copy with emptied blocks, the command restores the pages; pictures equal the committed ones."""
    shutil.copytree(ROOT / "docs", tmp_path / "docs")
    shutil.copytree(
        ROOT / "research" / "results", tmp_path / "research" / "results", ignore=shutil.ignore_patterns("*.xz")
    )
    shutil.copy(ROOT / "README.md", tmp_path)
    for page in PAGES:
        text = (tmp_path / page).read_text(encoding="utf-8")
        for name in PAGES[page]:
            text = replaced(text, name, "old")
        (tmp_path / page).write_text(text, encoding="utf-8")
    for name in PICTURES:
        (tmp_path / name).unlink()
    main([str(tmp_path)])
    for page in PAGES:
        assert (tmp_path / page).read_text(encoding="utf-8") == (ROOT / page).read_text(encoding="utf-8")
    for name in PICTURES:
        drawn, kept = imread(tmp_path / name), imread(ROOT / name)
        assert drawn.shape == kept.shape, "run `make docs`"
        # Fonts differ a little from machine to machine; one farm in another place would change more than this.
        assert np.abs(drawn - kept).mean() < 0.002, "run `make docs`"


@pytest.mark.parametrize(("arguments", "code"), [(["--help"], 0), (["--wrong"], 2), (["nowhere"], 2)])
def test_the_generator_makes_no_folder_of_an_argument_that_is_no_repository(tmp_path, monkeypatch, arguments, code):
    """Help is printed, and other words are refused, before anything is written."""
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as stop:
        main(arguments)
    assert stop.value.code == code
    assert not list(tmp_path.iterdir())
