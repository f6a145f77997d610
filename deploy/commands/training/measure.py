"""`eia-sec measure`: one run of a benchmark, trained and evaluated in this process."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from eia_sec.deploy.benchmark.measure import measured
from eia_sec.deploy.benchmark.records import Records
from eia_sec.deploy.benchmark.trainings import Training
from eia_sec.deploy.exit_codes import DONE
from eia_sec.deploy.options import parse, require_env


@dataclass(frozen=True)
class MeasureArguments:
    """Do one run of a benchmark."""

    job: Path
    """The file that says which; the record is written beside it."""
    env: str | None = None
    """Environment other than the farm, module:name; it must be that of the run, because loading it runs its code."""


def command(arguments: Sequence[str]) -> int:
    """Train, evaluate and write the record; return 0."""
    options = parse(MeasureArguments, arguments, "measure")
    training = Training.from_file(options.job)
    require_env(training.config, options.env)
    measured(training, Records(options.job.parent))
    return DONE
