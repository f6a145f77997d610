"""The farm as an environment: its team, the sizes of its observations, and its episode metrics."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

from eia_sec.common.actions.adapters import CENTRE, ActionAdapter, Headings, Lattice, MirroredAxes, NineMoves
from eia_sec.common.config import FarmConfig, RunConfig, WorldConfig
from eia_sec.common.config.environment import FARM
from eia_sec.common.config.farm.control import Control
from eia_sec.common.environment import EnvironmentSpec, EpisodeMetric, TensorNames
from eia_sec.common.errors import ConfigError
from eia_sec.common.team import GroupSpec, TeamSpec

COMMUNICATION: Final = "communication"
MONITORING: Final = "monitoring"
COLLECTION: Final = "collection"
LETTERS: Final = {COMMUNICATION: "c", MONITORING: "m", COLLECTION: "d"}
"""The paper's letter for each type."""

COMMUNICATION_OBSERVATION: Final = 17
"""Own (x, y); nearest relay, relay centroid, served centroid, farthest served, nearest UAV as (dx, dy, distance)."""
TASK_OBSERVATION: Final = 7
"""In addition to plots or sensors: own (x, y); D_VDF or D_AoI (x, y); nearest UAV as (dx, dy, distance)."""

HEADING_SPEEDS: Final = (0.041, 0.12, 0.35, 0.9)
"""Speeds of the control "headings" as shares of full speed: idle, slow, medium and fast (ours). The printed model needs
least power at the idle speed, 0.41 m/s at a full speed of 10 m/s."""

ADVICE: Final = "advice"
PLAN: Final = "plan"
ROUTE: Final = "route"
ROUTE_PLOTS: Final = 4
"""Plots on its sweep route that a monitoring UAV sees (ours)."""

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
    names = {group.name: _tensor_names(farm, group) for group in team.groups}
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
    per_sensor = 1 if farm.observation.form == "printed" else 3
    seen = farm.observation
    plots, sensors = seen.window**2 + 2 * seen.lattice, per_sensor * seen.sensors
    sizes = (
        (COMMUNICATION, farm.world.communication_uavs, COMMUNICATION_OBSERVATION, farm.control.communication),
        (MONITORING, farm.world.monitoring_uavs, TASK_OBSERVATION + plots, farm.control.monitoring),
        (COLLECTION, farm.world.collection_uavs, TASK_OBSERVATION + sensors, farm.control.collection),
    )
    return TeamSpec(
        tuple(
            _group(farm, name, count, size + 2 * seen.mirrored + len(_added(farm, name)) + _self(farm, count), control)
            for name, count, size, control in sizes
        )
    )


def _group(farm: FarmConfig, name: str, count: int, observation_size: int, control: Control) -> GroupSpec:
    """Return a type of UAVs with that control; raise ConfigError for UAVs too slow for any lattice."""
    adapters: tuple[ActionAdapter, ...] = (MirroredAxes(),) if farm.observation.mirrored else ()
    start = observation_size - _self(farm, count) - len(_added(farm, name))
    if control in ("lattice", "moves"):
        adapters = (lattice_of(farm.world, inset_of(farm, name)), *adapters)
    if control == "moves":
        marks = (_nine(ADVICE), _nine(ROUTE), _nine(PLAN))
        moves = NineMoves(_suggestion(farm, name, start, marks), *_task_hints(farm, name, start))
        return GroupSpec(name, count, observation_size, 1, (moves, *adapters), (NineMoves.options,))
    if control == "headings":
        suggestion = _suggestion(farm, name, start, (_advice(farm, name),))
        headings = Headings(*HEADING_SPEEDS, farm.world.reach[0], suggestion, *_relay_hints(farm, name, start))
        return GroupSpec(name, count, observation_size, 1, (headings, *adapters), (Headings.options,))
    return GroupSpec(name, count, observation_size, 2, adapters)


def _suggestion(farm: FarmConfig, name: str, start: int, marks: Sequence[Sequence[str]]) -> int:
    """Return where a type's observation marks an option, by the first of `marks` that it has; -1 if it has none.

    `start` is the index of the first added observation, here as below.
    """
    places = [_place(farm, name, start, names[0]) for names in marks if names]
    return next((place for place in places if place >= 0), -1)


def _task_hints(farm: FarmConfig, name: str, start: int) -> tuple[int, int]:
    """Return where a UAV with a task sees what moves serve, and how near they lead to others; else -1."""
    served = _nine(f"units_{farm.observation.units}")[0]
    return _both(_place(farm, name, start, served), _place(farm, name, start, _nine("risk_any")[0]))


def _relay_hints(farm: FarmConfig, name: str, start: int) -> tuple[int, int]:
    """Return where a relay sees what moves do to D_c, which its reward is charged with, and the steps left; else -1.

    The changes of D_c add up to D_c at the end minus that at the start, so only the last steps count.
    """
    reward = farm.reward
    if name != COMMUNICATION or reward.positioning <= 0.0 or reward.positioning_sign != "corrected":
        return -1, -1
    return _both(_place(farm, name, start, _nine("service")[0]), _place(farm, name, start, "left_25"))


def _both(first: int, second: int) -> tuple[int, int]:
    """Return two places if there are both, else -1 twice."""
    return (first, second) if min(first, second) >= 0 else (-1, -1)


def _place(farm: FarmConfig, name: str, start: int, wanted: str) -> int:
    """Return the index of one of a type's added observations; -1 if it has none of that name."""
    added = _added(farm, name)
    return start + added.index(wanted) if wanted in added else -1


def _self(farm: FarmConfig, count: int) -> int:
    """Return the number of inputs for the agent's identity and the clock."""
    return count * farm.observation.identity + farm.observation.clock


def _tensor_names(farm: FarmConfig, group: GroupSpec) -> TensorNames:
    """Return the names of a type's observations and actions (W24); docs/how-to/export.md has the scales."""
    seen, uav = farm.observation, _offset("nearest_uav")
    position = ["x", "y", *(["sign_x", "sign_y"] if seen.mirrored else [])]
    if group.name == COMMUNICATION:
        parts = ("nearest_relay", "relay_centroid", "served_centroid", "farthest_served")
        own = [*(name for part in parts for name in _offset(part)), *uav]
    elif group.name == MONITORING:
        around = range(-(seen.window // 2), seen.window // 2 + 1)
        vdf = [f"vdf_{column}_{row}" for column in around for row in around]
        own = [*vdf, "d_vdf_x", "d_vdf_y", *uav, *(["plot_dx", "plot_dy"] if seen.lattice else [])]
    else:
        ends = ("aoi",) if seen.form == "printed" else ("aoi", "dx", "dy")
        sensors = [f"sensor_{index}_{end}" for index in range(seen.sensors) for end in ends]
        own = [*sensors, "d_aoi_x", "d_aoi_y", *uav]
    rank = [f"rank_{index}" for index in range(group.count)] if seen.identity else []
    names = (*position, *own, *_added(farm, group.name), *rank, *(["clock"] if seen.clock else []))
    scale = farm.world.speed_x_max, farm.world.speed_y_max
    return TensorNames(names, ("velocity_x", "velocity_y"), scale)


def _added(farm: FarmConfig, name: str) -> list[str]:
    """Return the names of a type's added observations, in their order."""
    seen, task = farm.observation, name != COMMUNICATION
    ends = ("dx", "dy", "velocity_x", "velocity_y", "present")
    added = [f"peer_{rank}_{end}" for rank in range(seen.peers) for end in ends]
    added += ["last_velocity_x", "last_velocity_y"] if seen.last_move else []
    if task:
        added += [*_nine("risk_any"), *_nine("risk_same")] if seen.closing else []
        added += [unit for moves in range(1, seen.units + 1) for unit in _nine(f"units_{moves}")]
        added += [*_nine(PLAN), "plan_best"] if seen.plan else []
        added += [part for far in ("near", "far") for part in (*_nine(far), f"{far}_here")] if seen.fields else []
        added += _maps(name) if seen.coarse else []
    if seen.phases:
        cycles = {
            MONITORING: ["vdf_phase"],
            COLLECTION: [f"aoi_phase_{k}" for k in range(len(farm.world.sensor_cycles))],
        }
        added += [*cycles.get(name, []), "left_25", "left_100"]
    if seen.route and name == MONITORING:
        added += [*_nine(ROUTE), *(f"{ROUTE}_{plot + 1}_{end}" for plot in range(ROUTE_PLOTS) for end in ("dx", "dy"))]
    if seen.service and not task:
        added += ["service", *_nine("service")]
    if seen.link:
        added += _links(farm, task=task)
    if seen.stress and task:
        added += _square("block_stress", 5)
    added += ["charge", "station_dx", "station_dy", "charge_there"] if seen.charge else []
    added += ["wind_x", "wind_y"] if seen.wind else []
    added += _nine("refused") if seen.zones else []
    return [*added, *(["alive"] if farm.loses_in_flight else []), *_advice(farm, name)]


def _advice(farm: FarmConfig, name: str) -> list[str]:
    """Return the names of what the advised heuristic would do: a mark for each option, or a velocity."""
    if not farm.observation.advice:
        return []
    options = {"moves": _nine(ADVICE), "headings": [f"{ADVICE}_option_{k}" for k in range(Headings.options)]}
    control: Control = getattr(farm.control, name)
    return options.get(control, [f"{ADVICE}_velocity_x", f"{ADVICE}_velocity_y"])


def advice_sizes(farm: FarmConfig) -> tuple[int, ...]:
    """Return how many numbers of each type's observation say what the advised heuristic would do; see `_added`."""
    return tuple(len(_advice(farm, name)) for name in (COMMUNICATION, MONITORING, COLLECTION))


def advice_columns(farm: FarmConfig) -> tuple[slice, ...]:
    """Return where in each type's observation these numbers are: before the agent's identity and the clock."""
    groups = farm_team(farm).groups
    ends = [group.observation_size - _self(farm, group.count) for group in groups]
    return tuple(slice(end - size, end) for end, size in zip(ends, advice_sizes(farm), strict=True))


def _links(farm: FarmConfig, *, task: bool) -> list[str]:
    """Return the names of what a UAV with a task sees of its link, or a relay of the links to those that it serves."""
    chained = farm.relay.chained
    if task:
        return ["relay_dx", "relay_dy", "relay_slack", "relay_up", *_nine("slack"), *["relay_joined"] * chained]
    places = range(farm.relay.capacity_for(farm.world))
    served = [f"served_{place}_{end}" for place in places for end in ("dx", "dy", "slack", "present")]
    chain = ["base_dx", "base_dy", "joined", *_nine("joined")] if chained else []
    return [*served, *_nine("links_up"), *_nine("least_slack"), *chain]


def _maps(name: str) -> list[str]:
    """Return the names of a type's coarse maps."""
    if name == MONITORING:
        return [*_square("block_vdf", 5), *_square("block_stale", 5)]
    return [*_square("cell_aoi", 7), *_square("block_aoi", 5)]


def _square(name: str, side: int) -> list[str]:
    around = range(-(side // 2), side // 2 + 1)
    return [f"{name}_{column}_{row}" for column in around for row in around]


def _nine(name: str) -> list[str]:
    """Return a name for each of nine moves, in the order of `NineMoves`."""
    return _square(f"{name}_move", 3)


def _offset(name: str) -> list[str]:
    return [f"{name}_{end}" for end in ("dx", "dy", "distance")]
