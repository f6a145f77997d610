"""Elite imitation, the replay buffer and exploration: sections that an algorithm may read, see OPTIONAL_SECTIONS.

Learning rates and other options of the algorithms are in `eia_sec.common.config.algorithms`.
"""

from dataclasses import dataclass
from typing import ClassVar

from eia_sec.common.config.checks import not_negative, within
from eia_sec.common.errors import ConfigError


@dataclass(frozen=True)
class EliteConfig:
    """Elite imitation: its schedule, its strength, and how agents are scored."""

    enabled: bool = True
    """Whether agents imitate elites."""
    rate: float = 0.1
    """Blend factor of the first event, vartheta*: the share by which parameters move to the elite's."""
    cycle: int = 10
    """First mimicry cycle delta*, episodes; an event is due when delta divides the episode lambda (A1)."""
    rate_decay: float = 0.5
    """Factor on vartheta after each event; the paper prints 1/2."""
    cycle_growth: float = 2.0
    """Factor on delta after each event; the paper prints 2."""
    weight_mean: ClassVar[float] = 1.0
    """beta_1, weight of the mean step reward in omega (ours)."""
    weight_variance: ClassVar[float] = -0.1
    """beta_2, weight of the variance of the scaled step rewards in omega (ours)."""
    farms: int = 0
    """Noise-free evaluation episodes of one event, each on a different training farm, so at most `rollout.train_farms`;
    0 to score agents by the rewards of training itself (ours)."""

    def __post_init__(self) -> None:
        """Refuse impossible schedules and scores."""
        within(0.0, 1.0, rate=self.rate, rate_decay=self.rate_decay)
        within(1, 1_000_000, cycle=self.cycle)
        within(0, 256, farms=self.farms)
        within(1.0, 1000.0, cycle_growth=self.cycle_growth)


@dataclass(frozen=True)
class ReplayConfig:
    """The replay buffer, and the balance between collecting transitions and updating."""

    capacity: int = 65_536
    """Rows of the replay buffer; one row is one environment step of all agents, D = 2^16."""
    warmup_steps: int = 10_000
    """Environment steps before the first update; actions are uniform until then (ours)."""
    updates_per_step: float = 0.5
    """Updates per environment step of one farm; the paper's ratio is 1."""
    slack_steps: int = 4_000
    """Environment steps by which workers may lead the updates before they wait (ours)."""
    intake_chunks: int = 16
    """Most chunks in the learner's intake queue (ours)."""
    max_age_versions: int = 0
    """Largest age of a row's policy, in parameter versions: chunks of older ones are refused, and rows that have become
    older are no longer sampled; 0 for no limit (ours)."""

    def __post_init__(self) -> None:
        """Refuse buffers that cannot hold a batch."""
        within(256, 100_000_000, capacity=self.capacity)
        not_negative(
            warmup_steps=self.warmup_steps,
            max_age_versions=self.max_age_versions,
        )
        within(0.0, 1000.0, updates_per_step=self.updates_per_step)
        within(1, 100_000_000, slack_steps=self.slack_steps)
        within(1, 65_536, intake_chunks=self.intake_chunks)
        if self.warmup_steps > self.capacity * 100:
            raise ConfigError("warmup_steps is more than 100 times the capacity of the replay buffer.")


@dataclass(frozen=True)
class ExplorationConfig:
    """Gaussian noise on the actions, which are in [-1, 1]."""

    noise_std_start: float = 0.3
    """Standard deviation sigma of the noise at the first episode (ours)."""
    noise_std_end: float = 0.2
    """Standard deviation sigma from six tenths of the run on (ours)."""
    decay_share: ClassVar[float] = 0.6
    """Share of the run's episodes over which the standard deviation falls linearly (ours)."""

    def __post_init__(self) -> None:
        """Refuse negative noise."""
        not_negative(noise_std_start=self.noise_std_start, noise_std_end=self.noise_std_end)

    def noise_std(self, progress: float) -> float:
        """Return the standard deviation at a point of the run, from 0 (start) to 1 (end)."""
        share = min(1.0, max(0.0, progress) / self.decay_share)
        return self.noise_std_start + (self.noise_std_end - self.noise_std_start) * share
