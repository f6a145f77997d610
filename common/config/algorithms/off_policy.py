"""Algorithms that learn from a replay buffer: EIA-SEC as the paper describes it, MADDPG, MATD3, MASAC, VDN and QMIX."""

from dataclasses import dataclass
from typing import ClassVar, Literal

from eia_sec.common.config.algorithms.base import AlgorithmConfig
from eia_sec.common.config.checks import within


@dataclass(frozen=True)
class OffPolicyConfig(AlgorithmConfig):
    """What algorithms that learn from a replay buffer share besides."""

    sections: ClassVar[tuple[str, ...]] = ("replay", "exploration")
    joint_critics: ClassVar[bool] = False
    """Whether a critic sees the observations and actions of all agents, not its own agent's alone (A11)."""

    batch: int = 128
    """Transitions in a batch, B."""
    target_rate: float = 0.005
    """Soft update parameter xi of the target networks, eq. (xt)."""

    def __post_init__(self) -> None:
        """Refuse what cannot learn."""
        super().__post_init__()
        within(1, 65_536, batch=self.batch)
        within(0.0, 1.0, target_rate=self.target_rate)

    @property
    def uses_ensemble(self) -> bool:
        """Whether a shared ensemble critic takes part."""
        return False

    @property
    def follows_policies(self) -> bool:
        """Whether an actor's joint critic sees the other agents act by their present policies, not as in the batch."""
        return False

    @property
    def team_objective(self) -> bool:
        """Whether every actor maximises the sum of all agents' critics instead of its own critic."""
        return False


@dataclass(frozen=True)
class EiaSecConfig(OffPolicyConfig):
    """EIA-SEC: local critics, a shared ensemble critic (SEC) for each type, and elite imitation (section `elite`)."""

    sections: ClassVar[tuple[str, ...]] = ("replay", "exploration", "elite")

    name: Literal["eia-sec"] = "eia-sec"
    """The algorithm, which selects the options of this section."""
    ensemble: bool = True
    """Whether the shared ensemble critic takes part; without it the mixture is the local critic alone."""
    ensemble_members: int = 2
    """Members of a type's SEC, k_s (1 to 64)."""
    mixture_epsilon: ClassVar[float] = 0.1
    """Weight epsilon of the local critic in the mixture, eq. (value)."""
    ensemble_loss: Literal["member", "mixture"] = "member"
    """Whether each critic regresses to the target by itself, or the mixture does, as printed (A7)."""
    ensemble_gradient: bool = True
    """Whether the SEC takes gradient steps; without them it follows by the copy alone (A7)."""
    ensemble_copy_rate: float = 0.0
    """Rate tau of the proportional copy, eq. (up2); the paper prints 0.1 (A7)."""
    bootstrap: Literal["mixture", "local"] = "mixture"
    """Whether targets bootstrap from the mixture of target critics, or from Q'_i alone, as printed (A8)."""
    actor_objective: Literal["mixture", "local"] = "mixture"
    """Whether an actor maximises the mixture, or Q_i alone, as printed (A9)."""

    def __post_init__(self) -> None:
        """Refuse an ensemble that cannot be."""
        super().__post_init__()
        within(1, 64, ensemble_members=self.ensemble_members)
        within(0.0, 1.0, ensemble_copy_rate=self.ensemble_copy_rate)

    @property
    def uses_ensemble(self) -> bool:
        """Whether a shared ensemble critic takes part."""
        return self.ensemble


@dataclass(frozen=True)
class BaselineConfig(OffPolicyConfig):
    """What MADDPG, MATD3 and MASAC share: critics that see all agents."""

    joint_critics: ClassVar[bool] = True

    others: Literal["batch", "policy", "team"] = "batch"
    """In an actor's step, a joint critic sees the other agents act as in the batch, as published, or by their present
    policies; with team each actor also maximises the sum of all agents' critics (Peng et al. 2021, FACMAC)."""

    @property
    def follows_policies(self) -> bool:
        """Whether an actor's joint critic sees the other agents act by their present policies, not as in the batch."""
        return self.others != "batch"

    @property
    def team_objective(self) -> bool:
        """Whether every actor maximises the sum of all agents' critics instead of its own critic."""
        return self.others == "team"


@dataclass(frozen=True)
class MaddpgConfig(BaselineConfig):
    """MADDPG (Lowe et al. 2017): one joint critic and a target actor for each agent."""

    name: Literal["maddpg"] = "maddpg"
    """The algorithm, which selects the options of this section."""


@dataclass(frozen=True)
class Matd3Config(BaselineConfig):
    """MATD3 (Ackermann et al. 2019): two joint critics for each agent, delayed actor steps, smoothed target actions."""

    name: Literal["matd3"] = "matd3"
    """The algorithm, which selects the options of this section."""
    actor_delay: ClassVar[int] = 2
    """Critic steps for each step of actors and target networks."""
    smoothing_noise: ClassVar[float] = 0.2
    """Standard deviation of the noise on the target actors' actions, as a share of the action's range of 1."""
    smoothing_clip: ClassVar[float] = 0.5
    """Largest absolute value of that noise."""


@dataclass(frozen=True)
class MasacConfig(BaselineConfig):
    """MASAC: soft actor-critic (Haarnoja et al. 2018) with two joint critics for each agent."""

    name: Literal["masac"] = "masac"
    """The algorithm, which selects the options of this section."""
    temperature: ClassVar[float] = 1.0
    """Initial weight alpha of each agent's entropy; rewards are scaled by `reward_scale` first."""
    temperature_rate: ClassVar[float] = 3e-4
    """Learning rate of log alpha."""
    entropy_target: ClassVar[float] = -1.0
    """Target entropy for each number in an action, nats."""


@dataclass(frozen=True)
class ValueDecompositionConfig(OffPolicyConfig):
    """What VDN and QMIX share: values of options, whose mixture is the team's value; discrete actions only."""

    sections: ClassVar[tuple[str, ...]] = ("replay",)
    discrete_actions: ClassVar[bool] = True
    continuous_actions: ClassVar[bool] = False
    epsilon_share: ClassVar[float] = 0.3
    """Share of the run over which epsilon falls linearly (ours)."""

    discount: float = 0.99
    """Discount factor gamma of the return."""
    epsilon_start: float = 1.0
    """Probability epsilon with which a worker draws an option at random, at the beginning of the run."""
    epsilon_end: float = 0.05
    """Probability epsilon from three tenths of the run on."""

    def __post_init__(self) -> None:
        """Refuse what is no probability."""
        super().__post_init__()
        within(0.0, 1.0, epsilon_start=self.epsilon_start, epsilon_end=self.epsilon_end)

    def epsilon(self, progress: float) -> float:
        """Return epsilon at a point of the run, from 0 (start) to 1 (end)."""
        share = min(1.0, max(0.0, progress) / self.epsilon_share)
        return self.epsilon_start + (self.epsilon_end - self.epsilon_start) * share


@dataclass(frozen=True)
class VdnConfig(ValueDecompositionConfig):
    """VDN (Sunehag et al. 2018): the team's value is the sum of its agents' values."""

    live: ClassVar[tuple[str, ...]] = ("actor_rate",)
    unread: ClassVar[tuple[str, ...]] = ("critic_rate",)

    name: Literal["vdn"] = "vdn"
    """The algorithm, which selects the options of this section."""


@dataclass(frozen=True)
class QmixConfig(ValueDecompositionConfig):
    """QMIX (Rashid et al. 2018): a network that sees what all agents see mixes their values into the team's."""

    name: Literal["qmix"] = "qmix"
    """The algorithm, which selects the options of this section."""
    mixing_width: int = 32
    """Units of the layer in which the agents' values are mixed."""

    def __post_init__(self) -> None:
        """Refuse a layer without units."""
        super().__post_init__()
        within(1, 4096, mixing_width=self.mixing_width)
