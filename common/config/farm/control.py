"""How an actor's output becomes a velocity command."""

from dataclasses import dataclass
from typing import Literal

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
