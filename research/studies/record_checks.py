"""Whether a record's result is what such a job leaves behind, checked before anything is counted from it."""

import math
from collections.abc import Collection, Mapping
from typing import Any, Final

from eia_sec.common.config import RunConfig
from eia_sec.common.farm import METRIC_NAMES, farm_team

COUNTERS: Final = ("episodes", "environment_steps", "evaluation_steps", "updates", "events")
"""Counts of a training."""
PIECES: Final = ("decide", "separate", "simulate")
"""What is timed."""
QUANTILES: Final = ("q05", "median", "mean", "q95")
"""The statistics of each time, ms."""
CURVES: Final = ("aoi", "vdf")
"""Numbers of the training curve, besides the rewards."""


def check_result(kind: str, config: RunConfig, options: Mapping[str, Any], result: Mapping[str, Any]) -> None:
    """Raise ValueError unless a result is whole; arguments as `research.studies.jobs.Job` has them."""
    types = [group.name for group in farm_team(config.farm).groups]
    try:
        if kind == "time":
            for piece in PIECES:
                _numbers([result[piece][name] for name in QUANTILES])
        elif kind == "fly":
            _evaluation(result, options["farms"], types)
        else:
            _training(result, options, types)
    except (KeyError, TypeError, AttributeError, OverflowError) as error:
        raise ValueError(f"its result is not whole: {error}") from None


def _training(result: Mapping[str, Any], options: Mapping[str, Any], types: Collection[str]) -> None:
    _evaluation(result["evaluation"], options["farms"], types)
    for name in COUNTERS:
        _count(result[name])
    curve = result["curve"]
    for episodes in curve["episodes"]:
        _count(episodes)
    for values in (*(curve["reward"][name] for name in ("mean", *types)), *(curve[name] for name in CURVES)):
        _numbers(values, len(curve["episodes"]))
    for check in result["checks"]:
        _count(check["episodes"])
        _numbers([check[name] for name in ("reward", *CURVES)])
    for name in ("overestimation", "realised_return"):
        _numbers(list(result.get(name, {}).values()))
    if type(result["diverged"]) is not bool or not isinstance(result.get("compared_value", ""), str):
        raise ValueError("it does not say whether it diverged, or what was compared")


def _evaluation(evaluation: Mapping[str, Any], farms: Any, types: Collection[str]) -> None:
    first, count = farms
    if (evaluation["first_farm"], evaluation["farms"]) != (first, count):
        raise ValueError("it was flown on other farms")
    sections = (("types", types), ("metrics", METRIC_NAMES))
    lists = [evaluation[section][name] for section, names in sections for name in names]
    for values in (evaluation["reward"], *lists):
        _numbers(values, count)


def _numbers(values: Any, count: int | None = None) -> None:
    if not isinstance(values, list) or (count is not None and len(values) != count):
        raise ValueError("a list is none, or too short or too long")
    if not all(type(value) in (int, float) and math.isfinite(value) for value in values):
        raise ValueError("a number is none, or not finite")


def _count(value: Any) -> None:
    if type(value) is not int or value < 0:
        raise ValueError(f"{str(value)[:20]} is no count")
