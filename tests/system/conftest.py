"""Fixtures of the tests with real processes."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.system.fleet import TINY, Processes
from tests.system.training import Training


@pytest.fixture
def processes(tmp_path: Path) -> Iterator[Processes]:
    """Real processes that are gone when the test is over."""
    fleet = Processes(tmp_path)
    yield fleet
    fleet.close()


@pytest.fixture
def training(tmp_path: Path) -> Iterator[Training]:
    """A training that is gone when the test is over."""
    run = Training(tmp_path, TINY)
    yield run
    if run.process is not None and run.process.poll() is None:
        for child in run.children():
            child.kill()
        run.process.kill()
        run.process.wait(10.0)
