"""`eia-sec` with an audit hook: `python -m tests.security.audited COMMAND ...` logs whatever is unpickled.

Numba's own cache of compiled code, in __pycache__ on this machine's disk, is pickled by numba; it is not counted.
"""

import sys

from deploy.cli import main

NUMBAS_OWN = ("numba/core/caching.py", "numba/core/serialize.py")


def hook(event: str, arguments: tuple[object, ...]) -> None:
    """Write a line when something is about to be built from a pickle."""
    if event != "pickle.find_class":
        return
    frame = sys._getframe(1)
    files = []
    while frame is not None:
        files.append(frame.f_code.co_filename)
        frame = frame.f_back
    if not any(name.endswith(NUMBAS_OWN) for name in files):
        sys.stderr.write(f"UNPICKLED {arguments} at {files[0]}\n")


sys.addaudithook(hook)

if __name__ == "__main__":
    main()
