"""One run: environment, algorithm, processes and budget."""

import re
from dataclasses import dataclass, field, replace
from typing import ClassVar, Final

from eia_sec.common.config.algorithms import (
    OPTIONAL_SECTIONS,
    AlgorithmConfig,
    IppoConfig,
    OffPolicyConfig,
    OnPolicyConfig,
    ValueDecompositionConfig,
    switched,
)
from eia_sec.common.config.algorithms.network import NetworkConfig
from eia_sec.common.config.algorithms.on_policy import Memory
from eia_sec.common.config.checks import not_negative, positive, within
from eia_sec.common.config.environment import EnvConfig
from eia_sec.common.config.farm import FarmConfig
from eia_sec.common.config.maps import without_entries
from eia_sec.common.config.optional_sections import EliteConfig, ExplorationConfig, ReplayConfig
from eia_sec.common.config.plugin_names import NO_PLUGINS, PluginNames
from eia_sec.common.config.population import PopulationConfig
from eia_sec.common.errors import ConfigError

FIRST_UNSEEN: Final = 1000
"""Lowest seed of the farms of evaluations."""
_DEVICE: Final = re.compile(r"cpu|cuda(:(0|[1-9]\d{0,2}))?")


@dataclass(frozen=True)
class RolloutConfig:
    """A worker process, which simulates environments and sends chunks of transitions."""

    environments: int = 16
    """Environments of one worker, stepped as one batch."""
    chunk_steps: int = 500
    """Steps of each environment in one chunk of transitions. Workers that share an iteration may send shorter ones."""
    spool_chunks: int = 2
    """Unacknowledged chunks that a worker holds before it stops simulating."""
    train_farms: int = 20
    """Number of training farms, whose seeds are 0 to train_farms - 1 (W26); of scenario seeds in other environments."""
    threads: int = 1
    """Compute threads of one worker."""
    max_lag_versions: int = 0
    """Parameter versions by which a worker's actors may lag before it stops simulating; 0 for no limit."""
    max_silence_seconds: float = 0.0
    """Time without a message from the learner after which a worker stops simulating, s; 0 for no limit."""

    def __post_init__(self) -> None:
        """Refuse empty batches and chunks."""
        within(1, 4096, environments=self.environments)
        within(1, 10_000, chunk_steps=self.chunk_steps)
        within(1, 1024, spool_chunks=self.spool_chunks)
        within(1, 1_000_000, train_farms=self.train_farms)
        within(1, 256, threads=self.threads)
        within(0, 2**31, max_lag_versions=self.max_lag_versions)
        not_negative(max_silence_seconds=self.max_silence_seconds)

    def chunk_rows(self, ends: int) -> int:
        """Return the most rows of a chunk in which each environment ends `ends` episodes, at most one a step.

        Each environment has a row for each step and a last one. An episode that ends earlier in the chunk adds one.
        """
        return self.environments * (self.chunk_steps + 1 + min(ends, self.chunk_steps - 1))


@dataclass(frozen=True)
class LearnerConfig:
    """The learner process; these options affect its speed and rounding, not the method."""

    threads: int = 1
    """Compute threads of the learner."""
    update_threads: int = 2
    """Networks that learning on policy updates side by side on a processor, at most two for each type of agent."""
    device: str = "cpu"
    """Device of the networks: cpu, cuda, or cuda:1 for the second GPU."""
    publish_seconds: float = 0.5
    """Shortest time between two published parameter versions off policy, s. On policy and after imitation events they
    are published at once."""
    checkpoint_seconds: float = 60.0
    """Time between two checkpoints, s."""
    keep_checkpoints: ClassVar[int] = 2
    """Number of newest checkpoints that are kept."""

    def __post_init__(self) -> None:
        """Refuse impossible times and devices."""
        within(1, 256, threads=self.threads, update_threads=self.update_threads)
        if not _DEVICE.fullmatch(self.device):
            raise ConfigError(f"device must be cpu, cuda or cuda:NUMBER, not {self.device!r}.")
        positive(publish_seconds=self.publish_seconds, checkpoint_seconds=self.checkpoint_seconds)


@dataclass(frozen=True)
class EvaluationConfig:
    """The noise-free evaluation at the end of a run."""

    farms: int = 20
    """Number of evaluation farms, one episode each. Their seeds begin at 1000, or behind those of more training farms;
    training never sees them."""

    def __post_init__(self) -> None:
        """Refuse empty evaluations."""
        within(1, 100_000, farms=self.farms)


@dataclass(frozen=True)
class RunConfig:
    """Everything that determines a run's outcome, but for what stands in the files that it names."""

    seed: int = 0
    """Seed of the run; initial weights, batches, the order of farms and all noise follow from it."""
    episodes: int = 12_000
    """Training episodes lambda_max, in total over all environments of all workers; 0 where `steps` end the run."""
    steps: int = 0
    """Training steps of the environment, in total over all environments of all workers; 0 where `episodes` end the run.
    With both, the run ends with the first that is reached."""
    env: EnvConfig = field(default_factory=EnvConfig)
    farm: FarmConfig = field(default_factory=FarmConfig)
    algorithm: AlgorithmConfig = field(default_factory=IppoConfig)
    elite: EliteConfig = field(default_factory=EliteConfig)
    replay: ReplayConfig = field(default_factory=ReplayConfig)
    exploration: ExplorationConfig = field(default_factory=ExplorationConfig)
    rollout: RolloutConfig = field(default_factory=RolloutConfig)
    learner: LearnerConfig = field(default_factory=LearnerConfig)
    evaluation: EvaluationConfig = field(default_factory=EvaluationConfig)
    population: PopulationConfig = field(default_factory=PopulationConfig)
    plugins: PluginNames = NO_PLUGINS
    """Plug-ins that its processes load, as `--plugin` named them."""

    def __post_init__(self) -> None:
        """Refuse an empty run and sections that contradict each other."""
        within(0, 2**63 - 1, seed=self.seed)
        within(0, 100_000_000, episodes=self.episodes)
        within(0, 10**12, steps=self.steps)
        if not (self.episodes or self.steps):
            raise ConfigError("episodes and steps are both 0, and one of them ends the run.")
        for section in self.unused_sections:
            if getattr(self, section) != type(getattr(self, section))():
                raise ConfigError(f"{self.algorithm.name} does not read {section}; leave that section at its defaults.")
        if isinstance(self.algorithm, OffPolicyConfig):
            self._check_replay(self.algorithm.batch)
        self._check_hyperparameters()
        if self.memory != "none" and self.rollout.chunk_steps % self.on_policy.sequence_steps:
            raise ConfigError(
                f"rollout.chunk_steps {self.rollout.chunk_steps} must be a multiple of algorithm.sequence_steps "
                f"{self.on_policy.sequence_steps}, because networks with memory learn from whole sequences."
            )

    def _check_replay(self, batch: int) -> None:
        rows = max(2 * batch, self.rollout.chunk_rows(self.rollout.chunk_steps))
        if self.replay.capacity < rows:
            raise ConfigError(
                f"replay.capacity {self.replay.capacity} holds no batch of {batch} or no chunk of "
                f"{self.rollout.environments} times {self.rollout.chunk_steps} steps; it takes up to two rows for each."
            )

    def _check_hyperparameters(self) -> None:
        """Raise ConfigError unless the algorithm can change each while it learns, and its range fits the option."""
        for name, (low, high) in self.population.hyperparameters.items():
            if name not in self.algorithm.live:
                raise ConfigError(
                    f"population.hyperparameters names {name}, which {self.algorithm.name} cannot change while it "
                    f"learns; it can change {', '.join(self.algorithm.live)}."
                )
            for value in (low, high):
                self.algorithm.with_live({name: value})
            if not low <= (begun := getattr(self.algorithm, name)) <= high:
                raise ConfigError(
                    f"algorithm.{name} {begun:g}, with which member 0 begins, lies outside population.hyperparameters, "
                    f"{low:g} to {high:g}."
                )

    @property
    def network_seed(self) -> int:
        """Seed of the initial networks, which the members of a population share: imitation mixes their parameters."""
        return self.population.seed if self.population.members else self.seed

    def progress(self, episodes: int, steps: int) -> float:
        """Return the finished share of the run, 0 to 1.

        Args:
            episodes: training episodes finished.
            steps: environment steps that the learner has accepted.
        """
        shares = ((episodes, self.episodes), (steps, self.steps))
        return max(min(1.0, done / total) for done, total in shares if total)

    def with_algorithm(self, name: str) -> "RunConfig":
        """Return the run with another algorithm, see `switched`; sections that it does not read get their defaults.

        Raises:
            ConfigError: there is no such algorithm.
        """
        algorithm = switched(self.algorithm, name)
        unused = {each: type(getattr(self, each))() for each in OPTIONAL_SECTIONS if each not in algorithm.sections}
        return replace(self, algorithm=algorithm, **unused)

    def with_network(self, name: str) -> "RunConfig":
        """Return the run with another network, see `OnPolicyConfig.with_network`; off policy there is no other.

        Raises:
            ConfigError: there is no such network.
        """
        if not isinstance(self.algorithm, OnPolicyConfig):
            return self
        return replace(self, algorithm=self.algorithm.with_network(name))

    def with_environment(self, name: str) -> "RunConfig":
        """Return the run with another environment; maps by type are empty then, because its types are others.

        A worker holds one environment that others serve, because each may be a robot.

        Raises:
            ConfigError: the name cannot be read.
        """
        if name == self.env.name:
            return self
        env, algorithm = replace(self.env, name=name), self.algorithm
        rollout = replace(self.rollout, environments=1) if env.served else self.rollout
        return replace(self, env=without_entries(env), algorithm=without_entries(algorithm), rollout=rollout)

    def unseen(self, farms: int) -> range:
        """Return the seeds of so many farms, or scenarios, that training never sees."""
        first = max(FIRST_UNSEEN, self.rollout.train_farms)
        return range(first, first + farms)

    @property
    def unused_sections(self) -> tuple[str, ...]:
        """Sections that the algorithm does not read; they hold their defaults."""
        return tuple(section for section in OPTIONAL_SECTIONS if section not in self.algorithm.sections)

    @property
    def learns_on_policy(self) -> bool:
        """Whether the algorithm learns on policy, from rows with log-probabilities and without a replay buffer."""
        return isinstance(self.algorithm, OnPolicyConfig)

    @property
    def bfloat16_observations(self) -> bool:
        """Whether rows store observations as bfloat16 numbers."""
        return isinstance(self.algorithm, OnPolicyConfig) and self.algorithm.bfloat16_observations

    def exploration_at(self, progress: float, environment_steps: int) -> tuple[float, bool]:
        """Return how off-policy algorithms explore; those that learn on policy sample from their actors.

        Args:
            progress: finished share of the run.
            environment_steps: environment steps that the learner has accepted.

        Returns:
            the noise's standard deviation, or epsilon where values of options are learned; and whether actions are
            drawn uniformly instead (warm-up).
        """
        if self.learns_on_policy:
            return 0.0, False
        uniform = environment_steps < self.replay.warmup_steps
        if isinstance(self.algorithm, ValueDecompositionConfig):
            return self.algorithm.epsilon(progress), uniform
        return self.exploration.noise_std(progress), uniform

    @property
    def memory(self) -> Memory:
        """Kind of memory of the algorithm's networks."""
        return self.algorithm.memory if isinstance(self.algorithm, OnPolicyConfig) else "none"

    @property
    def memory_size(self) -> int:
        """Numbers h in the state of one network with memory; 0 without memory."""
        return self.algorithm.memory_size if isinstance(self.algorithm, OnPolicyConfig) else 0

    @property
    def module(self) -> NetworkConfig | None:
        """The options of a plug-in's network; None for the perceptrons of this package."""
        return self.algorithm.module if isinstance(self.algorithm, OnPolicyConfig) else None

    @property
    def imitates(self) -> bool:
        """Whether agents imitate elites."""
        return "elite" in self.algorithm.sections and self.elite.enabled

    @property
    def off_policy(self) -> OffPolicyConfig:
        """The algorithm's configuration, for algorithms that learn from a replay buffer.

        Raises:
            ConfigError: the algorithm does not.
        """
        if not isinstance(self.algorithm, OffPolicyConfig):
            raise ConfigError(f"{self.algorithm.name} does not learn from a replay buffer.")
        return self.algorithm

    @property
    def on_policy(self) -> OnPolicyConfig:
        """The algorithm's configuration, where it learns on policy.

        Raises:
            ConfigError: it does not.
        """
        if not isinstance(self.algorithm, OnPolicyConfig):
            raise ConfigError(f"{self.algorithm.name} does not learn on policy.")
        return self.algorithm
