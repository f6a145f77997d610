"""Generated blocks and pictures are up to date."""

from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread

from eia_sec.common.config.files import read_saved
from eia_sec.common.config.presets import PRESETS
from research.pages.blocks import marks, names, replaced
from research.pages.pages import FILES, PAGES, main, refreshed

ROOT = Path(__file__).resolve().parents[3]


def test_generated_blocks_are_up_to_date():
    """Every block is what `make docs` would write, and every mark on a page belongs to a block."""
    texts = {page: (ROOT / page).read_text(encoding="utf-8") for page in PAGES}
    assert [page for page, text in texts.items() if refreshed(page, ROOT) != text] == [], "run `make docs`"
    assert [page for page, text in texts.items() if sorted(names(text)) != sorted(PAGES[page])] == []


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


def test_pictures_are_up_to_date(tmp_path):
    """Every picture that follows from the code equals the committed one."""
    for name, draw in FILES.items():
        if not name.endswith(".png"):
            continue
        draw(tmp_path / "drawn.png")
        drawn, kept = imread(tmp_path / "drawn.png"), imread(ROOT / name)
        assert drawn.shape == kept.shape, "run `make docs`"
        # Fonts differ a little from machine to machine; one farm in another place would change more than this.
        assert np.abs(drawn - kept).mean() < 0.002, "run `make docs`"


def test_the_generator_refuses_a_folder_that_is_no_repository(tmp_path, monkeypatch):
    """Nothing is written there."""
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as stop:
        main(["nowhere"])
    assert stop.value.code == 2
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["default", "eia-sec"])
def test_a_kept_run_is_that_of_its_preset(name):
    """What the pages call the result of a preset was made with exactly its settings."""
    assert read_saved(ROOT / "research" / "results" / name / "config.toml") == PRESETS[name]
