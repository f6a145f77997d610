"""BenchMARL: when its MADDPG flies the farm well enough. Runs in the environment of requirements/benchmarl.txt.

BenchMARL's own experiment with TorchRL's wrapper around the PettingZoo farm: a group for each type of UAV, actors and
critics of their own. Gradient clipping and everything that is not named here are its defaults. Its warm-up is of the
collector alone: update rounds begin with the first steps.
"""

import argparse
import contextlib
import itertools
import tempfile
from collections import Counter
from collections.abc import Callable
from typing import Any

import torch
from benchmarl.algorithms import MaddpgConfig
from benchmarl.environments import TaskClass
from benchmarl.experiment import Callback, Experiment, ExperimentConfig
from benchmarl.models import MlpConfig
from tensordict import TensorDict, TensorDictBase
from torchrl.envs import EnvBase, PettingZooWrapper
from torchrl.envs.utils import ExplorationType, set_exploration_type

from benchmarks.peers.clock import hand_over
from benchmarks.peers.flights import Course, SteeredFarm, farm_options
from common.team import Float32
from rollout.farms import FarmBatch

COLLECTED = 800
"""Environment steps between two bursts of update rounds."""
EPISODE_STEPS = 500


class FarmTask(TaskClass):
    """The farm, its UAVs grouped by type."""

    reward_scale = 1.0
    made = itertools.count()

    def get_env_fun(self, num_envs: int, continuous_actions: bool, seed: int | None, device: Any) -> Callable[[], Any]:
        """Return a function that makes an environment, with a seed of its own each time."""
        first = (seed or 0) * 1000
        return lambda: PettingZooWrapper(SteeredFarm(self.reward_scale), use_mask=False, seed=first + next(self.made))

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
        """Return nothing: critics see all observations of their group."""
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
        return "farm"


class Learnt:
    """BenchMARL's actors without noise, as `rollout.evaluation` flies a policy."""

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
        return team.steer(world.observation, row.clamp(-1.0, 1.0).numpy())


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
    config.share_policy_params = False
    config.gamma, config.lr, config.polyak_tau = options.discount, options.actor_rate, options.target_rate
    config.exploration_eps_init = config.exploration_eps_end = options.noise
    config.max_n_iters, config.max_n_frames = None, 100_000_000
    config.off_policy_collected_frames_per_batch = COLLECTED
    config.off_policy_init_random_frames = options.warmup
    config.off_policy_n_envs_per_worker = options.environments
    config.off_policy_n_optimizer_steps = round(COLLECTED * options.updates_per_step)
    config.off_policy_train_batch_size = options.batch
    config.off_policy_memory_size = options.capacity
    config.evaluation, config.render, config.loggers, config.create_json = False, False, [], False
    config.save_folder = folder
    return config


def main() -> None:
    """Train and print."""
    options = farm_options("BenchMARL").parse_args()
    torch.set_num_threads(options.threads)
    if options.actor_rate != options.critic_rate:
        raise ValueError("BenchMARL has one learning rate for actors and critics.")
    algorithm = MaddpgConfig.get_from_yaml()
    algorithm.share_param_critic = False
    cells = [options.width, options.width]
    model = MlpConfig(num_cells=cells, layer_class=torch.nn.Linear, activation_class=torch.nn.ReLU)
    course, task = Course(options), FarmTask("farm", {})
    task.reward_scale = options.reward_scale
    with tempfile.TemporaryDirectory() as folder:
        experiment = Experiment(
            task=task,
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
