"""BenchMARL: what MADDPG reaches on simple_spread. Runs in the environment of requirements/benchmarl.txt.

BenchMARL's own experiment with TorchRL's wrapper around the same environment; gradient clipping and everything that
is not named here are its defaults.
"""

import argparse
import tempfile
import time
from collections.abc import Callable
from typing import Any

import torch
from benchmarl.algorithms import MaddpgConfig
from benchmarl.environments import TaskClass
from benchmarl.experiment import Callback, Experiment, ExperimentConfig
from benchmarl.models import MlpConfig
from mpe2 import simple_spread_v3
from tensordict import TensorDictBase
from torchrl.envs import EnvBase, PettingZooWrapper
from torchrl.envs.utils import ExplorationType, set_exploration_type

from benchmarks.peers.clock import hand_over
from benchmarks.peers.spread import EPISODE_STEPS, curve, spread_options

COLLECTED = 100
"""Environment steps between two bursts of update rounds."""


def wrapped(seed: int | None) -> EnvBase:
    """Return the environment as TorchRL sees it."""
    env = simple_spread_v3.parallel_env(continuous_actions=True, max_cycles=EPISODE_STEPS)
    return PettingZooWrapper(env, use_mask=False, categorical_actions=False, seed=seed)


class SpreadTask(TaskClass):
    """simple_spread of mpe2."""

    def get_env_fun(self, num_envs: int, continuous_actions: bool, seed: int | None, device: Any) -> Callable[[], Any]:
        """Return a function that makes the environment."""
        return lambda: wrapped(seed)

    def supports_continuous_actions(self) -> bool:
        """Say yes."""
        return True

    def supports_discrete_actions(self) -> bool:
        """Say no."""
        return False

    def has_render(self, env: EnvBase) -> bool:
        """Say no."""
        return False

    def max_steps(self, env: EnvBase) -> int:
        """Return the length of an episode."""
        return EPISODE_STEPS

    def group_map(self, env: EnvBase) -> dict[str, list[str]]:
        """Return the names of the agents of each group."""
        return dict(env.group_map)

    def observation_spec(self, env: EnvBase) -> Any:
        """Return what the agents see, and nothing else."""
        spec = env.observation_spec.clone()
        for group in self.group_map(env):
            for key in [key for key in spec[group].keys() if key != "observation"]:  # noqa: SIM118 - specs need keys()
                del spec[group, key]
        for key in [key for key in spec.keys() if key not in self.group_map(env)]:  # noqa: SIM118 - specs need keys()
            del spec[key]
        return spec

    def info_spec(self, env: EnvBase) -> None:
        """Return nothing."""
        return

    def state_spec(self, env: EnvBase) -> None:
        """Return nothing: critics see all observations."""
        return

    def action_spec(self, env: EnvBase) -> Any:
        """Return the agents' actions."""
        return env.full_action_spec

    def action_mask_spec(self, env: EnvBase) -> None:
        """Return nothing."""
        return

    @staticmethod
    def env_name() -> str:
        """Return the name in BenchMARL's output."""
        return "mpe2"


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
            task=SpreadTask("spread", {}),
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
