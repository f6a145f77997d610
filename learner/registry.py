"""Every algorithm by its name. To add one, write its file and add a line here and in `eia_sec.common.config`."""

from typing import Any, Final

from eia_sec.learner.off_policy.algorithm import Algorithm
from eia_sec.learner.off_policy.eia_sec import EiaSec
from eia_sec.learner.off_policy.maddpg import Maddpg
from eia_sec.learner.off_policy.masac import Masac
from eia_sec.learner.off_policy.matd3 import Matd3
from eia_sec.learner.on_policy.eia_ppo import EiaPpo
from eia_sec.learner.on_policy.ippo import Ippo
from eia_sec.learner.on_policy.mappo import Mappo
from eia_sec.learner.on_policy.ppo import Ppo

OFF_POLICY: Final[dict[str, type[Algorithm[Any]]]] = {
    "eia-sec": EiaSec,
    "maddpg": Maddpg,
    "matd3": Matd3,
    "masac": Masac,
}
"""Algorithms that learn from a replay buffer, by `algorithm.name`."""
ON_POLICY: Final[dict[str, type[Ppo]]] = {
    "ippo": Ippo,
    "mappo": Mappo,
    "eia-ppo": EiaPpo,
}
"""Algorithms that learn in iterations; `eia_sec.common.config.ALGORITHM_CONFIGS` has the options of both families."""
