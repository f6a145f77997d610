"""The state of the reference farm, and what can be read off it."""

import math

import numpy as np
from numpy.typing import NDArray

from eia_sec.common.config import FarmConfig
from eia_sec.common.farm_observation import HOLD
from eia_sec.common.team import Float32
from eia_sec.rollout.sim.conditions.stress import Patches
from eia_sec.rollout.sim.layout import Layout
from eia_sec.rollout.sim.reference.power import flight_power, other_power
from eia_sec.rollout.sim.reference.ways import Ways

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
Indices = NDArray[np.int64]


class FarmState:
    """One farm."""

    config: FarmConfig
    layout: Layout
    ways: Ways | None
    """How sweep routes and plans lead round no-fly zones, if any do."""
    time: int
    """Steps done."""
    kind: Indices
    """[n] type of each UAV: 0 relays, 1 monitors, 2 collectors."""
    height: Array
    """[n] m."""
    position: Array
    """[n, 2] m."""
    before: Array
    """[n, 2] positions one step ago, m."""
    velocity: Array
    """[n, 2] m/s, where UAVs have inertia."""
    acceleration: Array
    """[n, 2] m/s^2."""
    command: Array
    """[n, 2] the velocity commanded last, m/s."""
    direction: Array
    """[n, 2] D_VDF, D_AoI."""
    aoi: Array
    """[S]."""
    vdf: Array
    """[n_px, n_py]."""
    plot_xy: Array
    """[P, 2] centres of the plots, m."""
    wind: Array
    """[T + 1, 2] of each step, m/s; no rows without wind."""
    failure: Indices
    """[n] first step of which each UAV is no part."""
    gone: Flags
    """[n] whether a UAV has failed."""
    charge: Array
    """[n] of the batteries, J."""
    patches: Patches
    known: Flags
    """[P] whether the team knows a patch of stress."""
    assignment: Indices
    """[n_m + n_d] relays, -1 for none."""
    joined: Flags
    """[n_c] whether hops lead from a relay to the base station, if there is one."""
    linked: Flags
    """[n_m + n_d] whether the work of a served UAV counts (W4)."""
    service: Array
    """[n_c] D_c, m."""
    sweep: Indices
    """[n_m, 2] sweep route of each monitoring UAV and the box on it that comes next, if seen."""
    energy: Array
    """[n] used in the last step, J."""
    utility: Array
    """[n] VMUF or DCUF of the last step."""
    parts: Array
    """[n, K] of the last step's reward."""
    reward: Array
    """[n] of the last step."""
    chance: Array
    """[S] 1 - PLR of each sensor's packet in the last step."""
    link_quality: Array
    """[n_m + n_d] signal-to-noise ratio of the link to the relay, dB."""
    assignment_cost: float
    """The sum of the assignment's costs."""
    crowded: Flags
    """[n] whether another UAV of the plane is closer than the collision distance."""
    outside: Flags
    """[n] ACT of the last step."""
    observation: Float32
    """[O]."""

    @property
    def move_steps(self) -> int:
        """Steps of a move: with inertia it is a velocity that is held."""
        return HOLD if self.config.dynamics.inertial else 1

    def power(self, u: int, speed: float) -> float:
        """Return what a UAV needs at a speed, W."""
        return flight_power(self.config.energy, speed) + other_power(self.config.energy, self.kind[u])

    def distance(self, a: int, b: int, position: Array) -> float:
        """Return the 3-D distance of two UAVs, m."""
        return math.sqrt(((position[a] - position[b]) ** 2).sum() + (self.height[a] - self.height[b]) ** 2)

    def living(self, kind: int) -> NDArray[np.int64]:
        """Return the UAVs of a type that have not failed."""
        return np.flatnonzero((self.kind == kind) & ~self.gone)

    def nearest_uav(self, u: int) -> int:
        """Return the closest UAV of the same plane (W10); -1 if there is none."""
        others = [int(o) for o in self.living(int(self.kind[u])) if o != u]
        return min(others, key=lambda o: self.distance(u, o, self.position), default=-1)

    def served(self, relay: int) -> list[int]:
        """Return the indices of the UAVs that a relay serves."""
        first = self.config.world.communication_uavs
        return [first + int(k) for k in np.flatnonzero(self.assignment == relay)]

    def relay_service(self, relay: int) -> float:
        """Return D_c = epsilon_1 D_cg + epsilon_2 D_cf + epsilon_3 D_cc at the current positions, m."""
        weights, place = self.config.relay, np.column_stack([self.position, self.height])
        if self.gone[relay]:
            return 0.0
        served = self.served(relay)
        centroid = farthest = 0.0
        if served:
            centroid = float(np.linalg.norm(place[relay] - place[served].mean(axis=0)))
            farthest = float(np.linalg.norm(place[relay] - place[served], axis=1).max())
        relays = float(np.linalg.norm(place[relay] - place[self.living(0)].mean(axis=0)))
        return weights.weight_centroid * centroid + weights.weight_farthest * farthest + weights.weight_relays * relays
