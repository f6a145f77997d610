"""The tables of incidents are complete."""

import json
from pathlib import Path

from research.pages.incidents import RECORD, RELIABILITY, SECURITY

ROOT = Path(__file__).resolve().parents[3]


def test_every_row_names_tests_that_exist_and_were_counted():
    """Each file of a row is there, has cases in the record, and the record holds no other."""
    named = {test for row in (*RELIABILITY, *SECURITY) for test in row.tests}
    assert all((ROOT / "tests" / name.partition("::")[0]).is_file() for name in named)
    cases = json.loads((ROOT / RECORD).read_text())["cases"]
    assert cases.keys() == named
    assert min(cases.values()) > 0
