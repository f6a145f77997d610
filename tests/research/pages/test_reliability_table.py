"""The table of faults is complete."""

from pathlib import Path

from research.pages.reliability_table import FOLDER, ROWS

ROOT = Path(__file__).resolve().parents[3]


def test_every_row_names_a_test_and_every_file_of_numbers_has_a_row():
    """Each line of the table names a test file that exists, and no file of numbers is left out."""
    assert all((ROOT / "tests" / "faults" / row.test).is_file() for row in ROWS)
    assert {path.stem for path in (ROOT / FOLDER).glob("*.json")} <= {row.source for row in ROWS}
