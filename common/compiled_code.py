"""Where Numba keeps machine code: beside the package or in the user's cache, or else in a temporary folder."""

import os
import stat
import tempfile
from pathlib import Path

import numba

from eia_sec.common.log import log


def require_cache() -> None:
    """Choose a temporary folder for machine code if Numba finds no place that it may write to.

    Without one Numba refuses to compile, for instance from a read-only package where there is no home directory. The
    folder is this user's, because machine code from somebody else's could do anything. Other processes that begin later
    find it again.
    """
    try:
        numba.njit(cache=True)(_nothing)
    except RuntimeError:
        folder = _temporary_folder()
        os.environ["NUMBA_CACHE_DIR"] = str(folder)
        numba.config.CACHE_DIR = str(folder)  # type: ignore[attr-defined]  # numba makes its attributes when it is imported
        log(
            f"compiled code is kept in {folder}: neither the package's folder nor a home directory can be written to. "
            "NUMBA_CACHE_DIR names another folder."
        )


def _nothing() -> None:
    pass


def _temporary_folder() -> Path:
    folder = Path(tempfile.gettempdir()) / f"eia-sec-numba-{os.getuid()}"
    try:
        folder.mkdir(mode=0o700)
    except FileExistsError:
        found = folder.lstat()
        if not stat.S_ISDIR(found.st_mode) or found.st_uid != os.getuid() or found.st_mode & 0o077:
            return Path(tempfile.mkdtemp(prefix="eia-sec-numba-"))
    return folder
