"""Every algorithm by its name. To add one, write its file and add a line here and in `common.config.algorithms`."""

from typing import Any, Final

from learner.algorithms.base import Algorithm
from learner.algorithms.eia_sec import EiaSec
from learner.algorithms.maddpg import Maddpg
from learner.algorithms.masac import Masac
from learner.algorithms.matd3 import Matd3

ALGORITHMS: Final[dict[str, type[Algorithm[Any]]]] = {
    "eia-sec": EiaSec,
    "maddpg": Maddpg,
    "matd3": Matd3,
    "masac": Masac,
}
"""The learners by `algorithm.name`; `common.config.ALGORITHM_CONFIGS` has their options."""
