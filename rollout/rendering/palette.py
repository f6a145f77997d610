"""Colours, markers and names that all pictures of the farm share. Nothing here needs a drawing library.

The colours of the types come from Okabe and Ito's palette, which suits every kind of colour vision. No picture relies
on colour alone: a marker, a line style or a label repeats each difference.
"""

from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from eia_sec.common.farm import COLLECTION, COMMUNICATION, MONITORING

LineStyle = Literal["-", "--", "-."]

TYPES: Final = (COMMUNICATION, MONITORING, COLLECTION)
"""The types in row order."""
COLOURS: Final = {COMMUNICATION: "#0072B2", MONITORING: "#D55E00", COLLECTION: "#009E73", "mean": "#000000"}
LABELS: Final = {
    "mean": "all agents",
    COMMUNICATION: "communication",
    MONITORING: "monitoring",
    COLLECTION: "data collection",
}
STYLES: Final[dict[str, LineStyle]] = {COMMUNICATION: "--", MONITORING: "-", COLLECTION: "-.", "mean": "-"}
END_MARKERS: Final = {COMMUNICATION: "P", MONITORING: "s", COLLECTION: "^"}
SENSOR_MARKERS: Final = ("o", "s", "^", "D", "v", "P", "X", "*")
"""Matplotlib's marker of each sensor type."""
BASE_MARKER: Final = "p"
"""Matplotlib's marker of the base station, a pentagon."""
AGE_MAP: Final = "viridis_r"
"""Matplotlib's colour map of AoI: fresh is yellow, old is dark."""
AGE_STOPS: Final = ("#FDE725", "#5EC962", "#21918C", "#3B528B", "#440154")
"""The same map at 0, 1/4, 1/2, 3/4 and 1, for drawing without matplotlib."""
SOIL_STOPS: Final = ("#FCF9F1", "#EBDCB9", "#CBAA75")
"""Colours of a plot from the freshest image to the oldest."""
ZONE: Final = "#B2182B"
"""Colour of a no-fly zone."""
STRESS: Final = "#AA3377"
"""Colour of patches and areas of stress."""
LINK_DOWN: Final = "#EE6677"
"""Colour of links that are out of range, or whose relay is not joined to the base station."""
GONE: Final = "#8A9296"
"""Colour of the cross on the page where a UAV has failed."""
PART_COLOURS: Final = ("#4477AA", "#BBBBBB", "#EE6677", "#AA3377", "#228833", "#66CCEE", "#CCBB44", "#994455")
"""Colours of a reward's parts in their order: Tol's "bright" set, legible on light and dark, and a dark red of his."""


def shade(stops: tuple[str, ...], share: NDArray[np.float64]) -> NDArray[np.uint8]:
    """Return colours between evenly spaced stops.

    Args:
        stops: colours as #RRGGBB.
        share: [...] position between the first stop (0) and the last (1).

    Returns:
        [..., 3] red, green and blue.
    """
    known = np.array([rgb(stop) for stop in stops], np.float64)
    places = np.linspace(0.0, 1.0, len(stops))
    mixed = np.stack([np.interp(share, places, known[:, channel]) for channel in range(3)], axis=-1)
    return np.rint(mixed).astype(np.uint8)


def rgb(colour: str) -> tuple[int, int, int]:
    """Return red, green and blue of #RRGGBB."""
    return int(colour[1:3], 16), int(colour[3:5], 16), int(colour[5:7], 16)
