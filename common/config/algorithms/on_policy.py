"""Algorithms that learn on policy: PPO for many agents (IPPO, MAPPO), and EIA-SEC's form of it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import ClassVar, Literal

from eia_sec.common.config.algorithms.base import AlgorithmConfig
from eia_sec.common.config.algorithms.network import MLP, NetworkConfig, network_named
from eia_sec.common.config.checks import not_negative, positive, within
from eia_sec.common.config.maps import FrozenMap, freeze, within_each
from eia_sec.common.errors import ConfigError

Memory = Literal["none", "gru"]
"""Kinds of memory; `eia_sec.common.gru` has the unit."""


@dataclass(frozen=True)
class OnPolicyConfig(AlgorithmConfig):
    """What PPO's forms share: iterations of collecting, estimating advantages and a few epochs of updates."""

    discrete_actions: ClassVar[bool] = True
    live: ClassVar[tuple[str, ...]] = (
        *AlgorithmConfig.live,
        "entropy_start",
        "entropy_end",
        "clip",
        "gae_lambda",
    )

    hidden: int = 64
    """Width of both hidden layers of every network, and of its state where it has memory (ours)."""
    discount: float = 0.99
    """Discount factor gamma of the return."""
    potential_discount: float = 1.0
    """Discount gamma_s of the potential that shapes the relays' rewards; 0 for no shaping (ours)."""
    gradient_clip: float = 0.5
    """Largest norm of the gradient of a type's actors, and of its value functions; off policy of one network; 0 for no
    limit."""
    iteration_steps: int = 16_000
    """Environment steps of an iteration; all updates of an iteration learn from the same steps."""
    epochs: int = 3
    """Passes over the steps of an iteration."""
    minibatch_steps: int = 1000
    """Environment steps in a minibatch; each holds a sample of every agent."""
    value_steps: int = 0
    """Environment steps at the start from which value functions alone learn, in whole iterations, so that they know the
    fresh policy before it changes (ours)."""
    start_policy: Mapping[str, str] = FrozenMap()
    """Policies that actors begin as, by type: trained, trained:long and so on, or a file; others begin fresh. Types may
    see more than their policy. With the single key all, each type that sees and chooses what the policy does begins as
    it. Value functions always begin fresh, so give them `value_steps` first."""
    suggestion_logits: Mapping[str, float] = FrozenMap()
    """How strongly an untrained policy prefers the moves that its observation marks, as a route or plans do, or else
    those that serve most: a logit for each type, 0 to 100; others have 4 (ours)."""
    clip: float = 0.2
    """Clip range of the ratio between the policy that learns and the one that `objective` names."""
    gae_lambda: float = 0.95
    """Decay lambda of generalised advantage estimation."""
    discounts: Mapping[str, float] = FrozenMap()
    """Discount factors by type; others have `discount`."""
    entropy_start: float = 0.02
    """Weight of the policies' entropy at the first episode."""
    entropy_end: float = 0.002
    """Weight of the policies' entropy at the last episode; in between it falls linearly."""
    entropy_scales: Mapping[str, float] = FrozenMap()
    """Factors on the weight of the policies' entropy by type, 0 to 1; others have 1."""
    rate_end: float = 0.05
    """Share of the learning rates that is left at the last episode; in between they fall linearly."""
    target_kl: float = 0.03
    """KL divergence from the policy that `objective` names beyond which an iteration's remaining updates of a type's
    actors are skipped; 0 for no limit."""
    objective: Literal["ppo", "decoupled"] = "decoupled"
    """Whether ratios are taken and clipped against the policy that acted, or against the newest one, with older steps
    weighted by how likely it is to act as they did (decoupled PPO). The latter learns as well from older chunks."""
    max_lag_versions: int = 1
    """Largest age of a chunk's policy when it is learned from, in parameter versions; 0 is strictly on policy."""
    shared_until: float = 1.0
    """Share of the run during which the agents of a type share one actor and one value function. Then each gets its
    own, at first a copy; 0 for separate ones from the beginning, 1 for shared ones to the end."""
    memory: Memory = "none"
    """Whether actors and value functions see the present observation alone, or remember earlier ones of the episode by
    a gated recurrent unit (gru) in place of their second hidden layer."""
    sequence_steps: int = 50
    """Steps through which gradients flow back in networks with memory; `rollout.chunk_steps` is a multiple of it."""
    hindsight: Mapping[str, float] = FrozenMap()
    """Shares of the task rewards that are paid as hindsight credit, what a visit was worth to the team, by type, 0 to
    1; others have 0 (ours)."""
    time_limit: Literal["terminal", "bootstrap"] = "terminal"
    """Whether the return ends with the time limit, as suits agents that see the clock, or is continued by the value."""
    normalise_observations: bool = False
    """Whether networks read each number of a type's observations minus its running mean, over its running deviation."""
    normalise_returns: bool = False
    """Whether value functions learn a type's returns minus their mean, over their deviation, both running (PopArt)."""
    precision: Literal["float32", "bfloat16"] = "bfloat16"
    """Precision of observations in rows, and of products in updates if the device has instructions for bfloat16.
    Parameters, sums and what the networks return are float32 in any case."""
    network: NetworkConfig = field(default_factory=NetworkConfig)

    def __post_init__(self) -> None:
        """Refuse what cannot learn."""
        super().__post_init__()
        within(1, 100_000_000, iteration_steps=self.iteration_steps)
        within(1, 1000, epochs=self.epochs)
        within(0, 10**9, value_steps=self.value_steps)
        within(1, 10_000_000, minibatch_steps=self.minibatch_steps)
        within(0.0, 1.0, gae_lambda=self.gae_lambda, rate_end=self.rate_end, shared_until=self.shared_until)
        positive(clip=self.clip)
        not_negative(target_kl=self.target_kl, entropy_start=self.entropy_start, entropy_end=self.entropy_end)
        within(0, 2**31, max_lag_versions=self.max_lag_versions)
        within(1, 10_000, sequence_steps=self.sequence_steps)
        if self.memory != "none" and self.minibatch_steps < self.sequence_steps:
            raise ConfigError(
                f"minibatch_steps {self.minibatch_steps} hold no sequence of sequence_steps {self.sequence_steps}."
            )
        if self.module is not None and self.memory != "none":
            raise ConfigError(f"memory {self.memory} is one of network {MLP}; {self.network.name} has none.")
        freeze(self, "start_policy", "suggestion_logits", "discounts", "entropy_scales", "hindsight")
        within_each(0.0, 1.0, discounts=self.discounts, entropy_scales=self.entropy_scales, hindsight=self.hindsight)
        within_each(0.0, 100.0, suggestion_logits=self.suggestion_logits)

    def require_types(self, types: Sequence[str]) -> None:
        """Raise ConfigError where an option names a type that the environment does not have."""
        for option in ("suggestion_logits", "discounts", "entropy_scales", "hindsight"):
            if unknown := [kind for kind in getattr(self, option) if kind not in types]:
                raise ConfigError(f"algorithm.{option} names {unknown[0]!r}, but the types are {', '.join(types)}.")

    def with_network(self, name: str) -> "OnPolicyConfig":
        """Return the options with those of another network; raise ConfigError where there is none of this name."""
        return replace(self, network=network_named(self.network, name))

    def rate_share(self, progress: float) -> float:
        """Return the share of the learning rates that is left at a finished share of the run."""
        return 1.0 + (self.rate_end - 1.0) * progress

    @property
    def module(self) -> NetworkConfig | None:
        """The options of a plug-in's network; None for the perceptrons of this package."""
        return None if self.network.name == MLP else self.network

    @property
    def bfloat16_observations(self) -> bool:
        """Whether rows store observations as bfloat16 numbers, the precision in which updates read them."""
        return self.precision == "bfloat16"

    @property
    def memory_size(self) -> int:
        """Numbers h in the state of one network with memory; 0 without memory."""
        return 0 if self.memory == "none" else self.hidden

    @property
    def shared(self) -> bool:
        """Whether the agents of a type share their networks at the beginning."""
        return self.shared_until > 0.0

    @property
    def sees_team(self) -> bool:
        """Whether value functions see the observations of all agents."""
        return False

    @property
    def ensemble_size(self) -> int:
        """Members of a type's shared ensemble of value functions; 0 without one."""
        return 0

    @property
    def local_weight(self) -> float:
        """Weight of an agent's own value function beside the ensemble's mean."""
        return 1.0


@dataclass(frozen=True)
class IppoConfig(OnPolicyConfig):
    """IPPO (de Witt et al. 2020): PPO for each agent, with a value function of its own observation."""

    name: Literal["ippo"] = "ippo"
    """The algorithm, which selects the options of this section."""


@dataclass(frozen=True)
class MappoConfig(OnPolicyConfig):
    """MAPPO (Yu et al. 2022): PPO for each agent, with value functions of all agents' observations."""

    name: Literal["mappo"] = "mappo"
    """The algorithm, which selects the options of this section."""

    @property
    def sees_team(self) -> bool:
        """Whether value functions see the observations of all agents."""
        return True


@dataclass(frozen=True)
class EiaPpoConfig(OnPolicyConfig):
    """EIA-SEC on policy: actors that imitate elites (section `elite`), and a shared ensemble of value functions.

    The agents of a type begin as one, the limit vartheta = 1 of imitation. From `shared_until` on each has an actor and
    a local value function, learns from its own data and imitates its elite. A type's ensemble of value functions is
    shared throughout.
    """

    sections: ClassVar[tuple[str, ...]] = ("elite",)

    name: Literal["eia-ppo"] = "eia-ppo"
    """The algorithm, which selects the options of this section."""
    shared_until: float = 0.8
    """Share of the run during which the agents of a type share one actor and one value function. Then each gets its
    own, at first a copy; 0 for separate ones from the beginning, 1 for shared ones to the end."""
    ensemble: bool = True
    """Whether the shared ensemble takes part; without it the value is the local one alone."""
    ensemble_members: int = 2
    """Members of a type's shared ensemble, k_s (1 to 64)."""
    mixture_epsilon: ClassVar[float] = 0.1
    """Weight epsilon of the local value in the mixture, eq. (value)."""

    def __post_init__(self) -> None:
        """Refuse an ensemble that cannot be."""
        super().__post_init__()
        within(1, 64, ensemble_members=self.ensemble_members)

    @property
    def ensemble_size(self) -> int:
        """Members of a type's shared ensemble of value functions; 0 without one."""
        return self.ensemble_members if self.ensemble else 0

    @property
    def local_weight(self) -> float:
        """Weight of an agent's own value function beside the ensemble's mean."""
        return self.mixture_epsilon if self.ensemble else 1.0
