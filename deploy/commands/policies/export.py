"""`eia-sec export`: a run's actors as ONNX models or plain tensors."""

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal

from eia_sec.common.errors import RunDirError
from eia_sec.common.farm import farm_of, farm_team
from eia_sec.common.policy_file import POLICY, load_policy
from eia_sec.deploy.exit_codes import DONE
from eia_sec.deploy.local.run_directory import RunDirectory, own_folder
from eia_sec.deploy.options import parse
from eia_sec.deploy.policies.export import export_onnx, export_safetensors
from eia_sec.rollout.policies import fitted

FORMATS: Final = {"onnx": export_onnx, "safetensors": export_safetensors}


@dataclass(frozen=True)
class ExportArguments:
    """Write a run's actors as files that need nothing of this project; see docs/how-to/export.md."""

    run_dir: Path
    """Run directory."""
    format: Literal["onnx", "safetensors"] = "onnx"
    """onnx: one model per agent; safetensors: one file with the layers of all agents."""
    out: Path | None = None
    """Output folder. Default: export/ in the run directory."""


def command(arguments: Sequence[str]) -> int:
    """Write the files and print their names; return 0."""
    options = parse(ExportArguments, arguments, "export")
    config = RunDirectory(options.run_dir).configuration()
    path = options.run_dir / POLICY
    if not path.is_file():
        raise RunDirError(f"{options.run_dir} has no {POLICY}: the run has not saved a policy yet.")
    actors, metadata = load_policy(path)
    if (farm := farm_of(config)) is not None:
        # Another environment's team is known only by running its code, which this command never does.
        actors = fitted(actors, farm_team(farm))
    written = FORMATS[options.format](options.out or own_folder(options.run_dir, "export"), config, actors, metadata)
    sys.stdout.write("".join(f"{file}\n" for file in written))
    return DONE
