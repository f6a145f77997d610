"""Fixtures of the tests with real processes."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.system.fleet import Processes


@pytest.fixture
def processes(tmp_path: Path) -> Iterator[Processes]:
    """Real processes that are gone when the test is over."""
    fleet = Processes(tmp_path)
    yield fleet
    fleet.close()
