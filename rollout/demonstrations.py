"""Demonstrations: what a policy observed and did, recorded in one file for a run to begin with.

The file is safetensors with two tensors, `observation` [R, O] (float32, or bytes where all agents see images) and
`action` [R, A] float32: a row for each step of every episode. Its metadata hold the team and where the rows come from.
"""

import json
from collections.abc import Mapping
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save_file

from eia_sec.common.config import RunConfig
from eia_sec.common.errors import ConfigError, EiaSecError, PolicyError
from eia_sec.common.seeds import derive
from eia_sec.common.team import Float32, TeamSpec, described
from eia_sec.common.transitions import LARGEST, observation_type
from eia_sec.rollout.envs.base import Environments
from eia_sec.rollout.envs.registry import make_environments, patient_with
from eia_sec.rollout.policies import BatchPolicy

FORMAT: Final = "eia-sec demonstrations 1"
BATCH: Final = 32
"""Episodes that are flown at once."""
MOST_BYTES: Final = 4 * 2**30
"""Largest file that is read."""


@dataclass(frozen=True)
class Demonstrations:
    """Steps of a policy.

    Attributes:
        team: the layout of a row.
        observation: [R, O].
        action: [R, A] float32: in [-1, 1], or indices of options.
        metadata: where they come from: environment, policy, episodes, and the mean reward of an agent in one.
    """

    team: TeamSpec
    observation: NDArray[Any]
    action: Float32
    metadata: Mapping[str, str]


def recorded(config: RunConfig, policy: BatchPolicy[Environments], episodes: int, name: str) -> Demonstrations:
    """Return the steps of some episodes, in scenarios from which training draws, too.

    Args:
        config: the run whose environment is flown.
        policy: the policy.
        episodes: how many.
        name: the policy's name.

    Raises:
        ConfigError: actions of the environment's agents are not those that actors choose.
    """
    observations: list[NDArray[Any]] = []
    actions: list[Float32] = []
    rewards: list[float] = []
    team = None
    for first in range(0, episodes, BATCH):
        numbers = range(first, min(first + BATCH, episodes))
        with patient_with(config), closing(make_environments(config, len(numbers))) as flown:
            team = flown.team
            if any(group.adapters for group in team.groups):
                raise ConfigError(
                    "policies cannot be recorded on the farm: a UAV's actions there are velocities, which its actor "
                    "does not choose directly."
                )
            for index, number in enumerate(numbers):
                farm = number % config.rollout.train_farms
                flown.reset(index, farm, derive(farm, "demonstration", number))
                policy.reset(flown, index)
            while not flown.ended.all():
                running = ~flown.ended
                observations.append(flown.observation[running].copy())
                action = np.asarray(policy.act(flown), np.float32)
                actions.append(np.clip(action, *_range(team))[running])
                flown.step(action)
            rewards += [float(np.mean(flown.summary(index).reward)) for index in range(len(numbers))]
    if team is None:
        raise ConfigError(f"--episodes must be 1 or more, not {episodes}.")
    origin = {"environment": config.env.name, "policy": name, "episodes": str(episodes)}
    reward = f"{float(np.mean(rewards)):.6g}"
    return Demonstrations(team, np.concatenate(observations), np.concatenate(actions), {**origin, "reward": reward})


def save_demonstrations(path: Path, found: Demonstrations) -> None:
    """Write demonstrations; raise PolicyError if that is impossible."""
    header = {**found.metadata, "format": FORMAT, "team": json.dumps(found.team.to_dict())}
    try:
        save_file({"observation": found.observation, "action": found.action}, path, header)
    except (OSError, SafetensorError) as error:
        raise PolicyError(f"the demonstrations {path} cannot be written: {error}.") from error


def load_demonstrations(path: Path) -> Demonstrations:
    """Read demonstrations; shapes and types are compared before an array is made.

    Raises:
        PolicyError: the file is missing, truncated or damaged, or holds something else.
    """
    try:
        if path.stat().st_size > MOST_BYTES:
            raise PolicyError(f"it holds more than {MOST_BYTES:,} bytes")
        with safe_open(path, "numpy") as file:
            metadata = dict(file.metadata() or {})
            if metadata.pop("format", "") != FORMAT:
                raise PolicyError(f"it is not in the format {FORMAT!r}")
            team = TeamSpec.from_dict(json.loads(metadata.pop("team")))
            _compare(file, team)
            found = Demonstrations(team, file.get_tensor("observation"), file.get_tensor("action"), metadata)
        _require_possible(found)
    except OSError as error:
        raise PolicyError(f"the demonstrations {path} cannot be read: {error.strerror or error}.") from error
    except (EiaSecError, SafetensorError, ValueError, LookupError, TypeError, RecursionError) as error:
        reason = f"{error.args[0]!r} is missing" if isinstance(error, KeyError) else str(error).rstrip(".")
        raise PolicyError(f"{path} holds no valid demonstrations: {reason}.") from error
    return found


def require_team(found: Demonstrations, team: TeamSpec, path: Path) -> None:
    """Raise PolicyError for demonstrations of another team."""
    if found.team != team:
        raise PolicyError(f"{path} is of {described(found.team)}, and this run trains {described(team)}.")


def _compare(file: Any, team: TeamSpec) -> None:
    """Raise PolicyError unless a file's tensors are those of a team."""
    seen = {np.dtype(np.uint8): "U8", np.dtype(np.float32): "F32"}[observation_type(team, rounded=False)]
    wanted = {"observation": (team.observation_size, seen), "action": (team.action_size, "F32")}
    if {*file.keys()} != {*wanted}:
        raise PolicyError("its tensors are not observation and action")
    rows = {name: file.get_slice(name).get_shape()[:1] for name in wanted}
    for name, (size, kind) in wanted.items():
        held = file.get_slice(name)
        if held.get_shape() != [*rows["action"], size] or held.get_dtype() != kind:
            raise PolicyError(f"its {name} is {held.get_dtype()}{held.get_shape()}, not {kind}[rows, {size}]")
    if not rows["action"][0]:
        raise PolicyError("it holds no step")


def _require_possible(found: Demonstrations) -> None:
    """Raise PolicyError for observations and actions that no environment of the team has."""
    if found.observation.dtype != np.uint8 and not (np.abs(found.observation) <= LARGEST).all():
        raise PolicyError(f"an observation is not finite or larger than {LARGEST:g}")
    low, high = _range(found.team)
    whole = np.concatenate([np.full(g.count * g.action_size, bool(g.choices)) for g in found.team.groups])
    action = found.action
    if not ((action >= low) & (action <= high)).all() or (action[:, whole] % 1.0).any():
        raise PolicyError("an action lies outside [-1, 1], or is not the index of an option")


def _range(team: TeamSpec) -> tuple[Float32, Float32]:
    """Return the least and the largest numbers [A] of actions."""
    low = [0.0 if group.choices else -1.0 for group in team.groups for _ in range(group.count * group.action_size)]
    high = [
        top
        for group in team.groups
        for _ in range(group.count)
        for top in ([options - 1.0 for options in group.choices] or [1.0] * group.action_size)
    ]
    return np.array(low, np.float32), np.array(high, np.float32)
