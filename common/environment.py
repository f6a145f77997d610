"""What an environment declares about itself, so that generic code needs no knowledge of the farm."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

from eia_sec.common.team import TeamSpec


@dataclass(frozen=True)
class EpisodeMetric:
    """A number that an environment reports for each episode, besides rewards and steps.

    Attributes:
        name: its name in `EpisodeSummary.metrics`, in curves and in records.
        unit: its unit.
        meaning: one line of explanation.
        label: heading of its column in tables and of its curve in views.
        digits: decimals that tables and views show.
        factor: factor from `unit` to the unit in the heading.
        plotted: whether plots and live views show it.
        group: the type of agent whose colour it has in plots, or empty.
    """

    name: str
    unit: str
    meaning: str
    label: str
    digits: int = 2
    factor: float = 1.0
    plotted: bool = False
    group: str = ""

    @property
    def heading(self) -> str:
        """Its label with a unit."""
        return self.label if self.factor != 1.0 else f"{self.label}, {self.unit}"

    def text(self, value: float) -> str:
        """Return a value as tables show it."""
        return f"{value * self.factor:.{self.digits}f}"


@dataclass(frozen=True)
class TensorNames:
    """Names of the numbers in an observation and an action, for users of an exported policy.

    Attributes:
        observation: a name for each number of an observation, in order.
        action: a name for each number of an action, in order.
        action_scale: value of an action of 1 in the environment's unit, for each number; empty if it needs no scale.
    """

    observation: tuple[str, ...]
    action: tuple[str, ...]
    action_scale: tuple[float, ...] = ()


@dataclass(frozen=True)
class EnvironmentSpec:
    """What generic code knows about an environment.

    Attributes:
        team: types of agents, their sizes and their action adapters.
        episode_steps: fewest and most steps of an episode.
        episode_metrics: the metrics that it reports for each episode.
        short_names: names of one or two letters, by type of agent, for tables and views.
        tensor_names: names of the numbers in observations and actions, by type of agent.
    """

    team: TeamSpec
    episode_steps: tuple[int, int]
    episode_metrics: tuple[EpisodeMetric, ...] = ()
    short_names: Mapping[str, str] = field(default_factory=dict)
    tensor_names: Mapping[str, TensorNames] = field(default_factory=dict)

    @property
    def metric_names(self) -> tuple[str, ...]:
        """Names of the episode metrics."""
        return tuple(metric.name for metric in self.episode_metrics)

    def labels(self) -> dict[str, Any]:
        """Return the labels of rewards and episode metrics for live views, as plain values for a metric message."""
        return {
            "short_names": dict(self.short_names),
            "episode_metrics": [asdict(metric) for metric in self.episode_metrics],
        }
