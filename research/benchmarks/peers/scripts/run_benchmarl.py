"""BenchMARL: milliseconds of an update of MADDPG and MASAC. Runs in the environment of requirements/benchmarl.txt.

An experiment collects a full replay buffer of noise and then trains; a callback, called after each training step, takes
the time between steps, each of which samples, updates critic and actor of all agents of a group, and moves the targets.
An update is one training step of each group. Agents have actors and critics of their own, which BenchMARL updates
together as one batched network. Two forms are measured:

- `one group`: twelve agents of equal sizes, the largest of the groups' padded; critics see everything.
- `groups`: the groups with their own sizes, one after the other; a critic sees the global state, which is everybody's
  observation, and its own group's actions. This is how BenchMARL treats teams of several kinds.
"""

import argparse
import tempfile
import time
from typing import Any

import torch
from benchmarl.algorithms import MaddpgConfig, MasacConfig
from benchmarl.experiment import Callback, Experiment, ExperimentConfig
from benchmarl.models import MlpConfig
from tensordict import TensorDictBase

from research.benchmarks.peers.clock import bursts_of, hand_over, learner_options, parse_groups
from research.benchmarks.peers.scripts.noise_task import Groups, NoiseTask

ALGORITHMS = {"MADDPG": MaddpgConfig, "MASAC": MasacConfig}
ENVIRONMENTS = 1024
WARM_UP = 10


class Watch(Callback):
    """Notes when each training step of each group ended."""

    def __init__(self) -> None:
        super().__init__()
        self.moments: dict[str, list[float]] = {}

    def on_train_step(self, batch: TensorDictBase, group: str) -> None:
        """Note the moment."""
        self.moments.setdefault(group, []).append(time.perf_counter())


def forms(groups: Groups) -> dict[str, dict[str, Any]]:
    """Return the configuration of the task of each form."""
    total = sum(count for _, count, _, _ in groups)
    widest = [max(column) for column in zip(*((seen, done) for _, _, seen, done in groups), strict=True)]
    return {
        "one group": {"groups": [("agents", total, *widest)], "state": False},
        "groups": {"groups": groups, "state": True},
    }


def configuration(options: argparse.Namespace, folder: str) -> ExperimentConfig:
    """Return BenchMARL's own defaults with the sizes of this benchmark, and nothing but training."""
    config = ExperimentConfig.get_from_yaml()
    config.share_policy_params = False
    config.max_n_iters, config.max_n_frames = 1, None
    config.off_policy_collected_frames_per_batch = options.capacity
    config.off_policy_init_random_frames = options.capacity
    config.off_policy_n_envs_per_worker = ENVIRONMENTS
    config.off_policy_n_optimizer_steps = WARM_UP + options.updates + 1
    config.off_policy_train_batch_size = options.batch
    config.off_policy_memory_size = options.capacity
    config.evaluation, config.render, config.loggers, config.create_json = False, False, [], False
    config.save_folder = folder
    return config


def measure(name: str, form: str, task: dict[str, Any], width: int, options: argparse.Namespace) -> dict[str, Any]:
    """Return one line of the result."""
    algorithm = ALGORITHMS[name].get_from_yaml()
    algorithm.share_param_critic = False
    model = MlpConfig(num_cells=[width, width], layer_class=torch.nn.Linear, activation_class=torch.nn.ReLU)
    watch = Watch()
    with tempfile.TemporaryDirectory() as folder:
        experiment = Experiment(
            task=NoiseTask("noise", task),
            algorithm_config=algorithm,
            model_config=model,
            critic_model_config=MlpConfig(**vars(model)),
            seed=0,
            config=configuration(options, folder),
            callbacks=[watch],
        )
        experiment.run()
    bursts = {group: sorted(bursts_of(moments[WARM_UP:])) for group, moments in watch.moments.items()}
    if any(len(buffer) != options.capacity for buffer in experiment.replay_buffers.values()):
        raise RuntimeError("a replay buffer is not full.")
    return {
        "software": "BenchMARL",
        "algorithm": name,
        "form": form,
        "width": width,
        "agents": sum(count for _, count, _, _ in task["groups"]),
        "threads": options.threads,
        "ms": sum(times[0] for times in bursts.values()),
        "median_ms": sum(times[len(times) // 2] for times in bursts.values()),
        "parameters": sum(
            parameter.numel()
            for optimisers in experiment.optimizers.values()
            for optimiser in optimisers.values()
            for part in optimiser.param_groups
            for parameter in part["params"]
        ),
    }


def main() -> None:
    """Measure and print."""
    options = learner_options("BenchMARL").parse_args()
    torch.set_num_threads(options.threads)
    tasks = forms(parse_groups(options.groups))
    lines = [
        measure(name, form, task, width, options)
        for width in options.widths
        for name in ALGORITHMS
        for form, task in tasks.items()
    ]
    hand_over(lines, "benchmarl", "torchrl", "tensordict", "torch")


if __name__ == "__main__":
    main()
