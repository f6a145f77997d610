"""The farm under its names in the registries of Gymnasium and PettingZoo; importing this module enters it.

    envs = gymnasium.make_vec("rollout.envs.registration:eia-sec/Farm-v0", num_envs=64)
    env = pettingzoo.make("parallel", "eia-sec/Farm-v0")          # after `import rollout.envs.registration`

Neither registry looks for installed packages by itself.
"""

from typing import Final

import gymnasium
import pettingzoo

ENVIRONMENT_ID: Final = "eia-sec/Farm-v0"
"""Name of the farm in both registries; the number rises when an episode of given seeds and actions changes."""

gymnasium.register(ENVIRONMENT_ID, vector_entry_point="rollout.envs.vector:FarmVectorEnv")
pettingzoo.register("parallel", ENVIRONMENT_ID, "rollout.envs.parallel_env:parallel_env")
pettingzoo.register("aec", ENVIRONMENT_ID, "rollout.envs.parallel_env:env")
