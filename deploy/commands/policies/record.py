"""`eia-sec record`: what a policy observes and does, as demonstrations that a run can begin with."""

import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from eia_sec.common.config import RunConfig
from eia_sec.common.config.checks import within
from eia_sec.common.config.environment import FARM
from eia_sec.common.config.presets import preset, preset_for
from eia_sec.common.errors import UsageError
from eia_sec.deploy.exit_codes import DONE
from eia_sec.deploy.options import parse, with_settings
from eia_sec.rollout.demonstrations import recorded, save_demonstrations
from eia_sec.rollout.policies import run_policy


@dataclass(frozen=True)
class RecordArguments:
    """Record what a policy observes and does, for eia-sec train --demonstrations."""

    policy: str
    """Name of a plug-in's heuristic, module:name of one, or a policy file."""
    out: Path
    """File to write, demos.safetensors for instance."""
    env: str
    """Environment, module:name, or its name in a plug-in."""
    episodes: int = 256
    """Episodes to record."""
    set: tuple[str, ...] = ()
    """Single values that override the preset's, for example rollout.train_farms=100."""


def command(arguments: Sequence[str]) -> int:
    """Write the file and say what is in it; return 0."""
    options = parse(RecordArguments, arguments, "record")
    within(1, 1_000_000, episodes=options.episodes)
    if not options.out.parent.is_dir():
        raise UsageError(f"there is no folder {options.out.parent} for --out.")
    config = _configuration(options)
    found = recorded(config, run_policy(options.policy, config), options.episodes, options.policy)
    save_demonstrations(options.out, found)
    reward = float(found.metadata["reward"])
    sys.stdout.write(
        f"{options.out}: {len(found.action):,} steps of {options.episodes} episodes, reward {reward:.2f} per agent "
        "and episode\n"
    )
    return DONE


def _configuration(options: RecordArguments) -> RunConfig:
    if options.env == FARM:
        raise UsageError("policies cannot be recorded on the farm; name another environment with --env.")
    config = preset(preset_for(options.env))
    return with_settings(replace(config, env=replace(config.env, name=options.env)), options.set)
