"""The trial of an environment from outside, in a process of its own: a library may end the one that it runs in."""

import os
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

from eia_sec.common.config import RunConfig
from eia_sec.common.environment import EnvironmentSpec
from eia_sec.common.errors import EnvironmentFaultError
from eia_sec.deploy.exit_codes import DONE, OUR_CODES, USAGE
from eia_sec.deploy.local.code_options import code_options
from eia_sec.deploy.local.run_directory import CONFIG, RunDirectory
from eia_sec.rollout.envs.registry import spec_of_team

REPORTED: Final = "reported"
"""File that the trial leaves in the directory when it ends by itself, with a result or with a sentence."""
LOOK_SECONDS: Final = 0.1
END_SECONDS: Final = 5.0
"""Time that a trial which has reported, or is interrupted, has to end."""


def tried(config: RunConfig) -> EnvironmentSpec:
    """Return the description of a run's environment after a trial in another process.

    What the trial finds wrong, it says itself, and this process ends with the trial's exit code.

    Raises:
        EnvironmentFaultError: the environment has ended the other process.
        SystemExit: the trial has said what is wrong.
    """
    with TemporaryDirectory(prefix="eia-sec-trial-") as folder:
        directory = RunDirectory(Path(folder))
        directory.prepare(config, resume=False)
        # Like all processes of a run it takes no module from the working directory.
        command = [sys.executable, "-P", "-m", "eia_sec.deploy.cli", "trial", "--run-dir", folder]
        command += ["--config", str(directory.path / CONFIG), *code_options(config)]
        code = _completed(command, directory.path / REPORTED)
        team = directory.team()
        if (directory.path / REPORTED).exists():
            if team is not None:
                return spec_of_team(config, team)
            sys.exit(code if code in OUR_CODES and code != DONE else USAGE)
    how = f"signal {-code}" if code < 0 else f"exit code {code}"
    raise EnvironmentFaultError(
        f"{config.env.name} ended its process in a trial of a few steps, with {how}; "
        "what it, or a library of it, has said of that stands above."
    )


def _completed(command: list[str], reported: Path) -> int:
    """Run a command to its end and return its exit code.

    Nothing is left of its process group, whose last member may be a thread of the environment that never ends.

    Args:
        command: the command.
        reported: the file by which it says that it has done its work.
    """
    process = subprocess.Popen(command, stdin=subprocess.DEVNULL, start_new_session=True)
    try:
        until = float("inf")
        while process.poll() is None and time.monotonic() < until:
            with suppress(subprocess.TimeoutExpired):
                process.wait(LOOK_SECONDS)
            if reported.exists():
                until = min(until, time.monotonic() + END_SECONDS)
    except BaseException:
        process.terminate()
        with suppress(subprocess.TimeoutExpired):
            process.wait(END_SECONDS)
        raise
    finally:
        with suppress(ProcessLookupError, PermissionError):  # the latter where only zombies are left, on macOS
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()
    return process.returncode
