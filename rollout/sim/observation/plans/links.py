"""From which lattice points a UAV's work counts, where links do (`farm.relay.require_link`)."""

import math

from eia_sec.rollout.sim.core.arrays import Farm, Scratch
from eia_sec.rollout.sim.core.compile import allocation_free, inlined
from eia_sec.rollout.sim.core.constants import Constants, FleetConstants
from eia_sec.rollout.sim.core.planes import height_of
from eia_sec.rollout.sim.core.records import Array, Flags
from eia_sec.rollout.sim.observation.plans.arrays import PlanScratch
from eia_sec.rollout.sim.observation.plans.constants import PlanConstants


@inlined
def find_linked(c: Constants, farm: Farm, s: Scratch, u: int, plan: PlanScratch) -> None:
    """Find the lattice points from which UAVs of a type would reach a relay that is joined, all relays as they are.

    Args:
        c: constants.
        farm: the environment.
        s: scratch.
        u: any UAV of the type.
        plan: the function writes `linked`; where links do not count it stays true everywhere.
    """
    if c.relay.link_range == math.inf:
        return
    plan.linked[:] = False
    for relay in range(c.fleet.relays):
        if not farm.gone[relay] and (s.joined[relay] or not c.relay.chained):
            height = height_of(c.fleet, relay) - height_of(c.fleet, u)
            add_disc(c.fleet, c.plans, farm.position[relay], height, c.relay.link_range, plan.linked)


@allocation_free
def add_disc(
    fleet: FleetConstants, plans: PlanConstants, place: Array, height: float, most: float, linked: Flags
) -> None:
    """Add the lattice points that are at most so far from a relay, which flies so much higher, all in m."""
    columns, rows = plans.columns, plans.rows
    for column in range(columns):
        dx = place[0] - (column + 0.5) * fleet.width / columns
        if abs(dx) > most:
            continue
        for row in range(rows):
            dy = place[1] - (row + 0.5) * fleet.depth / rows
            if math.sqrt(dx * dx + dy * dy + height * height) <= most:
                linked[column * rows + row] = True
