"""How UAVs reach the velocities that are commanded: at once, or as an autopilot flies them."""

from dataclasses import dataclass
from typing import ClassVar, Final, Literal

from eia_sec.common.config.checks import not_negative, positive
from eia_sec.common.errors import ConfigError

TYPES: Final = 3
"""Types of UAVs: communication, monitoring and data collection."""


@dataclass(frozen=True)
class DynamicsConfig:
    """Flight between two commands; each number is one for all types, or one for each in the order of the team.

    Defaults are those of PX4's parameters, whose reference is docs.px4.io, Parameter Reference, Multicopter Position
    Control. PX4's trajectory generator limits every axis by itself, and so does the farm.
    """

    model: Literal["instant", "inertial"] = "instant"
    """instant: a commanded velocity is reached at once, as in the paper; inertial: with limited acceleration and jerk,
    after a delay (ours)."""
    acceleration: tuple[float, ...] = (3.0,)
    """Largest acceleration along each axis, m/s2; 3 is PX4's MPC_ACC_HOR (ours)."""
    jerk: tuple[float, ...] = (4.0,)
    """Largest change of it, m/s3; 4 is PX4's MPC_JERK_AUTO, that of autonomous modes (ours)."""
    delay: tuple[float, ...] = (0.1,)
    """Time from a command until the vehicle follows it, s, at most a step; 0.1 fitted a flight of
    rotorpy's multirotor best, see `research.benchmarks.dynamics` (ours)."""
    speed: tuple[float, ...] = (8.4,)
    """Top speed over ground along each axis, m/s; at 8.4 along both, PX4's MPC_XY_VEL_MAX of 12 m/s holds (ours)."""
    airspeed: ClassVar[tuple[float, ...]] = (12.0,)
    """Top speed through the air along each axis, m/s (ours)."""

    def __post_init__(self) -> None:
        """Refuse UAVs that cannot move, and numbers of no type."""
        for name in ("acceleration", "jerk", "delay", "speed"):
            numbers = getattr(self, name)
            if len(numbers) not in (1, TYPES):
                raise ConfigError(f"dynamics.{name} must be one number, or one for each of the {TYPES} types.")
            for number in numbers:
                (not_negative if name == "delay" else positive)(**{f"dynamics.{name}": number})

    @property
    def inertial(self) -> bool:
        """Whether UAVs need time to change their velocity."""
        return self.model == "inertial"

    def of_types(self, name: str) -> tuple[float, ...]:
        """Return one of the numbers for each type."""
        numbers: tuple[float, ...] = getattr(self, name)
        return tuple(map(float, numbers * TYPES if len(numbers) == 1 else numbers))

    def check(self, step_seconds: float) -> None:
        """Refuse commands that would be followed only after the next.

        Raises:
            ConfigError: the delay is longer than a step.
        """
        if self.inertial and max(self.delay) > step_seconds:
            raise ConfigError(f"dynamics.delay {max(self.delay):g} exceeds the step of {step_seconds:g} s.")
