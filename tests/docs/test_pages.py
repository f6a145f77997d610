"""The generated documentation equals what the dataclasses and the presets say, and what the farms are."""

from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread

from common.config import RunConfig
from common.config.files import flatten, format_value
from common.config.presets import PRESETS
from docs.tools.pages import PAGES, PICTURES, configuration_page, field_docs, main

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize("name", PAGES)
def test_generated_page_is_up_to_date(name):
    """The page in docs/ is what `make docs` would write."""
    assert (ROOT / "docs" / name).read_text() == PAGES[name](), "run `make docs`"


def test_configuration_page_has_every_key_with_its_presets():
    """Every key has one row in its section, with its value in each preset and its docstring."""
    rows: dict[str, list[str]] = {}
    section = ""
    for line in configuration_page().splitlines():
        if line.startswith("## "):
            section = line[4:-1].strip("[]") + "." if "`[" in line else ""
        elif line.startswith("| `"):
            cells = [cell.strip() for cell in line.strip("|").split(" | ")]
            rows[section + cells[0].strip("`")] = cells
    assert set(rows) == set(flatten(RunConfig()))
    for key, cells in rows.items():
        shown = [cell.strip("*") for cell in cells[2 : 2 + len(PRESETS)]]
        values = [flatten(config)[key] for config in PRESETS.values()]
        assert shown == [value if isinstance(value, str) else format_value(value) for value in values]
        assert cells[2 + len(PRESETS)].endswith((".", ")"))


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


def test_main_writes_every_page_and_picture(tmp_path):
    """The command writes everything into the folder that it is given, which it makes; pictures are those in docs/."""
    main([str(tmp_path / "pages")])
    written = {path.relative_to(tmp_path / "pages").as_posix() for path in (tmp_path / "pages").rglob("*.*")}
    assert written == {*PAGES, *PICTURES}
    for name, page in PAGES.items():
        assert (tmp_path / "pages" / name).read_text() == page()
    for name in PICTURES:
        drawn, kept = imread(tmp_path / "pages" / name), imread(ROOT / "docs" / name)
        assert drawn.shape == kept.shape, "run `make docs`"
        # Fonts differ a little from machine to machine; one farm in another place would change more than this.
        assert np.abs(drawn - kept).mean() < 0.002, "run `make docs`"
