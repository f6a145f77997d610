"""How an actor's output becomes a velocity."""

from dataclasses import dataclass
from typing import Literal

Control = Literal["velocity", "lattice"]
"""velocity: the output is the velocity, as printed; lattice: it names one of nine places to fly to."""


@dataclass(frozen=True)
class ControlConfig:
    """What the actors of each type command; heuristics and other users of the farm command velocities (ours)."""

    communication: Control = "velocity"
    """The communication UAVs' output: the velocity, or back, on or neither along x and y on a lattice whose places are
    one step apart (ours)."""
    monitoring: Control = "lattice"
    """The monitoring UAVs' (ours)."""
    collection: Control = "velocity"
    """The data collection UAVs' (ours)."""
