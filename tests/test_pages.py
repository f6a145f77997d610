"""The Python code on the pages and in the notebook: it runs, or stands in an example that other tests run."""

import re
from pathlib import Path

import pytest

DOCS = Path(__file__).parents[1] / "docs"
EXAMPLES = DOCS / "examples"
SMALLER = {"150_000": "2_000", "scenarios=50": "scenarios=2"}


def blocks(page):
    """Return the Python blocks of a page: those that run in order, and pieces of the examples."""
    text = (DOCS / "how-to" / page).read_text(encoding="utf-8")
    found = re.findall(r"^```python\n(.*?)^```", text, re.DOTALL | re.MULTILINE)
    pieces = [block for block in found if re.match(r"(@|class |def |plugin = )", block)]
    return [block for block in found if block not in pieces], pieces


@pytest.mark.parametrize("page", ["python.md"])
def test_the_code_of_a_page_runs(page, tmp_path, monkeypatch):
    """The blocks of a page run one after another as one program, with fewer steps."""
    monkeypatch.chdir(tmp_path)
    program = "".join(blocks(page)[0])
    for whole, small in SMALLER.items():
        program = program.replace(whole, small)
    names = {"__name__": "page"}
    exec(compile(program, page, "exec"), names)
    assert names["run"].environment_steps >= 2000


@pytest.mark.parametrize("page", ["python.md", "plugins.md", "own_environment.md"])
def test_pieces_on_a_page_are_those_of_the_examples(page):
    """A class on a page is the one in the examples, which other tests run."""
    held = "\n".join(path.read_text(encoding="utf-8") for path in EXAMPLES.rglob("*.py"))
    pieces = blocks(page)[1]
    assert pieces
    for piece in pieces:
        assert piece in held


@pytest.mark.slow
def test_the_notebook_runs():
    """Every cell, with fewer episodes; it is kept without output."""
    nbclient = pytest.importorskip("nbclient", reason="nbclient is not installed")
    nbformat = pytest.importorskip("nbformat")
    pytest.importorskip("ipykernel", reason="ipykernel is not installed")
    notebook = nbformat.read(DOCS / "tutorials" / "python.ipynb", as_version=4)
    cells = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert all(not cell.outputs for cell in cells)
    for cell in cells:
        cell.source = cell.source.replace("episodes=160", "episodes=32")
    nbclient.NotebookClient(notebook, timeout=500).execute()
    kinds = {output.output_type for cell in cells for output in cell.outputs}
    assert "error" not in kinds
    assert any("image/png" in output.get("data", {}) for cell in cells for output in cell.outputs)
