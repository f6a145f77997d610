"""One training of a benchmark: an algorithm, an environment and a seed, as a file holds it for its process."""

import hashlib
import json
import re
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Final

from eia_sec.common.config import RunConfig
from eia_sec.common.config.checks import within
from eia_sec.common.config.files import digest, read_saved, to_toml
from eia_sec.common.errors import UsageError
from eia_sec.common.regular_files import read_regular_text

FORMAT: Final = 1
"""Raised when what a record means changes; older ones are then made anew."""
RANDOM: Final = "random"
"""Algorithm of the reference, which draws actions at random and learns nothing."""
FINAL_TIMES: Final = 10
"""At a training's end, so many times the scenarios of a point (Gorsane et al. 2022)."""
MOST_SCENARIOS: Final = 1000


@dataclass(frozen=True)
class Measuring:
    """When and on how many scenarios policies are evaluated.

    Attributes:
        points: evaluations along a training, at equal shares of its steps.
        scenarios: scenarios of each; FINAL_TIMES as many others at the end.
    """

    points: int
    scenarios: int

    def __post_init__(self) -> None:
        """Refuse impossible numbers."""
        within(1, 1000, points=self.points)
        within(1, MOST_SCENARIOS, scenarios=self.scenarios)

    def along(self, config: RunConfig) -> range:
        """Return the seeds of the scenarios along a training; it never sees them."""
        return config.unseen(self.scenarios)

    def final(self, config: RunConfig) -> range:
        """Return those at its end, which are others."""
        first = self.along(config).stop
        return range(first, first + FINAL_TIMES * self.scenarios)


@dataclass(frozen=True)
class Training:
    """One training, or the reference of an environment.

    Attributes:
        algorithm: the algorithm's name, or RANDOM.
        config: the run.
        measuring: how it is evaluated.
    """

    algorithm: str
    config: RunConfig
    measuring: Measuring

    @property
    def label(self) -> str:
        """What people call it."""
        seed = "" if self.algorithm == RANDOM else f", seed {self.config.seed}"
        return f"{self.algorithm} on {self.config.env.name}{seed}"

    @property
    def digest(self) -> str:
        """Eight hexadecimal digits of everything that decides its outcome."""
        parts = [FORMAT, self.algorithm, digest(self.config), asdict(self.measuring)]
        return hashlib.sha256(json.dumps(parts).encode()).hexdigest()[:8]

    @property
    def name(self) -> str:
        """Name of its files: what it is in words, and the digest."""
        words = f"{self.algorithm}-{self.config.env.name}-{self.config.seed}"
        return f"{re.sub('[^A-Za-z0-9_]+', '-', words)[:100]}-{self.digest}"

    def to_json(self) -> str:
        """Return the training as a file holds it."""
        whole = {"algorithm": self.algorithm, "config": to_toml(self.config), **asdict(self.measuring)}
        return json.dumps(whole, indent=1) + "\n"

    @classmethod
    def from_file(cls, path: Path) -> "Training":
        """Read a training; raise UsageError when the file holds none."""
        try:
            data = json.loads(read_regular_text(path))
            measuring = Measuring(data["points"], data["scenarios"])
            return cls(str(data["algorithm"]), read_saved(str(data["config"])), measuring)
        except (OSError, ValueError, LookupError, TypeError, RecursionError) as error:
            raise UsageError(f"{path} is not a training of a benchmark: {error}.") from None
