"""BenchMARL: when its IPPO or MAPPO flies the farm well enough. Runs in the environment of requirements/benchmarl.txt.

BenchMARL's own experiment with TorchRL's wrapper around the PettingZoo farm: a group for each type of UAV, whose agents
share an actor and a critic. What is not named here are its defaults.
"""

import argparse
import contextlib
import tempfile
from collections import Counter
from typing import Any

import torch
from benchmarl.algorithms import IppoConfig, MappoConfig
from benchmarl.experiment import Callback, Experiment, ExperimentConfig
from benchmarl.models import MlpConfig
from tensordict import TensorDict, TensorDictBase
from torchrl.envs import EnvBase, PettingZooWrapper
from torchrl.envs.utils import ExplorationType, set_exploration_type

from eia_sec.common.config import FarmConfig
from eia_sec.common.team import Float32
from eia_sec.rollout.sim.batch import FarmBatch
from research.benchmarks.peers.clock import hand_over
from research.benchmarks.peers.flights import Course, FarmOfChoices, farm_options
from research.benchmarks.peers.scripts.wrapped_task import WrappedTask

ALGORITHMS = {"ippo": IppoConfig, "mappo": MappoConfig}


class Farms:
    """Makes wrapped farms, each of which draws its episodes from a seed of its own, whatever is given.

    Args:
        reward_scale: factor on every reward.
        first: seed of the first farm.
    """

    def __init__(self, reward_scale: float, first: int) -> None:
        self._reward_scale, self._next = reward_scale, first

    def __call__(self, seed: int | None) -> EnvBase:
        """Return one more farm."""
        self._next += 1
        return PettingZooWrapper(FarmOfChoices(self._reward_scale), use_mask=False, seed=self._next - 1)


class Learnt:
    """BenchMARL's actors without noise, as `eia_sec.rollout.evaluation` flies a policy."""

    def __init__(self, policy: Any) -> None:
        self._policy = policy

    def reset(self, world: FarmBatch, index: int) -> None:
        """Nothing to begin."""

    def act(self, world: FarmBatch) -> Float32:
        """Return everybody's actions [farms, A]."""
        count, team = len(world.observation), world.team
        parts = zip(team.groups, team.split_observations(world.observation), strict=True)
        seen = {group.name: {"observation": torch.from_numpy(part.copy())} for group, part in parts}
        with set_exploration_type(ExplorationType.DETERMINISTIC), torch.no_grad():
            done = self._policy(TensorDict(seen, batch_size=[count]))
        row = torch.cat([done[group.name, "action"].reshape(count, -1) for group in team.groups], -1)
        return team.adapt(world.observation, row.float().numpy())


class EnoughError(Exception):
    """What is wanted was reached, or the time is up."""


class Looks(Callback):
    """Looks at the policy whenever steps have been collected."""

    def __init__(self, course: Course) -> None:
        super().__init__()
        self._course, self._steps = course, 0
        self._updates: Counter[str] = Counter()

    def on_batch_collected(self, batch: TensorDictBase) -> None:
        """Look when it is time to."""
        self._steps += batch.numel()
        updates = max(self._updates.values(), default=0)
        if self._course.over(Learnt(self.experiment.policy), self._steps, updates):
            raise EnoughError

    def on_train_step(self, batch: TensorDictBase, group: str) -> None:
        """Count a training step of a group."""
        self._updates[group] += 1


def configuration(options: argparse.Namespace, folder: str) -> ExperimentConfig:
    """Return BenchMARL's defaults with the settings of this comparison."""
    config = ExperimentConfig.get_from_yaml()
    config.share_policy_params, config.prefer_continuous_actions = True, False
    config.gamma, config.lr, config.clip_grad_val = options.discount, options.rate, options.gradient_clip
    config.max_n_iters, config.max_n_frames = None, 100_000_000
    config.on_policy_collected_frames_per_batch = options.iteration
    config.on_policy_n_envs_per_worker = options.environments
    config.on_policy_n_minibatch_iters = options.epochs
    config.on_policy_minibatch_size = options.minibatch
    config.evaluation, config.render, config.loggers, config.create_json = False, False, [], False
    config.save_folder = folder
    return config


def main() -> None:
    """Train and print."""
    options = farm_options("BenchMARL").parse_args()
    torch.set_num_threads(options.threads)
    algorithm = ALGORITHMS[options.algorithm].get_from_yaml()
    algorithm.clip_epsilon, algorithm.entropy_coef, algorithm.lmbda = options.clip, options.entropy, options.gae_lambda
    cells = [options.width, options.width]
    model = MlpConfig(num_cells=cells, layer_class=torch.nn.Linear, activation_class=torch.nn.ReLU)
    course, farms = Course(options), Farms(options.reward_scale, options.seed * options.environments)
    with tempfile.TemporaryDirectory() as folder:
        experiment = Experiment(
            task=WrappedTask("farm", farms, FarmConfig().world.steps, discrete=True),
            algorithm_config=algorithm,
            model_config=model,
            critic_model_config=MlpConfig(**vars(model)),
            seed=options.seed,
            config=configuration(options, folder),
            callbacks=[Looks(course)],
        )
        with contextlib.suppress(EnoughError):
            experiment.run()
    hand_over([course.result()], "benchmarl", "torchrl", "torch")


if __name__ == "__main__":
    main()
