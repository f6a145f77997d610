"""`eia-sec` under watch: `python -m tests.security.audited COMMAND ...` logs whatever is unpickled or unmarshalled.

An audit hook sees every class that a pickle asks for, and every marshalled object outside Python's own import of
compiled modules; a finder sees the import of modules that pickle on somebody's behalf. A pickle of plain numbers asks
for no class, so the functions that load one are watched as well, before anything else is imported.

Numba's own cache of compiled code, in __pycache__ on this machine's disk, is pickled by numba; it is not counted.
"""

import importlib
import sys
from collections.abc import Callable
from importlib.machinery import PathFinder
from typing import Any, Final

NUMBAS_OWN: Final = ("numba/core/caching.py", "numba/core/serialize.py")
IMPORTS: Final = "<frozen importlib._bootstrap_external>"
KIN: Final = ("shelve", "dill", "cloudpickle", "joblib")
PICKLES: Final = ("pick" + "le", "_pick" + "le")


def callers() -> list[str]:
    """Return the files of the frames behind the hook, the innermost first."""
    frame = sys._getframe(2)
    files = []
    while frame is not None:
        files.append(frame.f_code.co_filename)
        frame = frame.f_back
    return files


def log_event(what: str, arguments: object, files: list[str]) -> None:
    """Write the line that the tests look for."""
    if not any(name.endswith(NUMBAS_OWN) for name in files):
        sys.stderr.write(f"UNPICKLED {what} {str(arguments)[:200]} at {files[0]}\n")


def hook(event: str, arguments: tuple[object, ...]) -> None:
    """Write a line when something is about to be built from bytes."""
    if event == "pickle.find_class":
        log_event(event, arguments, callers())
    elif event in ("marshal.loads", "marshal.load") and (files := callers())[0] != IMPORTS:
        log_event(event, "", files)


class Importing:
    """Stands before all finders and sees every module that is looked for; `importlib` raises no audit event."""

    def find_spec(self, name: str, path: object = None, target: object = None) -> None:
        """Write a line for a module that pickles on somebody's behalf, and leave finding it to the others.

        Looking whether one is installed, as torch does, is no import of one that is not.
        """
        if name in KIN and PathFinder.find_spec(name) is not None:
            log_event("import", name, callers())


def watched(name: str, load: Callable[..., Any]) -> Callable[..., Any]:
    """Return a loading function that says that it was called."""

    def loading(*arguments: Any, **named: Any) -> Any:
        log_event(name, "", callers())
        return load(*arguments, **named)

    return loading


sys.addaudithook(hook)
sys.meta_path.insert(0, Importing())
for module in map(importlib.import_module, PICKLES):
    for function in ("load", "loads"):
        setattr(module, function, watched(f"{module.__name__}.{function}", getattr(module, function)))

if __name__ == "__main__":
    from eia_sec.deploy.cli import main

    main()
