"""BenchMARL: what MADDPG reaches on simple_spread. Runs in the environment of requirements/benchmarl.txt.

BenchMARL's own experiment with TorchRL's wrapper around the same environment; gradient clipping and everything that
is not named here are its defaults.
"""

import argparse
import tempfile
import time
from typing import Any

import torch
from benchmarl.algorithms import MaddpgConfig
from benchmarl.experiment import Callback, Experiment, ExperimentConfig
from benchmarl.models import MlpConfig
from mpe2 import simple_spread_v3
from tensordict import TensorDictBase
from torchrl.envs import EnvBase, PettingZooWrapper
from torchrl.envs.utils import ExplorationType, set_exploration_type

from research.benchmarks.peers.clock import hand_over
from research.benchmarks.peers.scripts.wrapped_task import WrappedTask
from research.benchmarks.peers.spread import EPISODE_STEPS, curve, spread_options

COLLECTED = 100
"""Environment steps between two bursts of updates."""


def wrapped(seed: int | None) -> EnvBase:
    """Return the environment as TorchRL sees it."""
    env = simple_spread_v3.parallel_env(continuous_actions=True, max_cycles=EPISODE_STEPS)
    return PettingZooWrapper(env, use_mask=False, categorical_actions=False, seed=seed)


class Rewards(Callback):
    """Keeps the reward of every finished episode, mean over agents."""

    def __init__(self) -> None:
        super().__init__()
        self.episodes: list[float] = []

    def on_batch_collected(self, batch: TensorDictBase) -> None:
        """Note the episodes that ended."""
        ended = batch["next", "done"].reshape(-1)
        reward = batch["next", "agent", "episode_reward"].mean(-2).reshape(-1)
        self.episodes += reward[ended].tolist()


def configuration(options: argparse.Namespace, folder: str) -> ExperimentConfig:
    """Return BenchMARL's defaults with the budget of this comparison."""
    config = ExperimentConfig.get_from_yaml()
    config.share_policy_params = False
    config.gamma, config.lr, config.polyak_tau = options.discount, options.rate, options.target_rate
    config.exploration_eps_init = config.exploration_eps_end = options.noise / 2.0
    config.max_n_iters, config.max_n_frames = None, options.steps
    config.off_policy_collected_frames_per_batch = COLLECTED
    config.off_policy_init_random_frames = options.warmup
    config.off_policy_n_envs_per_worker = 1
    config.off_policy_n_optimizer_steps = COLLECTED // options.every
    config.off_policy_train_batch_size = options.batch
    config.off_policy_memory_size = options.capacity
    config.evaluation, config.render, config.loggers, config.create_json = False, False, [], False
    config.save_folder = folder
    return config


def evaluate(options: argparse.Namespace, policy: Any) -> float:
    """Return the reward of an episode without noise, mean over agents and scenarios."""
    totals = []
    with set_exploration_type(ExplorationType.DETERMINISTIC), torch.no_grad():
        for seed in options.scenarios:
            env = wrapped(seed)
            rollout = env.rollout(EPISODE_STEPS, policy)
            totals.append(rollout["next", "agent", "reward"].mean(-2).sum().item())
            env.close()
    return sum(totals) / len(totals)


def main() -> None:
    """Train, evaluate and print."""
    options = spread_options("BenchMARL", ("maddpg",)).parse_args()
    torch.set_num_threads(1)
    algorithm = MaddpgConfig.get_from_yaml()
    algorithm.share_param_critic = False
    cells = [options.width, options.width]
    model = MlpConfig(num_cells=cells, layer_class=torch.nn.Linear, activation_class=torch.nn.ReLU)
    rewards = Rewards()
    with tempfile.TemporaryDirectory() as folder:
        experiment = Experiment(
            task=WrappedTask("spread", wrapped, EPISODE_STEPS),
            algorithm_config=algorithm,
            model_config=model,
            critic_model_config=MlpConfig(**vars(model)),
            seed=options.seed,
            config=configuration(options, folder),
            callbacks=[rewards],
        )
        started = time.perf_counter()
        experiment.run()
        seconds = time.perf_counter() - started
        found = evaluate(options, experiment.policy)
    hand_over(
        [{"reward": found, "seconds": seconds, "curve": curve(rewards.episodes)}], "benchmarl", "torchrl", "torch"
    )


if __name__ == "__main__":
    main()
