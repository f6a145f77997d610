"""What the agents of the farm see."""

from dataclasses import dataclass
from typing import ClassVar, Literal

from eia_sec.common.config.checks import within
from eia_sec.common.errors import ConfigError


@dataclass(frozen=True)
class ObservationConfig:
    """What the agents see."""

    sensors: int = 10
    """Sensors that a data collection UAV sees, n (ours)."""
    choice: Literal["waiting", "nearest"] = "waiting"
    """waiting: the nearest that hold data (AoI of 1 or more), then empty ones; nearest: the nearest of all (ours)."""
    form: Literal["default", "printed"] = "default"
    """default: AoI and relative (dx, dy) of each observed sensor; printed: AoI only (W24)."""
    window: int = 9
    """Side of the square of plots whose VDF a monitoring UAV sees, in plots; odd; the paper's is 3."""
    lattice: bool = True
    """Whether a monitoring UAV sees its offset from the centre of its plot, in units of half a plot (ours)."""
    mirrored: bool = True
    """Whether each UAV has axes of its own, on which its position (a monitor's: in its plot) is positive (ours)."""
    identity: bool = True
    """Whether an agent sees its index in its type, 1 of n_v, so that equal actors can divide the work. Without it, an
    actor that a type's agents share flies any number of them (ours)."""
    clock: bool = True
    """Whether an agent sees the elapsed share of the episode (ours)."""
    peers: int = 3
    """Nearest UAVs of its type whose offset, last velocity and presence an agent sees, 0 to 63 (ours)."""
    last_move: bool = True
    """Whether an agent sees its own last velocity, as a share of full speed (ours)."""
    closing: bool = True
    """Whether monitors and collectors see the risk SR that each of nine moves would bring near their peers (ours)."""
    units: int = 2
    """Moves for which monitors and collectors see the units that each of nine would bring: 0, 1 or 2 (ours)."""
    plan: int = 0
    """Steps that plans of monitors and collectors look ahead, 0 to 64. For each of nine moves they see what the best
    plan that begins with it is worth. Monitors with a route see it in the last steps only, three times as many, and
    their route's mark is then the best plan's. Fresh actors of moves favour those whose plans are best (ours)."""
    plan_paths: ClassVar[int] = 54
    """Plans that the search for them keeps (ours)."""
    fields: bool = True
    """Whether monitors and collectors see where their own share of the task lies, near and far (ours)."""
    coarse: bool = True
    """Whether monitors and collectors see coarse maps of VDF and AoI around them (ours)."""
    phases: bool = True
    """Whether agents see the phase of their counters' cycles, and the last 25 and 100 steps run down (ours)."""
    route: bool = True
    """Whether a monitoring UAV sees which of nine moves follows its sweep route, and the next plots on it. Fresh actors
    of its moves begin with following it (ours)."""
    service: bool = True
    """Whether a relay sees its D_c and what each of nine moves would do to it (ours)."""
    link: bool = False
    """Whether UAVs see their relay and the slack of the link to it, and relays that of the links to the UAVs that they
    serve, now and after each of nine moves (ours)."""
    wind: bool = False
    """Whether UAVs see the wind of the last step, as a share of full speed (ours)."""
    zones: bool = False
    """Whether UAVs see which of nine moves a no-fly zone would refuse (ours)."""

    stress: bool = False
    """Whether UAVs with tasks see where the patches of stress around them are that the team knows (ours)."""
    charge: bool = False
    """Whether UAVs see their charge, the way to the nearest station and what would be left there (ours)."""

    @property
    def added(self) -> bool:
        """Whether any observation is on that the paper does not have: those from `peers` on."""
        switches = (
            self.last_move,
            self.closing,
            self.fields,
            self.coarse,
            self.phases,
            self.route,
            self.service,
            self.link,
            self.stress,
            self.charge,
            self.wind,
            self.zones,
        )
        return self.peers > 0 or self.units > 0 or self.plan > 0 or any(switches)

    def __post_init__(self) -> None:
        """Refuse to observe no sensor, and a window without a centre."""
        within(1, 256, sensors=self.sensors)
        within(1, 31, window=self.window)
        within(0, 63, peers=self.peers)
        within(0, 2, units=self.units)
        within(0, 64, plan=self.plan)
        if self.window % 2 == 0:
            raise ConfigError(f"window must be odd, so that the UAV's own plot is in the middle, not {self.window}.")
