"""The records of finished trainings, each a file; what cannot be read counts as missing."""

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from eia_sec.common.errors import EiaSecError
from eia_sec.common.log import log
from eia_sec.common.regular_files import read_regular_text
from eia_sec.deploy.benchmark.trainings import FINAL_TIMES, FORMAT, RANDOM, Training
from eia_sec.deploy.local.contained_files import write

DIGITS: Final = 6
"""Decimals of returns and times."""
POLICY: Final = ".safetensors"
JOB: Final = ".job.json"
FILE_MODE: Final = 0o644


@dataclass(frozen=True)
class Point:
    """An evaluation along a training.

    Attributes:
        step_count: environment steps taken until then, those of imitation included.
        seconds: time of training until then, without evaluations.
        returns: reward per agent of each scenario's episode.
    """

    step_count: int
    seconds: float
    returns: list[float]


@dataclass(frozen=True)
class Result:
    """What a training has come to.

    Attributes:
        points: the evaluations along it; none of the reference.
        absolute: returns of the best policy of all points, on the final scenarios (Gorsane et al. 2022).
        final: returns of the policy at the end, on the same scenarios.
        sampled: likewise, by actions drawn from its distribution; empty for policies without one.
        made: commit, versions and threads.
    """

    points: list[Point]
    absolute: list[float]
    final: list[float]
    sampled: list[float]
    made: Mapping[str, Any]


class Records:
    """The folder of all records.

    Args:
        folder: it exists.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def path(self, training: Training, suffix: str = ".json") -> Path:
        """Return the path of a training's record, or of another of its files."""
        return self.folder / (training.name + suffix)

    def get(self, training: Training) -> Result | None:
        """Return a training's result, or None when there is none that is whole."""
        path = self.path(training)
        try:
            return _checked(json.loads(read_regular_text(path), parse_constant=_not_finite), training)
        except FileNotFoundError:
            return None
        except (OSError, ValueError, LookupError, TypeError, RecursionError) as error:
            log(f"{path} cannot be read and is made anew: {error}")
            return None

    def put(self, training: Training, result: Result) -> None:
        """Write a training's record.

        Raises:
            EiaSecError: a return is not finite.
            OSError: it cannot be written.
        """
        returns = [*result.absolute, *result.final, *result.sampled, *(x for one in result.points for x in one.returns)]
        if not all(map(math.isfinite, returns)):
            raise EiaSecError(f"{training.label} has returns that are not finite.")
        held = {
            "format": FORMAT,
            "training": training.digest,
            "points": [
                {"step_count": one.step_count, "seconds": round(one.seconds, DIGITS), "returns": _rounded(one.returns)}
                for one in result.points
            ],
            "absolute": _rounded(result.absolute),
            "final": _rounded(result.final),
            "sampled": _rounded(result.sampled),
            "made": dict(result.made),
        }
        write(self.folder, self.path(training).name, json.dumps(held).encode() + b"\n", FILE_MODE)


def _rounded(numbers: list[float]) -> list[float]:
    return [round(number, DIGITS) for number in numbers]


def _not_finite(name: str) -> float:
    raise ValueError(f"it holds {name}")


def _checked(held: Any, training: Training) -> Result:
    """Return the result in a record; raise ValueError, LookupError or TypeError unless it is one of the training."""
    if held["format"] != FORMAT or held["training"] != training.digest:
        raise ValueError("it is of another training")
    measuring = training.measuring
    points, last = held["points"], FINAL_TIMES * measuring.scenarios
    wanted = 0 if training.algorithm == RANDOM else measuring.points
    if not isinstance(points, list) or len(points) != wanted or not isinstance(held["made"], dict):
        raise ValueError("its points are not those that were asked for")
    along = [_point(one, measuring.scenarios) for one in points]
    sampled = _numbers(held["sampled"], last if held["sampled"] else 0)
    return Result(along, _numbers(held["absolute"], last), _numbers(held["final"], last), sampled, held["made"])


def _point(held: Any, scenarios: int) -> Point:
    seconds = _numbers([held["seconds"]], 1)[0]
    return Point(_whole(held["step_count"]), seconds, _numbers(held["returns"], scenarios))


def _whole(number: Any) -> int:
    if type(number) is not int or not 0 <= number < 2**63:
        raise ValueError(f"{number!r} is no number of steps")
    return number


def _numbers(found: Any, count: int) -> list[float]:
    if not isinstance(found, list) or len(found) != count:
        raise ValueError(f"it has not {count} returns where it should")
    if not all(type(number) in (int, float) and math.isfinite(number) for number in found):
        raise ValueError("a return is no finite number")
    return [float(number) for number in found]
