"""Every algorithm by its name. To add one, write its file and add its line here and in `common.config.learning`."""

from typing import Final

from common.config.learning import AlgorithmName
from learner.algorithms.base import Algorithm
from learner.algorithms.eia_sec import EiaSec
from learner.algorithms.maddpg import Maddpg
from learner.algorithms.masac import Masac
from learner.algorithms.matd3 import Matd3

ALGORITHMS: Final[dict[AlgorithmName, type[Algorithm]]] = {
    "eia-sec": EiaSec,
    "eia": EiaSec,
    "sec": EiaSec,
    "base": EiaSec,
    "maddpg": Maddpg,
    "matd3": Matd3,
    "masac": Masac,
}
"""The classes by `algorithm.name`; the ablations of EIA-SEC are its own class with parts left out."""
