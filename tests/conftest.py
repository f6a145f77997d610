"""What holds for all tests."""

import os
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import settings

from eia_sec.common import plugins
from eia_sec.common.config import ALGORITHM_CONFIGS
from eia_sec.common.config.algorithms.network import NETWORK_CONFIGS
from eia_sec.common.config.plugin_names import LOADED

TESTS = Path(__file__).parent
WITH_PROCESSES = tuple(
    TESTS / folder for folder in ("faults", "security", "system", "deploy/hosts", "deploy/monitor/web")
)
"""Tests that start several processes and wait for what they do to one another. They are slow."""
SLOW = (*WITH_PROCESSES, TESTS / "rollout/sim/properties")
QUICK = {TESTS / "system/test_first_run.py", TESTS / "system/test_lockstep.py"}
"""What `make test` runs of them: one short training, and one in lockstep beside a run in one process."""
RESEARCH = TESTS / "research"

for variable in ("OMP_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ.setdefault(variable, "1")  # as `make test` has it: commands give themselves one, which numba wants early

OUT_OF_TIME = ["did not happen within", "nobody answers at"]
"""What a test says whose processes were too slow. Only that is tried again: a broken promise never is."""

settings.register_profile("patient", deadline=None)
settings.load_profile("patient")  # how long an example takes says nothing on a machine that does other work too


@pytest.hookimpl(tryfirst=True)  # before -m selects
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark slow tests and those of research/ by their folders.

    Tests whose processes ran out of time get a second try, which pytest's summary counts as a rerun.
    """
    for item in items:
        folders = item.path.parents
        if RESEARCH in folders:
            item.add_marker(pytest.mark.research)
        if item.path not in QUICK and any(folder in folders for folder in SLOW):
            item.add_marker(pytest.mark.slow)
        if any(folder in folders for folder in WITH_PROCESSES):
            item.add_marker(pytest.mark.flaky(reruns=1, only_rerun=OUT_OF_TIME))


@pytest.fixture
def nothing_stays_loaded() -> Iterator[None]:
    """Forget the plug-ins that a test has loaded."""
    before = dict(ALGORITHM_CONFIGS), dict(NETWORK_CONFIGS)
    yield
    plugins._PLUGINS.clear()
    LOADED.clear()
    for known, own in zip((ALGORITHM_CONFIGS, NETWORK_CONFIGS), before, strict=True):
        known.clear()
        known.update(own)


def pytest_make_parametrize_id(val: object, argname: str) -> str | None:
    """Call a parameter of bytes by its name, pytest numbers them.

    Compressed bytes hold the second at which they were made: a test that is called by them has another name in
    each of the processes that run the tests, which then refuse to begin.
    """
    return argname if isinstance(val, bytes) else None


@pytest.fixture(autouse=True, scope="session")
def no_runs_of_others(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Let monitors find no run of whoever works at this machine, nor those of other tests that run at the same time."""
    os.environ["XDG_STATE_HOME"] = str(tmp_path_factory.mktemp("state"))
