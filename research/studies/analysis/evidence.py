"""What a study's results hold on a comparison: values of each seed, and what follows from them over the seeds.

Every comparison of methods is a probability of improvement. Newer results hold it as it was counted on each farm
(`pairs`); older ones were kept without the farms' values, and there it is counted from one number of each run.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from research.studies.analysis.statistics import difference_interval, improvement_interval, interval, mean
from research.studies.methods import CANDIDATES, MIXTURE
from research.studies.scales import CHOICE_FARM, FIRST_FARM, FIRST_REPORTED, FULL

Results = Mapping[str, Any]
Triple = Sequence[float]
"""A number and the ends of its interval."""

SIGNS: Final = {"reward": 1.0, "aoi": -1.0, "vdf": -1.0}
"""What methods are compared by, and the sign with which more of it is better."""
MIXED: Final = "Q_P, the mixture (Q_i without SEC)"
OWN_CRITIC: Final = "Q_i, the agent's own critic"
"""Of which critic the overestimation is in records that name none."""
SCALE_BEFORE: Final = 0.1
"""`algorithm.reward_scale` of the preset (commits 86b8371 to 5d12012), for results without their own."""
ON_FARMS: Final = "farm by farm"
BY_MEANS: Final = "by the runs' means over the farms, as these results hold no farm's values"
BY_CHECKS: Final = (
    f"by each run's last evaluation on farms {CHOICE_FARM}..{CHOICE_FARM + FULL.choice_farms - 1}, as these results "
    "hold neither farms' nor runs' values"
)


def better(data: Results, one: str, other: str, figure: str = "reward") -> tuple[Triple, str]:
    """Return the probability that a run of one method is better than one of another, and what it was counted from.

    Args:
        data: the results of a study with methods.
        one: the first method.
        other: the second method.
        figure: one of SIGNS; less AoI and less VDF are better.
    """
    known = dict(data.get("pairs", {}).get(figure, {}))
    if figure == "reward" and "improvement" in data:
        known.setdefault(next(iter(data["methods"])), data["improvement"])
    if other in known.get(one, {}):
        return known[one][other], ON_FARMS
    if one in known.get(other, {}):
        value, low, high = known[other][one]
        return (1.0 - value, 1.0 - high, 1.0 - low), ON_FARMS
    (own, source), (theirs, _) = (_values(data["methods"][name], figure) for name in (one, other))
    return over_seeds([SIGNS[figure] * v for v in own], [SIGNS[figure] * v for v in theirs]), source


def over_seeds(values: Sequence[float], other: Sequence[float]) -> Triple:
    """Return the probability that a value of the first seeds is above one of the second's, with its interval."""
    return improvement_interval(np.array(values, np.float64)[:, None], np.array(other, np.float64)[:, None])


def mean_over_seeds(values: Sequence[float]) -> Triple:
    """Return the mean of the seeds' values with its interval."""
    return interval(np.array(values, np.float64)[:, None], mean)


def lead(data: Results, one: str, other: str) -> Triple:
    """Return how far one method's mean reward is above another's on the normalised scale, with its interval."""
    policies = data["references"]["policies"]
    scale = policies[data["references"]["best"]]["reward"] - policies["random"]["reward"]
    own, theirs = (np.array(rewards(data["methods"][name])) / scale for name in (one, other))
    return difference_interval(own, theirs)


def rewards(method: Results) -> list[float]:
    """Return the mean reward of each run."""
    return [float(run["reward"]) for run in method["runs"]]


def converged(method: Results) -> list[float]:
    """Return for each run the episode from which on it has converged; infinite where it has not."""
    return [math.inf if run["converged"] is None or run["diverged"] else run["converged"] for run in method["runs"]]


def unrest(method: Results) -> list[float]:
    """Return each run's unrest; infinite for one that did not get far enough to have any."""
    return [math.inf if run["unrest"] is None else run["unrest"] for run in method["runs"]]


def mean_unrest(method: Results) -> float:
    """Return the mean unrest of the runs that have any; infinite for a method without such a run."""
    values = [value for value in unrest(method) if math.isfinite(value)]
    return float(np.mean(values)) if values else math.inf


def farm_spread(method: Results) -> list[float] | None:
    """Return each run's spread over farms; None where the results hold their mean alone."""
    found = [run.get("farm_spread") for run in method["runs"]]
    return None if None in found else [float(value) for value in found]


def overestimation(data: Results, name: str) -> list[float] | None:
    """Return for each run by how much its critics overestimate, mean over types, in units of reward; None if unknown.

    Runs record it in units of scaled reward, and their scales differ by what was chosen for each method.
    """
    runs = data["methods"][name]["runs"]
    if not all(run["overestimation"] for run in runs):
        return None
    chosen = data.get("choice", {}).get(name, {}).get("chosen")
    before = SCALE_BEFORE * CANDIDATES.get(chosen, {}).get("reward_scale", 1.0)
    return [float(np.mean(list(run["overestimation"].values()))) / run.get("reward_scale", before) for run in runs]


def overestimation_of(data: Results, names: Sequence[str]) -> str:
    """Return of which critics' values the methods' overestimation is."""
    kinds = {run.get("compared_value") for name in names for run in data["methods"][name]["runs"]}
    return " and ".join(sorted(MIXED if value == MIXTURE else OWN_CRITIC for value in kinds))


def early_farms(data: Results) -> bool:
    """Return whether results of the full scale are also made from farms that the preset was chosen on."""
    about_farms = any(key in data for key in ("references", "farms")) or any(
        "references" in team for team in data.get("teams", {}).values()
    )
    first = data.get("sizes", {}).get("first_farm", FIRST_FARM)
    return data.get("scale") == FULL.name and about_farms and first < FIRST_REPORTED


def _values(method: Results, figure: str) -> tuple[list[float], str]:
    """Return one of SIGNS for each run, and where it is from."""
    runs = method["runs"]
    if figure == "reward":
        return rewards(method), BY_MEANS
    if all("metrics" in run for run in runs):
        return [float(run["metrics"][figure]) for run in runs], BY_MEANS
    # The last evaluation on the way is of the very actors that the reported farms are flown with. A run that diverged
    # before any evaluation is below all others.
    return [float(run["checks"][-1][figure]) if run["checks"] else math.inf for run in runs], BY_CHECKS
