"""The base station and the hops of the relays that are joined to it, in matplotlib pictures."""

from typing import Final

from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.lines import Line2D

from eia_sec.common.config import FarmConfig
from eia_sec.common.farm import COMMUNICATION
from eia_sec.rollout.rendering.palette import BASE_MARKER, COLOURS
from eia_sec.rollout.rendering.scene import Scene, hop_lines
from eia_sec.rollout.sim.stations import base_place

INK: Final = "0.1"
WIDTH: Final = 1.6
"""Width of a hop's line, points."""


class ChainLines:
    """The base station and the hops on a map; nothing without a base station.

    Args:
        axes: the map.
        config: the farm.

    Attributes:
        artists: what is drawn.
    """

    def __init__(self, axes: Axes, config: FarmConfig) -> None:
        self.artists: tuple[Artist, ...] = ()
        if not config.relay.chained:
            return
        self._hops = LineCollection([], colors=COLOURS[COMMUNICATION], linewidths=WIDTH, linestyles="-.", zorder=2.9)
        axes.add_collection(self._hops)
        x, y = base_place(config)
        base = axes.scatter(
            [x], [y], marker=BASE_MARKER, s=300, color=INK, edgecolors="white", linewidths=1.0, clip_on=False, zorder=4
        )
        self.artists = self._hops, base

    def update(self, scene: Scene) -> None:
        """Show the hops of a scene."""
        if self.artists:
            self._hops.set_segments(hop_lines(scene.config, scene.position, scene.joined))


def chain_handles(config: FarmConfig) -> list[Artist]:
    """Return the legend's symbols of the base station and the hops; none without a base station."""
    if not config.relay.chained:
        return []
    base = Line2D([], [], color=INK, marker=BASE_MARKER, markersize=9, linestyle="", label="base station")
    label = f"hop to it, at most {config.relay.hop_range:g} m"
    return [base, Line2D([], [], color=COLOURS[COMMUNICATION], linestyle="-.", linewidth=WIDTH, label=label)]
