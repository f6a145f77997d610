"""What an environment states about itself, and generic code uses in place of knowledge about the farm."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

from common.team import TeamSpec


@dataclass(frozen=True)
class EpisodeMetric:
    """A number that an environment reports of each episode, beside its rewards and its steps.

    Attributes:
        name: its name in `EpisodeSummary.metrics`, in curves and in records.
        unit: what it is measured in.
        meaning: what it is.
        label: heading of its column in tables and of its curve in views.
        digits: decimals that tables and views show.
        factor: what a table multiplies it with, for a heading in another unit.
        plotted: whether plots and live views show it.
        group: the type of agent whose colour it has in plots, if any.
    """

    name: str
    unit: str
    meaning: str
    label: str
    digits: int = 2
    factor: float = 1.0
    plotted: bool = False
    group: str = ""

    def text(self, value: float) -> str:
        """Return a value as tables show it."""
        return f"{value * self.factor:.{self.digits}f}"


@dataclass(frozen=True)
class TensorNames:
    """Names of the numbers in an observation and an action, for people who use a policy outside this project.

    Attributes:
        observation: a name for each number, in order.
        action: likewise.
        action_scale: what an action of 1 means, in the environment's unit; none where -1..1 is the whole range.
    """

    observation: tuple[str, ...]
    action: tuple[str, ...]
    action_scale: tuple[float, ...] = ()


@dataclass(frozen=True)
class EnvironmentSpec:
    """An environment, as generic code sees it.

    Attributes:
        team: types of agents, their sizes and their action adapters.
        episode_steps: fewest and most steps of an episode.
        episode_metrics: what it reports of each episode.
        short_names: for types of agents, names of a letter or two for tables and views.
        tensor_names: for types of agents, names of what they observe and do.
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
        """Return what a view needs to label rewards and episode metrics, as plain values for a metric message."""
        return {
            "short_names": dict(self.short_names),
            "episode_metrics": [asdict(metric) for metric in self.episode_metrics],
        }
