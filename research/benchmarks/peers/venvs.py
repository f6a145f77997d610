"""Virtual environments of the peers, made when they are missing or when their requirements have changed."""

import hashlib
import shlex
import subprocess
import sys
import venv
from pathlib import Path

from eia_sec.common.errors import EiaSecError
from research.benchmarks.peers.catalogue import OURS, Program

MARK = ".ready"
"""File in a finished environment; it holds the digest of what was installed."""


def digest(requirements: str) -> str:
    """Return what names the content of a requirements file."""
    return hashlib.sha256(requirements.encode()).hexdigest()


def interpreter(program: Program, folder: Path) -> Path:
    """Return the Python that runs a program."""
    return Path(sys.executable) if program.environment == OURS else folder / program.environment / "bin" / "python"


def ready(program: Program, folder: Path) -> bool:
    """Return whether a program's environment holds what its requirements say."""
    if program.requirements is None:
        return True
    mark = folder / program.environment / MARK
    return mark.is_file() and mark.read_text().strip() == digest(program.requirements.read_text())


def provide(program: Program, folder: Path, pip_arguments: str = "") -> None:
    """Make a program's environment unless it is ready.

    Args:
        program: the program.
        folder: where environments lie.
        pip_arguments: added to `pip install`, for instance the index of a CPU-only torch.

    Raises:
        EiaSecError: the installation failed.
    """
    if program.requirements is None or ready(program, folder):
        return
    place = folder / program.environment
    sys.stderr.write(f"Making {place}; this takes minutes, once.\n")
    venv.create(place, with_pip=True, clear=True)
    python = [str(place / "bin" / "python"), "-m", "pip", "--disable-pip-version-check", "install", "--quiet"]
    done = subprocess.run([*python, "-r", str(program.requirements), *shlex.split(pip_arguments)], check=False)
    if done.returncode:
        raise EiaSecError(f"the environment of {program.name} could not be made; pip said why above.")
    (place / MARK).write_text(digest(program.requirements.read_text()) + "\n")
