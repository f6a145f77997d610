"""The README's figures are those of the committed results."""

from pathlib import Path

from deploy.results import BEGIN, END, readme

ROOT = Path(__file__).resolve().parents[2]


def test_readme_is_up_to_date() -> None:
    """The results block is what `make docs` would write."""
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    assert readme(text, ROOT / "docs" / "results") == text, "run `make docs`"


def test_block_replaces_only_itself() -> None:
    """What stands before and after the marks stays, and an old block does not."""
    text = readme(f"before\n{BEGIN}\nold\n{END}\nafter", ROOT / "docs" / "results")
    assert text.startswith(f"before\n{BEGIN}\n")
    assert text.endswith(f"{END}\nafter")
    assert "old" not in text.split(END)[0].split(BEGIN)[1].split("\n")
    assert "lawnmower" in text
