"""The method: actors, critics, the shared ensemble critic, elite imitation, replay and exploration."""

from dataclasses import dataclass
from typing import Final, Literal

from common.config.checks import finite, not_negative, positive, within
from common.errors import ConfigError

AlgorithmName = Literal["eia-sec", "eia", "sec", "base", "maddpg", "matd3", "masac"]
"""The registry of algorithms; each name is that of a class in `learner/algorithms`."""
WITH_ENSEMBLE: Final = ("eia-sec", "sec")
"""Algorithms with a shared ensemble critic."""
WITH_IMITATION: Final = ("eia-sec", "eia")
"""Algorithms whose agents imitate elites."""
LOCAL_CRITICS: Final = ("eia-sec", "eia", "sec", "base")
"""Algorithms whose critics see their own agent alone unless told otherwise (A11)."""


@dataclass(frozen=True)
class AlgorithmConfig:
    """The algorithm, its networks, losses and rates; readings A4 to A12, equations in docs/reference/algorithms.md."""

    name: AlgorithmName = "eia-sec"
    """The algorithm: EIA-SEC, its ablations without SEC (eia), without imitation (sec) and without both (base), or
    a peer. It takes the ensemble and imitation only where it has them and `ensemble` and `elite.enabled` are on."""
    hidden: int = 64
    """Width of both hidden layers of every network (ours)."""
    discount: float = 0.97
    """Discount rate gamma; the paper prints 0.99."""
    n_step: int = 1
    """Steps whose rewards stand in a target before it bootstraps, 1..10; cut at an episode's end."""
    batch: int = 128
    """Transitions in a batch, B."""
    actor_rate: float = 1e-3
    """Learning rate of the actors, r_a; the paper prints 1e-4."""
    critic_rate: float = 1e-3
    """Learning rate of the critics and of the SEC, r_c; the paper prints 1e-5."""
    target_rate: float = 0.005
    """Soft update parameter xi of the target networks, eq. (xt)."""
    reward_scale: float = 0.1
    """Factor on every reward before it enters a target (ours)."""
    potential_discount: float = 0.995
    """Discount gamma_s of the potential that shapes relays' rewards (`rollout.worker`); 0 for none (ours)."""
    reward_normalisation: bool = False
    """Divide each type's rewards by their running standard deviation, before `reward_scale` (ours)."""
    observation_normalisation: bool = False
    """Standardise each type's observations by their running mean and deviation; actors carry it (ours)."""
    gradient_clip: float = 0.0
    """Largest norm of one network's gradient; 0 for any (ours)."""
    ensemble: bool = True
    """Whether the shared ensemble critic takes part in eia-sec and sec; without it the mixture is the local critic."""
    ensemble_members: int = 2
    """Members of a type's SEC, k_s."""
    mixture_epsilon: float = 0.1
    """Share epsilon of the local critic in the mixture, eq. (value)."""
    ensemble_loss: Literal["member", "mixture"] = "member"
    """Each critic its own regression, or the printed loss on the mixture (A7)."""
    ensemble_gradient: bool = True
    """Whether the SEC takes gradient steps; without, it follows by the copy alone (A7)."""
    ensemble_copy_rate: float = 0.0
    """Parameter rate tau of the proportional copy, eq. (up2); the paper prints 0.1 (A7)."""
    bootstrap: Literal["mixture", "local"] = "mixture"
    """What the target bootstraps from: the mixture of targets, or the printed Q'_i alone (A8)."""
    target_actor: bool = False
    """Whether a target actor chooses the next action in EIA-SEC and its ablations (A5); MADDPG and MATD3 have one."""
    actor_objective: Literal["mixture", "local"] = "mixture"
    """What the actor climbs: the mixture, or the printed Q_i alone (A9)."""
    critic_scope: Literal["algorithm", "local", "joint"] = "algorithm"
    """Critics see their own observation and action, or those of all agents, or what the algorithm prefers: EIA-SEC
    and its ablations local, the peers joint (A11)."""
    others: Literal["batch", "policy", "team"] = "batch"
    """MADDPG, MATD3 and MASAC: where an actor climbs a joint critic, the others act as they did in the batch, as
    published, or as their actors would now; with team, each actor climbs the sum of all agents' critics there
    (Peng et al. 2021, FACMAC)."""
    initialisation: Literal["type", "independent"] = "type"
    """One initialisation for all agents of a type, or one for each (A4)."""
    actor_delay: int = 2
    """MATD3: critic steps for each step of actors and targets."""
    smoothing_noise: float = 0.2
    """MATD3: standard deviation of the noise on the target actors' actions."""
    smoothing_clip: float = 0.5
    """MATD3: largest such noise."""
    temperature: float = 1.0
    """MASAC: first weight alpha of each agent's entropy; rewards are scaled by `reward_scale`."""
    temperature_rate: float = 3e-4
    """MASAC: learning rate of log alpha; 0 keeps alpha as it is."""
    entropy_target: float = -1.0
    """MASAC: wanted entropy for each number in an action, nats."""

    def __post_init__(self) -> None:
        """Refuse rates and sizes that cannot learn."""
        within(1, 4096, hidden=self.hidden)
        within(1, 65_536, batch=self.batch)
        within(1, 10, n_step=self.n_step)
        within(0.0, 1.0, discount=self.discount, target_rate=self.target_rate, mixture_epsilon=self.mixture_epsilon)
        within(0.0, 1.0, potential_discount=self.potential_discount)
        within(0.0, 1.0, ensemble_copy_rate=self.ensemble_copy_rate)
        within(1, 64, ensemble_members=self.ensemble_members)
        positive(actor_rate=self.actor_rate, critic_rate=self.critic_rate, reward_scale=self.reward_scale)
        within(1, 1000, actor_delay=self.actor_delay)
        not_negative(gradient_clip=self.gradient_clip, temperature_rate=self.temperature_rate)
        not_negative(smoothing_noise=self.smoothing_noise, smoothing_clip=self.smoothing_clip)
        positive(temperature=self.temperature)
        finite(entropy_target=self.entropy_target)

    @property
    def uses_ensemble(self) -> bool:
        """Whether a shared ensemble critic takes part."""
        return self.ensemble and self.name in WITH_ENSEMBLE

    @property
    def has_imitation(self) -> bool:
        """Whether elite imitation is part of the algorithm."""
        return self.name in WITH_IMITATION

    @property
    def climbs_together(self) -> bool:
        """Whether every actor climbs the sum of all agents' critics; EIA-SEC and its ablations climb their own."""
        return self.others == "team" and self.joint_critics and self.name not in LOCAL_CRITICS

    @property
    def joint_critics(self) -> bool:
        """Whether critics see all agents."""
        return self.critic_scope == "joint" or (self.critic_scope == "algorithm" and self.name not in LOCAL_CRITICS)


@dataclass(frozen=True)
class EliteConfig:
    """Elite imitation: when, how strongly, and how agents are scored."""

    enabled: bool = True
    """Whether elites are imitated, in an algorithm that has imitation."""
    rate: float = 0.1
    """First update coefficient, vartheta*."""
    cycle: int = 10
    """First mimicry cycle factor delta*, episodes."""
    rate_decay: float = 0.5
    """Factor on vartheta after each event; the paper prints 1/2."""
    cycle_growth: float = 2.0
    """Factor on delta after each event; the paper prints 2."""
    rule: Literal["cycle_divides_episode", "printed"] = "cycle_divides_episode"
    """An event falls due when delta divides lambda, or as printed when lambda divides delta (A1)."""
    weight_mean: float = 1.0
    """beta_1, weight of the mean step reward in omega (ours)."""
    weight_variance: float = -0.1
    """beta_2, weight of the variance of the scaled step rewards in omega (ours)."""
    farms: int = 4
    """Noise-free evaluation episodes of one event, each on another training farm (ours)."""

    def __post_init__(self) -> None:
        """Refuse schedules that never come or never end."""
        within(0.0, 1.0, rate=self.rate, rate_decay=self.rate_decay)
        within(1, 1_000_000, cycle=self.cycle)
        within(1, 256, farms=self.farms)
        finite(weight_mean=self.weight_mean, weight_variance=self.weight_variance)
        if not 1.0 <= self.cycle_growth <= 1000.0:
            raise ConfigError(f"cycle_growth must be between 1 and 1000, not {self.cycle_growth}.")


@dataclass(frozen=True)
class ReplayConfig:
    """The replay buffer and the balance of production and consumption."""

    capacity: int = 65_536
    """Rows of the replay buffer; one row is one environment step of all agents, D = 2^16."""
    warmup_steps: int = 10_000
    """Environment steps before the first update; actions are uniform until then (ours)."""
    updates_per_step: float = 0.5
    """Update rounds per environment step of one farm; the paper's ratio is 1."""
    slack_steps: int = 4_000
    """Environment steps by which production may lead consumption before producers wait (ours)."""
    intake_chunks: int = 16
    """Chunks that the learner's intake queue holds at most (ours)."""
    max_age_versions: int = 0
    """Parameter versions by which a row may be older than the newest and still be drawn; 0 for any (ours)."""
    max_lag_versions: int = 0
    """Parameter versions by which the policy that flew a chunk may lag behind when it arrives; 0 for any (ours)."""

    def __post_init__(self) -> None:
        """Refuse buffers that cannot hold a batch."""
        within(256, 100_000_000, capacity=self.capacity)
        not_negative(
            warmup_steps=self.warmup_steps,
            max_age_versions=self.max_age_versions,
        )
        within(0.0, 1000.0, updates_per_step=self.updates_per_step)
        within(0, 2**31, max_lag_versions=self.max_lag_versions)
        within(1, 100_000_000, slack_steps=self.slack_steps)
        within(1, 65_536, intake_chunks=self.intake_chunks)
        if self.warmup_steps > self.capacity * 100:
            raise ConfigError("warmup_steps is far beyond what the replay buffer can hold.")


@dataclass(frozen=True)
class ExplorationConfig:
    """Gaussian exploration on the action, as a share of the action's range of 1."""

    start: float = 0.3
    """Standard deviation at the first episode (ours)."""
    end: float = 0.2
    """Standard deviation from decay_share of the run on (ours)."""
    decay_share: float = 0.6
    """Share of the run's episodes over which the deviation falls linearly (ours)."""

    def __post_init__(self) -> None:
        """Refuse negative noise."""
        not_negative(start=self.start, end=self.end)
        within(1e-6, 1.0, decay_share=self.decay_share)

    def deviation(self, progress: float) -> float:
        """Return the standard deviation at a progress of 0..1 of the run."""
        share = min(1.0, max(0.0, progress) / self.decay_share)
        return self.start + (self.end - self.start) * share
