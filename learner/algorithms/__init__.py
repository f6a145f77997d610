"""Every algorithm by its name. To add one, write its file and add a line here and in `common.config.algorithms`."""

from typing import Any, Final

from eia_sec.learner.algorithms.base import Algorithm
from eia_sec.learner.algorithms.eia_sec import EiaSec
from eia_sec.learner.algorithms.maddpg import Maddpg
from eia_sec.learner.algorithms.masac import Masac
from eia_sec.learner.algorithms.matd3 import Matd3

ALGORITHMS: Final[dict[str, type[Algorithm[Any]]]] = {
    "eia-sec": EiaSec,
    "maddpg": Maddpg,
    "matd3": Matd3,
    "masac": Masac,
}
"""The learners by `algorithm.name`; `eia_sec.common.config.ALGORITHM_CONFIGS` has their options."""
