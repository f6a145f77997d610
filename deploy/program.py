"""How a user calls this program."""

import shutil
import sys
from pathlib import Path
from typing import Final

NAME: Final = "eia-sec"


def program() -> str:
    """Return the word with which a user calls it: its path where no folder of PATH has it, as after `make train`."""
    called = sys.argv[0]
    return called if Path(called).name == NAME and shutil.which(NAME) is None else NAME
