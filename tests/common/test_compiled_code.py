"""Compiled code finds a place to be kept in, whoever runs it from wherever."""

import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
from numba.core.caching import NullCache

from eia_sec.common.compiled_code import COMPILING, _Announcement

SCRIPT = """
import numba.core.caching as caching

def refuse(self):
    raise PermissionError(13, "read-only")

for locator in (caching.InTreeCacheLocator, caching.UserWideCacheLocator):
    locator.ensure_cache_path = refuse

import numba
from eia_sec.rollout.sim.core.compile import compiled_entry
print(numba.config.CACHE_DIR)
"""


def kept_in(folder: Path) -> tuple[Path, str]:
    """Return where code is kept without a home directory or a writable package, and what the log says."""
    environment = {name: value for name, value in os.environ.items() if name != "NUMBA_CACHE_DIR"}
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT],
        env=environment | {"TMPDIR": str(folder)},
        capture_output=True,
        text=True,
        check=True,
        timeout=120,
    )
    return Path(done.stdout.strip()), done.stderr


@pytest.mark.slow
def test_code_is_kept_in_a_folder_of_this_user(tmp_path: Path) -> None:
    """The next process finds the same folder; nobody else may enter it, and the log says where it is."""
    folder, said = kept_in(tmp_path)
    assert folder == tmp_path / f"eia-sec-numba-{os.getuid()}"
    assert folder.stat().st_mode & 0o077 == 0
    assert str(folder) in said
    assert kept_in(tmp_path)[0] == folder


@pytest.mark.parametrize("trap", ["open", "link"])
def test_somebody_elses_folder_is_not_used(trap: str, tmp_path: Path) -> None:
    """A folder that others can write to, or a link to one, could hold anybody's machine code."""
    place = tmp_path / f"eia-sec-numba-{os.getuid()}"
    if trap == "open":
        place.mkdir()
        place.chmod(0o777)
    else:
        place.symlink_to(tmp_path)
    assert kept_in(tmp_path)[0] not in (place, tmp_path)


def test_code_that_is_kept_is_announced_once(capsys: pytest.CaptureFixture[str]) -> None:
    """Whoever waits for it reads so; functions whose code is not kept are compiled at each start, and take no time."""
    announcement = _Announcement()
    for cache in (NullCache(), object(), object()):
        announcement.on_start(SimpleNamespace(data={"dispatcher": SimpleNamespace(_cache=cache)}))
        if isinstance(cache, NullCache):
            assert capsys.readouterr().err == ""
    assert capsys.readouterr().err.count(COMPILING) == 1
