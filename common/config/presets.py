"""The presets: what trains best, a smoke run, what the studies compare methods with, and the paper as printed.

The study preset is what the dataclasses say. It stays as it is: the studies' finished runs were made with it, and the
plain farm that other people's programs see through PettingZoo and Gymnasium is its farm. The default preset stands on
top of it and is what was found since (docs/explanation/method.md).

The paper preset names every printed value of the method, so that tuning the defaults leaves it alone. Where the
printed thing cannot work at all the correction stays: the signs of W1 and W8, the rule of A1, evaluation on farms
that training never saw (W26). What the paper does not give (marked "(ours)" in the dataclasses) is theirs.
"""

from dataclasses import replace
from typing import Final

from common.config.control import ControlConfig
from common.config.farm import EnergyConfig, FarmConfig, ObservationConfig
from common.config.learning import AlgorithmConfig, EliteConfig, ExplorationConfig, ReplayConfig
from common.config.run import EvaluationConfig, LearnerConfig, RunConfig
from common.errors import ConfigError


def _default() -> RunConfig:
    """Return what trains best in a time that one waits for."""
    return RunConfig(
        episodes=400,
        farm=FarmConfig(observation=ObservationConfig(mirrored=True)),
        algorithm=AlgorithmConfig(potential_discount=0.995),
        replay=ReplayConfig(updates_per_step=0.5),
    )


def _paper() -> RunConfig:
    """Return the paper's Table 2 with the printed forms of W5, W24, A7, A8, A9 and A10."""
    return RunConfig(
        episodes=2000,
        farm=FarmConfig(
            energy=EnergyConfig(model="printed"),
            observation=ObservationConfig(
                form="printed",
                choice="nearest",
                window=3,
                lattice=False,
                mirrored=False,
                identity=False,
                clock=False,
            ),
            control=ControlConfig(communication="velocity", monitoring="velocity", collection="velocity"),
        ),
        algorithm=AlgorithmConfig(
            discount=0.99,
            batch=128,
            actor_rate=1e-4,
            critic_rate=1e-5,
            target_rate=0.005,
            reward_scale=1.0,
            potential_discount=0.0,
            ensemble=True,
            ensemble_members=2,
            mixture_epsilon=0.1,
            ensemble_loss="mixture",
            ensemble_gradient=True,
            ensemble_copy_rate=0.1,
            bootstrap="local",
            target_actor=False,
            actor_objective="local",
            critic_scope="local",
        ),
        elite=EliteConfig(
            enabled=True, rate=0.1, cycle=10, rate_decay=0.5, cycle_growth=2.0, rule="cycle_divides_episode", farms=1
        ),
        replay=ReplayConfig(capacity=2**16, updates_per_step=1.0),
        exploration=ExplorationConfig(start=0.2, end=0.05, decay_share=0.6),
    )


def _quick() -> RunConfig:
    """Return a run of 72 episodes that shows every process at work and ends in a minute or two on two cores."""
    return replace(
        _default(),
        episodes=72,
        elite=EliteConfig(cycle=8, farms=2),
        replay=ReplayConfig(capacity=16_384, warmup_steps=2_000, updates_per_step=0.125, slack_steps=2_000),
        learner=LearnerConfig(checkpoint_seconds=15.0),
        evaluation=EvaluationConfig(farms=4),
    )


PRESETS: Final[dict[str, RunConfig]] = {
    "default": _default(),
    "quick": _quick(),
    "study": RunConfig(),
    "paper": _paper(),
}
"""Every preset by name."""
WRITTEN: Final = "study"
"""The preset on which files stand that a program wrote in whole: what one leaves out, its writer did not know."""


def preset(name: str) -> RunConfig:
    """Return the preset of that name; raise ConfigError when there is none."""
    if name not in PRESETS:
        raise ConfigError(f"there is no preset {name!r}; the presets are {', '.join(PRESETS)}.")
    return PRESETS[name]
