"""What all algorithms share."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, make_dataclass, replace
from typing import ClassVar, Literal, Self, TypeVar, cast

from eia_sec.common.config.algorithms.network import NetworkConfig
from eia_sec.common.config.checks import not_negative, positive, within


@dataclass(frozen=True)
class AlgorithmConfig:
    """What all algorithms share: networks, rates, and how rewards are scaled.

    The agents of a type begin with equal parameters (A4).

    Attributes:
        sections: other sections of a configuration that the algorithm reads; see OPTIONAL_SECTIONS.
        discrete_actions: whether the algorithm can train types with discrete actions.
        continuous_actions: whether it can train those with continuous ones.
        unread: options of its family that the algorithm does not read.
        live: options that can change while the algorithm learns, as members of a population do with theirs.
    """

    sections: ClassVar[tuple[str, ...]] = ()
    discrete_actions: ClassVar[bool] = False
    continuous_actions: ClassVar[bool] = True
    unread: ClassVar[tuple[str, ...]] = ()
    live: ClassVar[tuple[str, ...]] = ("actor_rate", "critic_rate")

    name: str
    """The algorithm."""
    hidden: int = 64
    """Width of both hidden layers of every network (ours)."""
    discount: float = 0.97
    """Discount factor gamma of the return; the paper prints 0.99."""
    actor_rate: float = 1e-3
    """Learning rate of the actors, r_a; the paper prints 1e-4."""
    critic_rate: float = 1e-3
    """Learning rate of the critics and of the shared ensemble critic, r_c; the paper prints 1e-5."""
    reward_scale: float = 0.1
    """Factor on every reward before it enters a target (ours)."""
    potential_discount: float = 0.995
    """Discount gamma_s of the potential that shapes the relays' rewards; 0 for no shaping (ours)."""
    gradient_clip: float = 0.0
    """Largest norm of one network's gradient, on policy of that of a type's actors and of its values; 0 for no limit
    (ours)."""

    def __post_init__(self) -> None:
        """Refuse rates and sizes that cannot learn."""
        within(1, 4096, hidden=self.hidden)
        within(0.0, 1.0, discount=self.discount, potential_discount=self.potential_discount)
        positive(actor_rate=self.actor_rate, critic_rate=self.critic_rate, reward_scale=self.reward_scale)
        not_negative(gradient_clip=self.gradient_clip)

    def with_live(self, values: Mapping[str, float]) -> Self:
        """Return the options with other values of some that are `live`; raise ConfigError for an impossible one."""
        return replace(self, **dict(values))  # type: ignore[arg-type]  # every live option is a number

    def require_types(self, types: Sequence[str]) -> None:
        """Raise ConfigError where an option names a type of agent that the environment does not have.

        Args:
            types: the environment's types.
        """


Options = TypeVar("Options", bound=AlgorithmConfig | NetworkConfig)


def named(options: type[Options], name: str) -> type[Options]:
    """Return a class of options whose `name` is this one: the class itself, or one derived from it."""
    if next(field for field in fields(options) if field.name == "name").default == name:
        return options
    derived = make_dataclass(
        options.__name__,
        [("name", Literal[name], name)],
        bases=(options,),
        frozen=True,
        namespace={"__module__": options.__module__, "__doc__": options.__doc__},
    )
    return cast(type[Options], derived)
