"""`eia-sec trial`: what `train` runs first where the environment is from outside."""

import os
import signal
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from shutil import rmtree
from threading import Event, Thread
from typing import Annotated

import tyro

from eia_sec.common.config import RunConfig
from eia_sec.common.process import ORPHAN_SECONDS
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
    Thread(target=_end_with_parent, args=(options.run_dir,), daemon=True).start()
    try:
        spec = environment_spec(options.settings, trial=True, patience=Outages(Event()))
        RunDirectory(options.run_dir).adopt(options.settings, spec.team)
    finally:
        # Without this file, the process was ended by what nobody here was told of.
        (options.run_dir / REPORTED).touch()
    return 0


def _end_with_parent(run_dir: Path) -> None:
    """End this process, and what the environment has started, when whoever wanted the trial is gone."""
    parent = os.getppid()
    while os.getppid() == parent:
        time.sleep(ORPHAN_SECONDS)
    rmtree(run_dir, ignore_errors=True)
    os.killpg(0, signal.SIGKILL)
