"""Converts a trainer's state to plain values for a checkpoint, and checks it when it is read back."""

import math
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any, Final

import numpy as np
import torch
from torch import Tensor

from eia_sec.common.errors import CheckpointError, SchemaError
from eia_sec.common.reward_sums import RewardSums
from eia_sec.common.transitions import EpisodeSummary

MOST_COUNT: Final = 2**62
"""Upper bound of a run's counters; no run comes near it, and messages could not carry larger ones."""
MOST_EPISODES: Final = 4096
"""Most episodes that a checkpoint may hold."""
LARGEST_WEIGHT: Final = 1e10
"""Bound of a network's weights; with larger ones in three layers, outputs overflow."""
OF_ADAM: Final = (".step", ".exp_avg", ".exp_avg_sq")
"""Ends of the names of what Adam keeps beside the weights: count of steps, mean gradients, mean squares."""
MOST_MEAN: Final = 7.5
"""Bound of a gradient's running mean, as a multiple of the root of its running mean square. By the Cauchy-Schwarz
inequality this ratio never exceeds (1 - 0.9) / sqrt((1 - 0.999) (1 - 0.9^2 / 0.999)) = 7.27. With a larger one, the
next step would take a parameter far away."""
VANISHED: Final = 1e-15
"""Size of gradients whose squares may have become 0; they move nothing, because Adam's epsilon is far larger."""


def checked_tensors(targets: Mapping[str, Tensor], source: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Check that the sources can be copied into the targets; return them by the targets' names.

    Raises:
        CheckpointError: when one is missing, has another type or shape, or holds a number that is not finite.
    """
    for name, target in targets.items():
        tensor = source.get(name)
        if tensor is None or tensor.shape != target.shape or tensor.dtype != target.dtype:
            raise CheckpointError(f"the checkpoint's {name} does not fit the configuration.")
        if tensor.is_floating_point() and not bool(torch.isfinite(tensor).all()):
            raise CheckpointError(f"the checkpoint's {name} holds a number that is not finite.")
        weight = tensor.is_floating_point() and not name.endswith(OF_ADAM)
        if weight and tensor.numel() and float(tensor.abs().max()) > LARGEST_WEIGHT:
            raise CheckpointError(f"the checkpoint's {name} holds a weight beyond {LARGEST_WEIGHT:g}.")
    return {name: source[name] for name in targets}


def require_moments(found: Mapping[str, Tensor]) -> None:
    """Check what Adam goes on from: counts of steps, and running means of gradients and of their squares.

    Args:
        found: tensors by name, those of Adam with the ends of `OF_ADAM`.

    Raises:
        CheckpointError: when a count is negative or not whole, a square's mean negative, or a gradient's mean larger
            than any gradients with these squares leave behind.
    """
    steps, means, squares = OF_ADAM
    for name, tensor in found.items():
        if name.endswith(steps) and bool(((tensor < 0) | (tensor != tensor.floor())).any()):
            raise CheckpointError(f"the checkpoint's {name} is no count of updates.")
        if not name.endswith(squares):
            continue
        if bool((tensor < 0).any()):
            raise CheckpointError(f"the checkpoint's {name} holds a negative mean square.")
        mean = found[name.removesuffix(squares) + means]
        if bool((mean.abs() > MOST_MEAN * tensor.sqrt() + VANISHED).any()):
            raise CheckpointError(f"the checkpoint's {name} is too small for the gradients' means beside it.")


def random_state(generator: np.random.Generator) -> dict[str, Any]:
    """Return a Philox generator's state as plain values."""
    state = generator.bit_generator.state
    return {
        "counter": state["state"]["counter"].tolist(),
        "key": state["state"]["key"].tolist(),
        "buffer": state["buffer"].tolist(),
        "buffer_pos": int(state["buffer_pos"]),
        "has_uint32": int(state["has_uint32"]),
        "uinteger": int(state["uinteger"]),
    }


def restored_random(state: Any) -> np.random.Generator:
    """Return a generator that continues from `random_state`.

    Raises:
        CheckpointError: when the state is malformed.
    """
    try:
        philox = np.random.Philox()
        philox.state = {
            "bit_generator": "Philox",
            "state": {"counter": np.array(state["counter"], np.uint64), "key": np.array(state["key"], np.uint64)},
            "buffer": np.array(state["buffer"], np.uint64),
            "buffer_pos": int(state["buffer_pos"]),
            "has_uint32": int(state["has_uint32"]),
            "uinteger": int(state["uinteger"]),
        }
    except (KeyError, TypeError, ValueError, IndexError, OverflowError) as error:
        raise CheckpointError(f"the checkpoint's random state is not readable: {error}.") from error
    generator = np.random.Generator(philox)
    if random_state(generator) != dict(state):
        raise CheckpointError("the checkpoint's random state does not belong to a Philox generator.")
    return generator


def episode_record(episode: EpisodeSummary) -> dict[str, Any]:
    """Return an episode's summary as plain values."""
    return {
        **asdict(episode),
        "reward": list(episode.reward),
        "metrics": dict(episode.metrics),
        "infos": dict(episode.infos),
    }


def episode_summaries(records: Any) -> list[EpisodeSummary]:
    """Return the summaries in a list of `episode_record`s.

    Raises:
        CheckpointError: when a record is malformed, or there are too many.
    """
    try:
        if len(records) > MOST_EPISODES:
            raise ValueError(f"{len(records)} are too many")
        return [_episode_summary(record) for record in records]
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
        raise CheckpointError(f"the checkpoint's record of an episode is not readable: {error}.") from error


def _episode_summary(record: Mapping[str, Any]) -> EpisodeSummary:
    values = dict(record)
    metrics = {str(name): _number(value) for name, value in values["metrics"].items()}
    infos = {str(name): _number(value) for name, value in values["infos"].items()}
    reward = tuple(_number(value) for value in values["reward"])
    episode = EpisodeSummary(**{**values, "reward": reward, "metrics": metrics, "infos": infos})
    if not reward or not all(type(number) is int for number in (episode.farm, episode.episode, episode.steps)):
        raise ValueError("an entry has the wrong type")
    return episode


def rewards_record(rewards: RewardSums) -> dict[str, Any]:
    """Return sums of agents' rewards as plain values."""
    return {"steps": rewards.steps, "sums": rewards.sums.tolist()}


def restored_rewards(record: Any, agents: int) -> RewardSums:
    """Return the sums of a `rewards_record`.

    Raises:
        CheckpointError: when they are malformed, or of another number of agents.
    """
    try:
        sums = np.array([[_number(value) for value in row] for row in record["sums"]])
        return RewardSums.checked(_number(record["steps"]), sums, agents)
    except (KeyError, TypeError, ValueError, OverflowError, SchemaError) as error:
        raise CheckpointError(f"the checkpoint's sums of rewards are not readable: {error}.") from error


def _number(value: Any) -> float:
    number = float(value)
    if isinstance(value, bool | str) or not math.isfinite(number):
        raise ValueError(f"{value!r} is not a number"[:80])
    return number


def counter(state: Mapping[str, Any], name: str) -> int:
    """Return a counter of the state.

    Raises:
        CheckpointError: when it is missing, not an integer, negative, or too large.
    """
    value = state.get(name)
    if type(value) is not int or not 0 <= value < MOST_COUNT:
        raise CheckpointError(f"the checkpoint's {name} is not a count.")
    return value


def finite(state: Mapping[str, Any], name: str) -> float:
    """Return a number of the state.

    Raises:
        CheckpointError: when it is missing, not a number or not finite.
    """
    value = state.get(name)
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise CheckpointError(f"the checkpoint's {name} is not a number.")
    return float(value)


def mapping(state: Mapping[str, Any], name: str) -> dict[str, Any]:
    """Return a mapping in the state.

    Raises:
        CheckpointError: when it is missing or not a mapping.
    """
    value = state.get(name)
    if not isinstance(value, dict):
        raise CheckpointError(f"the checkpoint's {name} is not readable.")
    return value
