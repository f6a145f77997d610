"""The programs that are compared, and how each is run."""

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Final

FOLDER: Final = Path(__file__).resolve().parent
ROOT: Final = FOLDER.parents[2]
SOURCES: Final = os.pathsep.join((str(ROOT / "src"), str(ROOT)))
"""What children find `eia_sec` and `research` by: this checkout, whatever is installed."""
OURS: Final = "ours"
"""Name of the environment that the driver itself runs in."""


@dataclass(frozen=True)
class Program:
    """One script.

    Attributes:
        subject: "simulator" or "learner".
        name: what is measured.
        module: the script, run as a module from the repository's root.
        environment: a file of requirements/, whose name is also that of the virtual environment; or OURS.
        threaded: whether it can use more than one thread.
        processes: whether it is also measured with one process for each thread.
        algorithm: what it trains with, where its script has a choice.
    """

    subject: str
    name: str
    module: str
    environment: str
    threaded: bool = True
    processes: bool = False
    algorithm: str = ""

    @property
    def requirements(self) -> Path | None:
        """The pinned packages of its environment; none for ours."""
        return None if self.environment == OURS else FOLDER / "requirements" / f"{self.environment}.txt"


PROGRAMS: Final = (
    Program("simulator", "EIA-SEC", "research.benchmarks.peers.scripts.run_ours_simulator", OURS),
    Program("simulator", "VMAS", "research.benchmarks.peers.scripts.run_vmas", "vmas", processes=True),
    Program("simulator", "mpe2", "research.benchmarks.peers.scripts.run_mpe2", "mpe2", threaded=False),
    Program("learner", "EIA-SEC", "research.benchmarks.learner", OURS),
    Program("learner", "AgileRL", "research.benchmarks.peers.scripts.run_agilerl", "agilerl"),
    Program("learner", "BenchMARL", "research.benchmarks.peers.scripts.run_benchmarl", "benchmarl"),
)
"""In the order in which one repeat runs them."""
SUBJECTS: Final = ("simulator", "learner")
