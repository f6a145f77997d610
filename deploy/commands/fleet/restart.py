"""`eia-sec restart fleet.toml`: stop the processes of a fleet and start them again, with a new version for instance."""

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from eia_sec.common.config.checks import within
from eia_sec.common.text import printable_lines
from eia_sec.deploy.exit_codes import DONE
from eia_sec.deploy.hosts.fleet_file import read
from eia_sec.deploy.hosts.restart import restart
from eia_sec.deploy.options import parse


@dataclass(frozen=True)
class RestartArguments:
    """Stop all processes of a fleet and start them again. Workers deliver what they hold, the learner resumes."""

    file: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="FLEET")] = Path("fleet.toml")
    """The fleet file."""
    rolling: bool = False
    """One host after another, in the order of the file, each when the processes of the last one live again; the others
    train on meanwhile."""
    wait: float = 60.0
    """Seconds to wait for the workers, then for the coordinator, the learner and the routers in turn."""


def command(arguments: Sequence[str]) -> int:
    """Restart; return 0 when everything runs again."""
    options = parse(RestartArguments, arguments, "restart")
    within(0.0, 86_400.0, wait=options.wait)

    def tell(sentence: str) -> None:
        sys.stdout.write(f"{printable_lines(sentence)}\n")
        sys.stdout.flush()

    restart(read(options.file), options.wait, rolling=options.rolling, tell=tell)
    return DONE
