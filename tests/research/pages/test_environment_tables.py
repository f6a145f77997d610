"""The page on the environment: its tables are those of the code, its code runs, and its picture is what it says."""

import re
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[3]
PAGE = "docs/reference/environment.md"


def code_blocks(document):
    return re.findall(r"^```python\n(.*?)^```", (ROOT / document).read_text(encoding="utf-8"), re.M | re.S)


@pytest.mark.parametrize(("document", "number"), [(PAGE, 5), ("README.md", 1)])
def test_the_code_of_a_page_runs(document, number):
    """All blocks of a page run one after another, and leave a finished environment or frames behind."""
    blocks, names = code_blocks(document), {}
    assert len(blocks) == number
    for block in blocks:
        exec(compile(block, str(document), "exec"), names)  # the page's own code is what this test is about
    assert names["observations"]
    if document == PAGE:
        assert len(names["frames"]) == 5
        assert not np.array_equal(names["frames"][0], names["frames"][-1])
