"""`eia-sec trial`: what `train` runs first where the environment is from outside."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from threading import Event
from typing import Annotated

import tyro

from eia_sec.common.config import RunConfig
from eia_sec.deploy.local.environment_trial import REPORTED
from eia_sec.deploy.local.run_directory import RunDirectory
from eia_sec.deploy.options import base_configuration, parse
from eia_sec.rollout.envs.registry import environment_spec
from eia_sec.rollout.worker.outages import Outages


@dataclass(frozen=True)
class TrialArguments:
    """Try the environment of a run for a few steps, and store its team in the run's directory."""

    run_dir: Path
    """The run's directory."""
    config: Path | None = None
    """TOML file with the run's configuration."""
    settings: Annotated[RunConfig, tyro.conf.arg(name="")] = field(default_factory=RunConfig)


def command(arguments: Sequence[str]) -> int:
    """Try it; return 0."""
    defaults = TrialArguments(Path(), settings=base_configuration(arguments))
    options = parse(TrialArguments, arguments, "trial", defaults)
    try:
        spec = environment_spec(options.settings, trial=True, patience=Outages(Event()))
        RunDirectory(options.run_dir).adopt(options.settings, spec.team)
    finally:
        # Without this file, the process was ended by what nobody here was told of.
        (options.run_dir / REPORTED).touch()
    return 0
