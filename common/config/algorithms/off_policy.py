"""Algorithms that learn from a replay buffer: EIA-SEC as the paper describes it, MADDPG, MATD3 and MASAC."""

from dataclasses import dataclass
from typing import ClassVar, Literal

from eia_sec.common.config.algorithms.base import AlgorithmConfig
from eia_sec.common.config.checks import finite, not_negative, positive, within

CriticScope = Literal["local", "joint"]


@dataclass(frozen=True)
class OffPolicyConfig(AlgorithmConfig):
    """What algorithms that learn from a replay buffer share besides."""

    sections: ClassVar[tuple[str, ...]] = ("replay", "exploration")

    batch: int = 128
    """Transitions in a batch, B."""
    reward_normalisation: bool = False
    """Divide each type's rewards by their running standard deviation, before `reward_scale` (ours)."""
    observation_normalisation: bool = False
    """Standardise each type's observations by their running mean and standard deviation, which actors carry (ours)."""
    n_step: int = 1
    """Steps n whose rewards a target sums up before it bootstraps, 1 to 10; fewer at an episode's end."""
    target_rate: float = 0.005
    """Soft update parameter xi of the target networks, eq. (xt)."""

    def __post_init__(self) -> None:
        """Refuse what cannot learn."""
        super().__post_init__()
        within(1, 65_536, batch=self.batch)
        within(1, 10, n_step=self.n_step)
        within(0.0, 1.0, target_rate=self.target_rate)

    @property
    def joint_critics(self) -> bool:
        """Whether critics see all agents."""
        return False

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
    critic_scope: CriticScope = "local"
    """Whether a critic sees its own agent's observation and action (local) or those of all agents (joint) (A11)."""
    ensemble: bool = True
    """Whether the shared ensemble critic takes part; without it the mixture is the local critic alone."""
    ensemble_members: int = 2
    """Members of a type's SEC, k_s (1 to 64)."""
    mixture_epsilon: float = 0.1
    """Weight epsilon of the local critic in the mixture, eq. (value)."""
    ensemble_loss: Literal["member", "mixture"] = "member"
    """Whether each critic regresses to the target by itself, or the mixture does, as printed (A7)."""
    ensemble_gradient: bool = True
    """Whether the SEC takes gradient steps; without them it follows by the copy alone (A7)."""
    ensemble_copy_rate: float = 0.0
    """Rate tau of the proportional copy, eq. (up2); the paper prints 0.1 (A7)."""
    bootstrap: Literal["mixture", "local"] = "mixture"
    """Whether targets bootstrap from the mixture of target critics, or from Q'_i alone, as printed (A8)."""
    target_actor: bool = False
    """Whether a target actor chooses the next action in a target (A5)."""
    actor_objective: Literal["mixture", "local"] = "mixture"
    """Whether an actor maximises the mixture, or Q_i alone, as printed (A9)."""

    def __post_init__(self) -> None:
        """Refuse an ensemble that cannot be."""
        super().__post_init__()
        within(1, 64, ensemble_members=self.ensemble_members)
        within(0.0, 1.0, mixture_epsilon=self.mixture_epsilon, ensemble_copy_rate=self.ensemble_copy_rate)

    @property
    def joint_critics(self) -> bool:
        """Whether critics see all agents."""
        return self.critic_scope == "joint"

    @property
    def uses_ensemble(self) -> bool:
        """Whether a shared ensemble critic takes part."""
        return self.ensemble


@dataclass(frozen=True)
class BaselineConfig(OffPolicyConfig):
    """What MADDPG, MATD3 and MASAC share: critics that see all agents."""

    critic_scope: CriticScope = "joint"
    """Whether a critic sees its own agent's observation and action (local) or those of all agents (joint) (A11)."""
    others: Literal["batch", "policy", "team"] = "batch"
    """In an actor's step, a joint critic sees the other agents act as in the batch, as published, or by their present
    policies; with team each actor also maximises the sum of all agents' critics (Peng et al. 2021, FACMAC)."""

    @property
    def joint_critics(self) -> bool:
        """Whether critics see all agents."""
        return self.critic_scope == "joint"

    @property
    def follows_policies(self) -> bool:
        """Whether an actor's joint critic sees the other agents act by their present policies, not as in the batch."""
        return self.joint_critics and self.others != "batch"

    @property
    def team_objective(self) -> bool:
        """Whether every actor maximises the sum of all agents' critics instead of its own critic."""
        return self.joint_critics and self.others == "team"


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
    actor_delay: int = 2
    """Critic steps for each step of actors and target networks."""
    smoothing_noise: float = 0.2
    """Standard deviation of the noise on the target actors' actions, as a share of the action's range of 1."""
    smoothing_clip: float = 0.5
    """Largest absolute value of that noise."""

    def __post_init__(self) -> None:
        """Refuse negative noise and actors that never step."""
        super().__post_init__()
        within(1, 1000, actor_delay=self.actor_delay)
        not_negative(smoothing_noise=self.smoothing_noise, smoothing_clip=self.smoothing_clip)


@dataclass(frozen=True)
class MasacConfig(BaselineConfig):
    """MASAC: soft actor-critic (Haarnoja et al. 2018) with two joint critics for each agent."""

    name: Literal["masac"] = "masac"
    """The algorithm, which selects the options of this section."""
    temperature: float = 1.0
    """Initial weight alpha of each agent's entropy; rewards are scaled by `reward_scale` first."""
    temperature_rate: float = 3e-4
    """Learning rate of log alpha; 0 keeps alpha constant."""
    entropy_target: float = -1.0
    """Target entropy for each number in an action, nats."""

    def __post_init__(self) -> None:
        """Refuse temperatures that are none."""
        super().__post_init__()
        positive(temperature=self.temperature)
        not_negative(temperature_rate=self.temperature_rate)
        finite(entropy_target=self.entropy_target)
