"""Names of the numbers that an actor sees and returns, for people who use it outside this project."""

from common.config import RunConfig
from common.team import COLLECTION, COMMUNICATION, MONITORING, GroupSpec


def observation_names(config: RunConfig, group: GroupSpec) -> list[str]:
    """Return a name for each number of an observation, in order (W24; scales are in `docs/how-to/export.md`)."""
    if not config.env.is_farm:
        return [f"observation_{index}" for index in range(group.observation_size)]
    seen, uav = config.farm.observation, _offset("nearest_uav")
    rank = [f"rank_{index}" for index in range(group.count)] if seen.identity else []
    last = [*rank, *(["clock"] if seen.clock else [])]
    place = ["x", "y", *(["sign_x", "sign_y"] if seen.mirrored else [])]
    if group.name == COMMUNICATION:
        parts = ("nearest_relay", "relay_centroid", "served_centroid", "farthest_served")
        return [*place, *(name for part in parts for name in _offset(part)), *uav, *last]
    if group.name == MONITORING:
        around = range(-(seen.window // 2), seen.window // 2 + 1)
        vdf = [f"vdf_{column}_{row}" for column in around for row in around]
        lattice = ["plot_dx", "plot_dy"] if seen.lattice else []
        return [*place, *vdf, "d_vdf_x", "d_vdf_y", *uav, *lattice, *last]
    ends = ("aoi",) if seen.form == "printed" else ("aoi", "dx", "dy")
    sensors = [f"sensor_{index}_{end}" for index in range(seen.sensors) for end in ends]
    return [*place, *sensors, "d_aoi_x", "d_aoi_y", *uav, *last]


def action_names(config: RunConfig, group: GroupSpec) -> list[str]:
    """Return a name for each number of an action, in order."""
    if config.env.is_farm and group.name in (COMMUNICATION, MONITORING, COLLECTION):
        return ["velocity_x", "velocity_y"]
    return [f"action_{index}" for index in range(group.action_size)]


def action_scale(config: RunConfig, group: GroupSpec) -> list[float] | None:
    """Return what an action of 1 means: m/s on the farm; None where -1..1 is the whole range of the environment's."""
    world = config.farm.world
    return [world.speed_x_max, world.speed_y_max] if config.env.is_farm else None


def _offset(name: str) -> list[str]:
    return [f"{name}_{end}" for end in ("dx", "dy", "distance")]
