"""Registers the farm with Gymnasium and PettingZoo when it is imported.

    envs = gymnasium.make_vec("eia_sec.rollout.envs.registration:eia-sec/Farm-v0", num_envs=64)
    env = pettingzoo.make("parallel", "eia-sec/Farm-v0")          # after `import eia_sec.rollout.envs.registration`

The import is needed because neither registry searches installed packages.
"""

from typing import Final

import gymnasium
import pettingzoo

ENVIRONMENT_ID: Final = "eia-sec/Farm-v0"
"""Name of the farm in both registries. The version rises when the same seeds and actions give another episode."""

gymnasium.register(ENVIRONMENT_ID, vector_entry_point="eia_sec.rollout.envs.vector:FarmVectorEnv")
pettingzoo.register("parallel", ENVIRONMENT_ID, "eia_sec.rollout.envs.parallel_env:parallel_env")
pettingzoo.register("aec", ENVIRONMENT_ID, "eia_sec.rollout.envs.parallel_env:env")
