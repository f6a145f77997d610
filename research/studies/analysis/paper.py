"""What the paper reports, as far as it gives numbers: inference in ms for each time step, reward per agent."""

from typing import Final

INFERENCE_BY_UAVS: Final = {6: 17.64, 12: 34.38, 16: 44.45, 20: 80.81, 24: 117.16}
REWARD_BY_UAVS: Final = {6: 904.09, 12: 895.04, 16: 864.44, 20: 871.08, 24: 881.34}
INFERENCE_BY_METHOD: Final = {"EIA-SEC": 34.38, "MATD3": 32.21, "MASAC": 33.26, "MADDPG": 29.27}
REWARD_BY_MEMBERS: Final = {1: 721.91, 2: 895.04, 3: 847.91, 4: 838.38, 5: 832.43, 10: 734.32}
CONVERGED_EPISODES: Final = 800
"""All methods converge within so many episodes."""
REWARD: Final = 895.04
"""EIA-SEC with 12 UAVs and k_s = 2."""
