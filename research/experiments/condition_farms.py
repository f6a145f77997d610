"""The farms of `research.experiments.conditions`, and the runs that train their policies."""

from dataclasses import replace
from typing import Final

from eia_sec.common.config import RunConfig
from eia_sec.common.config.files import from_toml
from eia_sec.common.config.presets import preset

CONDITIONS: Final[dict[str, tuple[str, str]]] = {
    "instant": ("instant", ""),
    "links 150 m": ("connected", "[farm.relay]\nlink_range = 150.0"),
    "links 100 m": ("connected", ""),
    "links 70 m": ("connected", "[farm.relay]\nlink_range = 70.0"),
    "links 50 m": ("connected", "[farm.relay]\nlink_range = 50.0"),
    "failures, 2 an hour": ("failing", "[farm.failures]\nper_hour = 2.0"),
    "failures, 6 an hour": ("failing", ""),
    "links 70 m, failures, 2 an hour": (
        "failing",
        "[farm.relay]\nrequire_link = true\nlink_range = 70.0\n[farm.failures]\nper_hour = 2.0\n"
        "[farm.control]\ncollection_inset = 0.36\n[farm.observation]\nlink = true\n[farm.reward]\nrelayed = 0.2\n"
        "[algorithm]\ndiscounts = {}\nentropy_scales = {communication = 1.0, collection = 0.1}",
    ),
    "team 2 + 2 + 2": (
        "instant",
        "[farm.world]\ncommunication_uavs = 2\nmonitoring_uavs = 2\ncollection_uavs = 2",
    ),
    "team 8 + 8 + 8": (
        "instant",
        "[farm.world]\ncommunication_uavs = 8\nmonitoring_uavs = 8\ncollection_uavs = 8",
    ),
    "280 m by 280 m": (
        "instant",
        "[farm.world]\nfield_x = 280.0\nfield_y = 280.0\nplots_x = 14\nplots_y = 14\nsensors = 200",
    ),
    "560 m by 560 m": (
        "instant",
        "[farm.world]\nfield_x = 560.0\nfield_y = 560.0\nplots_x = 28\nplots_y = 28\nsensors = 800",
    ),
    "patches of stress": ("uneven", ""),
    "batteries": ("battery", ""),
    "wind 3 m/s": ("instant", "[farm.wind]\nspeed = 3.0\ngusts = 1.5\n[farm.observation]\nwind = true"),
    "no-fly zones": ("instant", "[farm.zones]\nrandom = 3\n[farm.observation]\nzones = true"),
    "all of them": ("field", ""),
    "clustered sensors": ("instant", '[farm.world]\ndensity = "clustered"'),
}
"""Each farm by its name: a preset, and what differs from it."""
LONGER: Final = {"instant": "long"}
"""The preset of a condition's policy that learns longer, where it is not the condition's own."""
_FRESH: Final = """
[algorithm]
start_policy = {}
entropy_scales = {monitoring = 1.0}
"""
_LONG: Final = f"episodes = 2000{_FRESH}"
AFRESH: Final = {"team 2 + 2 + 2": _FRESH, "no-fly zones": _LONG, "wind 3 m/s": _LONG}
"""Settings of longer policies that begin afresh: what the preset begins as does not fit a small team, flies into zones,
and observes no wind."""


def configuration(name: str, episodes: int, seed: int) -> RunConfig:
    """Return the run of a condition."""
    base, changes = CONDITIONS[name]
    return replace(from_toml(changes, preset(base)), episodes=episodes, seed=seed)


def longer_configuration(name: str, seed: int) -> RunConfig:
    """Return the run of a condition's policy that learns longer."""
    config = from_toml(CONDITIONS[name][1], preset(longer_preset(name)))
    return replace(from_toml(AFRESH.get(name, ""), config), seed=seed)


def longer_preset(name: str) -> str:
    """Return the preset of a condition's policy that learns longer."""
    base = CONDITIONS[name][0]
    return LONGER.get(base, base)
