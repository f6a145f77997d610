"""The farm as an environment: its team and its episode metrics."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

from eia_sec.common.actions.adapters import CENTRE, ActionAdapter, Headings, Lattice, MirroredAxes, NineMoves
from eia_sec.common.config import FarmConfig, RunConfig, WorldConfig
from eia_sec.common.config.environment import FARM
from eia_sec.common.environment import EnvironmentSpec, EpisodeMetric, TensorNames
from eia_sec.common.errors import ConfigError
from eia_sec.common.farm_observation import (
    COLLECTION,
    COMMUNICATION,
    MONITORING,
    PLAN,
    ROUTE,
    SOON,
    TYPES,
    nine_names,
    observation_names,
)
from eia_sec.common.team import GroupSpec, TeamSpec

__all__ = [
    "COLLECTION",
    "COMMUNICATION",
    "EPISODE_METRICS",
    "FAILED",
    "HEADING_SPEEDS",
    "LETTERS",
    "METRIC_NAMES",
    "MONITORING",
    "farm_environment",
    "farm_of",
    "farm_team",
    "inset_of",
    "lattice_of",
    "require_farm",
]

LETTERS: Final = {COMMUNICATION: "c", MONITORING: "m", COLLECTION: "d"}
"""The paper's letter for each type."""

HEADING_SPEEDS: Final = (0.041, 0.12, 0.35, 0.9)
"""Speeds of the control "headings" as shares of full speed: idle, slow, medium and fast (ours). The printed model needs
least power at the idle speed, 0.41 m/s at a full speed of 10 m/s."""

EPISODE_METRICS: Final = (
    EpisodeMetric("aoi", "units", "mean AoI over sensors and steps", "AoI", plotted=True, group=COLLECTION),
    EpisodeMetric("vdf", "units", "mean VDF over plots and steps", "VDF", plotted=True, group=MONITORING),
    EpisodeMetric(
        "collisions",
        "UAV steps",
        "spent closer than the collision distance to a UAV at the same height",
        "collisions",
        digits=1,
    ),
    EpisodeMetric("boundary", "UAV steps", "that ran against the field's edge", "boundary", digits=1),
    EpisodeMetric("energy_j", "J", "energy of all UAVs", "energy, kJ", digits=0, factor=1e-3),
)

FAILED: Final = EpisodeMetric("failed", "UAVs", "that had failed by the end", "failed", digits=1)
"""The metric of farms whose UAVs can fail."""

METRIC_NAMES: Final = tuple(metric.name for metric in EPISODE_METRICS)


def farm_environment(farm: FarmConfig) -> EnvironmentSpec:
    """Return a farm's description for generic code."""
    team = farm_team(farm)
    scale = farm.world.speed_x_max, farm.world.speed_y_max
    names = {name: TensorNames(observation_names(farm, name), ("velocity_x", "velocity_y"), scale) for name in TYPES}
    metrics = (*EPISODE_METRICS, *([FAILED] if farm.loses_uavs else []))
    return EnvironmentSpec(team, (farm.world.steps, farm.world.steps), metrics, LETTERS, names)


def farm_of(config: RunConfig) -> FarmConfig | None:
    """Return the farm of a run, or None if it trains in another environment."""
    return config.farm if config.env.name == FARM else None


def require_farm(config: RunConfig, complaint: str) -> FarmConfig:
    """Return the farm of a run, for a feature that works only with the farm.

    Args:
        config: the run.
        complaint: the error's sentence, with {} for the name of the other environment.

    Raises:
        ConfigError: the run trains in another environment.
    """
    if (farm := farm_of(config)) is None:
        raise ConfigError(complaint.format(config.env.name))
    return farm


def lattice_of(world: WorldConfig, inset: float = CENTRE) -> Lattice:
    """Return the lattice of a farm's moves, which end so far inside its cells. Its points lie alike in all plots."""
    return replace(Lattice.spanning(*world.reach, world.plots_x, world.plots_y), inset=inset)


def inset_of(farm: FarmConfig, name: str) -> float:
    """Return how far inside a cell the steps of a type end, as a share of the cell from its border."""
    return {MONITORING: farm.control.monitoring_inset, COLLECTION: farm.control.collection_inset}.get(name, CENTRE)


def farm_team(farm: FarmConfig) -> TeamSpec:
    """Return the team of a farm: communication, monitoring and data collection UAVs, in that order."""
    return TeamSpec(tuple(_group(farm, name, count) for name, count in zip(TYPES, farm.world.counts, strict=True)))


def _group(farm: FarmConfig, name: str, count: int) -> GroupSpec:
    """Return a type of UAVs with its control; raise ConfigError for UAVs too slow for any lattice."""
    names, control = observation_names(farm, name), getattr(farm.control, name)
    adapters: tuple[ActionAdapter, ...] = (MirroredAxes(),) if farm.observation.mirrored else ()
    if control == "lattice" or (control == "moves" and not farm.dynamics.inertial):
        adapters = (lattice_of(farm.world, inset_of(farm, name)), *adapters)
    if control == "moves":
        marks = (nine_names(ROUTE), nine_names(PLAN))
        hints = (-1, -1) if farm.dynamics.inertial else _task_hints(farm, names)
        moves = NineMoves(_suggestion(names, marks), *hints)
        return GroupSpec(name, count, len(names), 1, (moves, *adapters), (NineMoves.options,))
    if control == "headings":
        headings = Headings(*HEADING_SPEEDS, farm.world.reach[0], *_relay_hints(name, names))
        return GroupSpec(name, count, len(names), 1, (headings, *adapters), (Headings.options,))
    return GroupSpec(name, count, len(names), 2, adapters)


def _suggestion(names: Sequence[str], marks: Sequence[Sequence[str]]) -> int:
    """Return where an observation marks an option, by the first of `marks` that it has; -1 if it has none."""
    places = [_place(names, mark[0]) for mark in marks if mark]
    return next((place for place in places if place >= 0), -1)


def _task_hints(farm: FarmConfig, names: Sequence[str]) -> tuple[int, int]:
    """Return where a UAV with a task sees what moves serve, and how near they lead to others; else -1."""
    served = nine_names(f"units_{farm.observation.units}")[0]
    return _both(_place(names, served), _place(names, nine_names("risk_any")[0]))


def _relay_hints(name: str, names: Sequence[str]) -> tuple[int, int]:
    """Return where a relay sees what moves do to D_c, which its reward is charged with, and the steps left; else -1.

    The changes of D_c add up to D_c at the end minus that at the start, so only the last steps count.
    """
    if name != COMMUNICATION:
        return -1, -1
    return _both(_place(names, nine_names("service")[0]), _place(names, f"left_{SOON}"))


def _both(first: int, second: int) -> tuple[int, int]:
    """Return two places if there are both, else -1 twice."""
    return (first, second) if min(first, second) >= 0 else (-1, -1)


def _place(names: Sequence[str], wanted: str) -> int:
    """Return the index of one of an observation's numbers; -1 if it has none of that name."""
    return names.index(wanted) if wanted in names else -1
