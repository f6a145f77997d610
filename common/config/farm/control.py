"""How an actor's output becomes a velocity command."""

from dataclasses import dataclass
from typing import Literal

from eia_sec.common.config.checks import within

Control = Literal["velocity", "lattice", "moves", "headings"]
"""velocity: the output is the velocity, as printed; lattice: it selects one of nine points to fly to. The others are
discrete. moves: a choice among these nine points; headings: a choice among 24 velocities and idling."""


@dataclass(frozen=True)
class ControlConfig:
    """What the actors of each type command; heuristics and direct users of the farm command velocities (ours)."""

    communication: Control = "headings"
    """Output of the communication UAVs' actors: a velocity; one of nine points on a lattice, at most one step away
    (lattice, or moves as a discrete choice); or one of 25 velocities (headings) (ours)."""
    monitoring: Control = "moves"
    """The same for the monitoring UAVs (ours)."""
    collection: Control = "moves"
    """The same for the data collection UAVs (ours)."""
    monitoring_inset: float = 0.5
    """Where a monitoring UAV's step on the lattice ends, as a share of the selected cell from its border: at its centre
    (0.5), or at the nearest place so far inside, which is a shorter way (ours). A place from which images fail earns
    nothing: see docs/explanation/method.md before you lower it. Relays' steps always end at centres."""
    collection_inset: float = 0.5
    """The same for the data collection UAVs (ours)."""

    def __post_init__(self) -> None:
        """Refuse places outside the cell."""
        within(0.01, 0.5, monitoring_inset=self.monitoring_inset, collection_inset=self.collection_inset)
