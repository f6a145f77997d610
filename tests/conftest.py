"""What holds for all tests."""

from pathlib import Path

import pytest

TESTS = Path(__file__).parent
WITH_PROCESSES = tuple(TESTS / folder for folder in ("faults", "security", "system", "watching"))
"""Tests that start several processes and wait for what they do to one another."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Give tests with processes a second try on a machine that is busy; pytest's summary counts it as a rerun."""
    for item in items:
        if any(folder in item.path.parents for folder in WITH_PROCESSES):
            item.add_marker(pytest.mark.flaky(reruns=1))
