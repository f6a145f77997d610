"""Measured positions of sensors: their form in a configuration, and their checks."""

from typing import Final

from eia_sec.common.errors import ConfigError

Sites = tuple[tuple[float, ...], ...]
"""One (x, y) in m, or one (x, y, type), for each sensor; empty when the sensors are sampled."""

MAX_SENSORS: Final = 10_000
"""Most sensors of a farm."""


def check_sites(sites: Sites, sensors: int, field_x: float, field_y: float, types: int) -> None:
    """Refuse positions that a farm cannot have.

    Args:
        sites: the positions; none are always fine.
        sensors: the expected number of sensors.
        field_x: width of the field, m.
        field_y: depth of the field, m.
        types: number of sensor types.

    Raises:
        ConfigError: their number is wrong, one lies outside the field or has an unknown type, or two are equal.
    """
    if not sites:
        return
    if len(sites) != sensors:
        raise ConfigError(f"sites names {len(sites)} places, but sensors is {sensors}.")
    size = len(sites[0])
    for index, site in enumerate(sites):
        if len(site) not in (2, 3) or len(site) != size:
            raise ConfigError(f"sites[{index}] must be [x, y], or [x, y, type] as all others, not {list(site)[:4]}.")
        if not (0.0 <= site[0] <= field_x and 0.0 <= site[1] <= field_y):
            raise ConfigError(
                f"sites[{index}] ({site[0]:g}, {site[1]:g}) lies outside the field of {field_x:g} m x {field_y:g} m."
            )
        if size == 3 and site[2] not in range(types):
            raise ConfigError(f"sites[{index}] has type {site[2]:g}, but the types are 0 to {types - 1}.")
    if len({site[:2] for site in sites}) < len(sites):
        raise ConfigError("sites names one place twice.")
