"""The long doses of the property tests: many random farms, and errors made on purpose that they must notice."""

import secrets
import subprocess
import sys
from pathlib import Path

import pytest

from tests.rollout.sim.properties.mutations import (
    MUTATIONS,
    PROPERTIES,
    ROOT,
    apply,
    copy_sources,
    environment_of,
    noticed,
    run_properties,
)


@pytest.mark.parametrize("mutation", MUTATIONS, ids=lambda mutation: mutation.name)
def test_every_error_can_still_be_made(mutation, tmp_path):
    """The line that each error changes is where the list says."""
    copy_sources(tmp_path)
    apply(mutation, tmp_path)
    changed = [
        (tmp_path / "rollout" / file).read_text() != (ROOT / "rollout" / file).read_text()
        for file, *_ in mutation.edits
    ]
    assert all(changed)


def test_the_copy_is_what_is_tested(tmp_path):
    """Property tests of a copy import the copy's simulator, not the one that is installed."""
    copy_sources(tmp_path)
    command = [sys.executable, "-c", "import eia_sec.rollout.sim.batch as batch; print(batch.__file__)"]
    found = subprocess.run(
        command, cwd=tmp_path, env=environment_of(tmp_path), capture_output=True, text=True, check=True
    )
    assert Path(found.stdout.strip()).resolve() == tmp_path / "rollout" / "sim" / "batch.py"


@pytest.mark.slow
def test_a_copy_has_all_that_its_tests_import(tmp_path):
    """Every property test of a copy is collected; one that is not would fail whatever the error."""
    copy_sources(tmp_path)
    code, _, said = run_properties(tmp_path, "plain", "--collect-only")
    assert code == 0, said


def test_every_property_file_is_run():
    """The list of files names all that there are."""
    assert sorted(PROPERTIES) == sorted(path.name for path in Path(__file__).parent.glob("test_properties_*.py"))


@pytest.mark.nightly
@pytest.mark.timeout(7200)
def test_properties_hold_on_many_random_farms():
    """24 times the default examples, other ones every night; the seed is printed to repeat them."""
    seed = secrets.randbelow(2**32)
    repeat = f"EIA_SEC_PROPERTIES=many python -m pytest tests/rollout/sim/properties --hypothesis-seed={seed}"
    print(repeat)  # noqa: T201 - the seed belongs into the night's log
    code, failed, said = run_properties(ROOT, "many", f"--hypothesis-seed={seed}")
    assert (code, failed) == (0, []), f"{repeat}\n{said}"


@pytest.mark.nightly
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("mutation", [None, *MUTATIONS], ids=lambda mutation: mutation.name if mutation else "no error")
def test_errors_are_noticed(mutation, tmp_path):
    """The property tests pass on a plain copy of the sources and fail on every copy with an error in it."""
    assert bool(noticed(mutation, tmp_path)) == (mutation is not None)
