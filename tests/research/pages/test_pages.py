"""Generated blocks and pictures are up to date."""

from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread

from eia_sec.common.config.files import read_saved
from eia_sec.common.config.presets import PRESETS
from research.pages.blocks import names
from research.pages.pages import FILES, PAGES, refreshed

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


@pytest.mark.parametrize("name", ["instant", "eia-sec"])
def test_a_kept_run_is_that_of_its_preset(name):
    """What the pages call the result of a preset was made with exactly its settings."""
    assert read_saved(ROOT / "research" / "results" / name / "config.toml") == PRESETS[name]
