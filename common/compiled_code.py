"""Where Numba keeps machine code: beside the package or in the user's cache, or else in a temporary folder.

Whoever has to wait because there is none yet reads so in the log.
"""

import os
import stat
import tempfile
from pathlib import Path
from typing import Any, Final

import numba
from numba.core import event
from numba.core.caching import NullCache

from eia_sec.common.log import log

COMPILING: Final = "compiling the simulator, once after an installation or a change of it: up to some minutes."


class _Announcement(event.Listener):
    """Logs, once in a process, that code is compiled which is kept on disk; the rest takes no time."""

    said = False

    def on_start(self, event: Any) -> None:
        """Numba compiles a function."""
        if not self.said and not isinstance(event.data["dispatcher"]._cache, NullCache):
            self.said = True
            log(COMPILING)

    def on_end(self, event: Any) -> None:
        """Numba has compiled a function."""


_ANNOUNCEMENT: Final = _Announcement()
event.register("numba:compile", _ANNOUNCEMENT)  # type: ignore[no-untyped-call]  # numba has few types


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
